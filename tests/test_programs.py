"""Compiled programs shared by all models of one structure, blind to what they were made from; files written before."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from origins import assert_same_origin

import pitp_jax as pitp
from pitp_jax.method.fit.parameters import parameters
from pitp_jax.method.invert import equation
from pitp_jax.method.invert.equation import invert_path, scaled_equation
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.model import Output, Scales
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.model.sections import sections_of
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate import batched_rollout, decoder
from pitp_jax.method.simulate.batched_rollout import fast_rollout
from pitp_jax.method.simulate.decoder import rest_state, rollout_batch

FILES, DT = Path(__file__).parent / "files", 2e-3
TIME = DT * np.arange(600)
# displacement of every 75th sample from rest under the voltage of `held_out`, as simulated by commit cb44ab2
WRITTEN = {
    "identified": (0.0, 2.3060677421940664e-04, 7.179310915840678e-04, -5.984553523655555e-05,
                   9.363565064217281e-05, 8.162137000272587e-04, -6.732482916843469e-05, 5.1531016605421606e-05),
    "trained": (0.0, 2.551018606210229e-04, 6.507332907860102e-04, -2.5191591031333578e-05,
                1.3980056841445104e-04, 7.631105992399404e-04, 3.07579587536702e-05, 6.992026610401111e-05),
    "effects": (0.0, 6.849631667137146e-05, 7.662865519523621e-04, -4.985305946320295e-06,
                4.949455335736275e-05, 8.019519448280335e-04, -2.061669947579503e-06, 3.0885441228747366e-05),
}  # fmt: skip


def held_out(model):
    u = 400 * (1 - np.cos(2 * np.pi * 2.2 * TIME))
    return Record("held out", TIME, u, np.full(len(TIME), float(model.output.offset)))


def another(model, seed=1):
    """Same structure; other weights, scales, output and domain."""
    rng = np.random.default_rng(seed)
    changed = model.changed(rng.uniform(0.9, 1.1, model.order + 1))
    scales = Scales(model.scales.state * rng.uniform(0.5, 2, model.order + 1), 2.5e6)
    if model.order > 2:  # the sections are those of the coefficients
        physical = replace(changed, scales=scales).physical_coefficients
        scales = replace(scales, sections=sections_of(physical))
    shown = Domain(DT, (0.0, 900.0 * seed), 3e4, ((-1.0, seed),) * (model.order + model.memory.size))
    output = Output(1e-3 * seed, -1.0)
    return replace(changed, scales=scales, output=output, domain=shown)


@pytest.fixture
def traces(monkeypatch):
    """How often the decoder's or the inverse's way to a force was traced."""
    count = []

    def counted(place, name):
        original = getattr(place, name)

        def traced(*args):
            count.append(name)
            return original(*args)

        monkeypatch.setattr(place, name, traced)

    for name in ("stage_voltages", "film_voltage"):
        for place in (decoder, batched_rollout, equation):
            if hasattr(place, name):
                counted(place, name)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 3])
def test_models_of_one_structure_share_their_programs(order, nonlinear, traces):
    one = another(nonlinear(order, size=0.05, dt=DT), 2)
    two = another(one)
    x = np.stack([1e-4 * (2 * np.pi) ** k * np.sin(2 * np.pi * TIME + k * np.pi / 2) for k in range(order + 1)], 1)

    def everything(model):
        volts, start = jnp.asarray(held_out(model).voltage, jnp.float32)[None], rest_state(model)[None]
        played = invert_path(model, scaled_equation(model, x), DT)[1]
        (predicted,) = pitp.predict(model, [held_out(model)])
        return rollout_batch(model, volts, DT, start), fast_rollout(model, volts, DT, start), played, predicted

    first, before = everything(one), len(traces)
    second = everything(two)
    assert before >= 3 and len(traces) == before
    for found in (first, second):
        np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-5)
    assert not np.allclose(first[1], second[1], atol=1e-2)
    traced = [np.asarray(a) for a in everything(replace(two, substeps=1))[:3]]
    for a, b in zip(second[:3], traced, strict=True):
        np.testing.assert_array_equal(np.asarray(a), b)


@pytest.mark.slow
def test_shared_programs_read_the_models_own_numbers(nonlinear):
    """A program compiled for one model gives another the same states as no program at all."""
    one = nonlinear(2, size=0.05, dt=DT)
    two, volts = another(one), jnp.asarray(held_out(one).voltage[:60], jnp.float32)
    fast_rollout(one, volts[None], DT, rest_state(one)[None])
    shared = fast_rollout(two, volts[None], DT, rest_state(two)[None])[0]
    state, plain = rest_state(two), []
    for stages in decoder.stage_voltages(two, volts):
        plain.append(state)
        state = decoder.step(two, state, stages, DT)
    np.testing.assert_allclose(shared, np.stack(plain), rtol=0, atol=1e-6)


def test_no_program_sees_an_origin(actuator):
    """A fitted model is its model under a transformation, so that those of any origin share one program."""
    count = []

    @jax.jit
    def twice(fitted):
        count.append(fitted.origin.displacement_unit)
        return jax.tree.map(lambda a: 2 * a, fitted)

    for unit in ("mm", "um"):
        back = twice(Fitted(actuator, Origin(displacement_unit=unit)))
    assert count == ["m"]
    assert back.origin.displacement_unit == "m"
    np.testing.assert_array_equal(back.coefficients, 2 * actuator.coefficients)


def test_what_is_read_off_a_fitted_model_is_the_models(actuator):
    fitted = Fitted(actuator, Origin(displacement_unit="mm"))
    assert fitted.order == actuator.order and replace(fitted, substeps=3).substeps == 3
    assert replace(fitted, substeps=3).origin is fitted.origin and fitted.changed(np.ones(3)).origin is fitted.origin
    assert isinstance(fitted, pitp.Model) and not isinstance(fitted.origin, pitp.Model)
    with pytest.raises(AttributeError, match="notes"):
        _ = fitted.notes


def test_scales_and_output_are_exact_numbers_and_not_trained(nonlinear):
    model = nonlinear(2, offset=1 / 3)
    scaled = replace(model, scales=Scales((1 / 3, 0.1, 7.0), 0.7))
    assert scaled.scales.state == (1 / 3, 0.1, 7.0)
    assert scaled.output.offset == 1 / 3 and scaled.scales.force == 0.7
    assert len(parameters(scaled)[0]) == len(parameters(model)[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITTEN)
def test_files_written_before_load_and_simulate_the_same(name, tmp_path):
    """From rest, because the estimate of a start in motion has changed since."""
    path = FILES / f"{name}_508a6f1.model"
    model = pitp.load(path)
    found = pitp.rollout(model, held_out(model).voltage, DT, begins="rest")
    np.testing.assert_allclose(found[::75], WRITTEN[name], rtol=0, atol=2e-9)
    pitp.save(tmp_path / "again", model)
    again = pitp.load(tmp_path / "again")
    assert again.domain == model.domain and again.scales == model.scales and again.output == model.output
    assert_same_origin(again.origin, model.origin)
