"""Every kind of model that the project makes runs as machine code, as the JAX scan of the same step does in float64."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effect_numbers import NUMBERS

from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.effects.kernels import DELAY
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import AdaptedEncoder, CompactEncoder, ConstantEncoder, PaperEncoder
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.model.own_encoder import OwnEncoder
from pitp_jax.method.simulate import free_runs as door
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.beginnings import settled_states
from pitp_jax.method.simulate.compiled.kernel import kernel
from pitp_jax.method.simulate.decoder import rollout_batch
from pitp_jax.method.simulate.free_runs import free_runs, scanned_runs
from pitp_jax.method.simulate.model_runs import Models, ModelStep, film_of, model_runs, sample, taken_apart, way_of

pytestmark = pytest.mark.usefixtures("code_of_users")

DT, STEPS = 1e-3, 2000
T = np.arange(STEPS) * DT
VOLTS = np.stack([500 * np.sin(k * T) ** 2 + 30 * np.sin(90 * T) ** 2 for k in (5, 6, 7)])


class Own(eqx.Module):
    layer: eqx.nn.Linear

    def __call__(self, features):
        return 0.05 * jnp.tanh(self.layer(features))


def paper(linear, shake):
    encoder = shake(PaperEncoder(3, 3, width=48, key=jax.random.key(0)), 0.05, 1)
    return eqx.tree_at(lambda m: (m.encoder, m.memory), linear(2), (encoder, ElapsedTime(2.0)))


def wide(nonlinear, shake):
    encoder = CompactEncoder(2, 2, width=64, key=jax.random.key(1))
    return replace(nonlinear(2), encoder=shake(encoder, 0.1, 1))


def adapted(nonlinear):
    model = nonlinear(2)
    day = AdaptedEncoder(model.encoder, jnp.asarray(1.1), jnp.full(2, 0.9), jnp.full(2, 0.05), (-1.0, 0.0, 1.0))
    return replace(model, encoder=day)


def with_effects(linear, keys):
    """Forms of the catalogue beside each other."""
    specs = [spec for spec in CATALOGUE if spec.key in keys]
    return replace(linear(2, substeps=2), effects=tuple(s(*map(jnp.float32, NUMBERS[s.key])) for s in specs))


LAG = ElectrodeLag(jnp.asarray(-5.5, jnp.float32))
KINDS = {
    **{f"linear, order {n}": lambda lin, nl, shake, n=n: lin(n) for n in range(1, 7)},
    **{f"trained, order {n}": lambda lin, nl, shake, n=n: nl(n, substeps=n) for n in range(1, 5)},
    "linear input": lambda lin, nl, shake: lin(2, input_map=LinearInput()),
    "held": lambda lin, nl, shake: nl(2, hold="zoh"),
    "bandlimited": lambda lin, nl, shake: nl(2, hold="bandlimited"),
    "many substeps": lambda lin, nl, shake: nl(2, substeps=30),
    "second mass": lambda lin, nl, shake: nl(2, ring=(60.0, 0.1)),
    "frugal": lambda lin, nl, shake: nl(2, frugal=True),
    "electrode": lambda lin, nl, shake: replace(nl(2), drive=LAG),
    "wide": lambda lin, nl, shake: wide(nl, shake),
    "paper": lambda lin, nl, shake: paper(lin, shake),
    "adapted": lambda lin, nl, shake: adapted(nl),
    "own": lambda lin, nl, shake: replace(nl(2), encoder=OwnEncoder(Own(eqx.nn.Linear(4, 4, key=jax.random.key(2))))),
    "all effects": lambda lin, nl, shake: with_effects(lin, NUMBERS),
}
QUICK = ("linear, order 1", "trained, order 3", "bandlimited", "adapted")


@pytest.fixture
def kind(request, linear, nonlinear, shake):
    return KINDS[request.param](linear, nonlinear, shake)


def arguments(model, volts=VOLTS):
    """The arguments of `free_runs` for records from rest."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pitp_jax.method.simulate.model_runs.free_runs", lambda *a: found.update(all=a) or free_runs(*a))
        model_runs(model, volts, DT, start_of(model, len(volts)))
    return found["all"]


def start_of(model, records):
    from pitp_jax import rest_state

    return np.tile(np.asarray(rest_state(model), float), (records, 1))


SLOW = ("all effects", "trained, order 4", "wide")


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=pytest.mark.slow if k in SLOW else ()) for k in KINDS], indirect=True
)
def test_every_kind_of_model_is_compiled(kind):
    step, parameters, start, inputs, _ = arguments(kind, VOLTS[:, :20])
    assert kernel(step, parameters, start, inputs) is not None


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=() if k in QUICK else pytest.mark.slow) for k in KINDS], indirect=True
)
def test_machine_code_equals_the_scan(kind):
    """2,000 steps in float64; and the float32 rollout of the public path, to its rounding."""
    step, parameters, start, inputs, column = arguments(kind)
    found, scan = (way(step, parameters, start, inputs, column) for way in (free_runs, scanned_runs))
    assert np.ptp(scan[..., 0]) > 1e-4  # a linear input moves little on the scales of a square one
    np.testing.assert_allclose(found, scan, rtol=0, atol=1e-12 * np.abs(scan).max())
    public = rollout_batch(kind, jnp.asarray(VOLTS, jnp.float32), DT, jnp.asarray(start, jnp.float32))
    np.testing.assert_allclose(found[..., 0], public[..., 0], rtol=0, atol=1e-3 * np.abs(scan[..., 0]).max())


def test_models_of_one_structure_share_a_step(nonlinear):
    one, other = (ModelStep(sample, taken_apart(nonlinear(2, key=k))[0], DT) for k in (0, 1))
    assert one == other and hash(one) == hash(other)
    assert one != ModelStep(sample, taken_apart(nonlinear(3))[0], DT)


def test_numbers_and_structure_are_the_model(nonlinear):
    model = nonlinear(2)
    structure, numbers = taken_apart(model)
    back = structure.filled(jnp.asarray(numbers, jnp.float32))
    for a, b in zip(jax.tree.leaves(model), jax.tree.leaves(back), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


def test_without_machine_code_a_prediction_is_the_same(nonlinear, monkeypatch):
    model = nonlinear(2)
    states, readings = model_runs(model, VOLTS, DT, start_of(model, 3))
    monkeypatch.setattr(door, "kernel", lambda *_: None)
    again = model_runs(model, VOLTS, DT, start_of(model, 3))
    np.testing.assert_allclose(states, again[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(readings, again[1], rtol=0, atol=1e-12)


def test_the_way_of_a_model_is_told_by_its_parts(nonlinear, monkeypatch):
    own = replace(nonlinear(2), encoder=OwnEncoder(Own(eqx.nn.Linear(4, 4, key=jax.random.key(2)))))
    assert way_of(nonlinear(2)) == "compiled" and "Own" in way_of(own)
    monkeypatch.setenv("PITP_COMPILED", "0")
    assert way_of(nonlinear(2)) == way_of(own) == "by the JAX scan"


@pytest.mark.parametrize("kind", ["linear, order 3", "trained, order 3", "linear input", "adapted"], indirect=True)
def test_a_settled_state_stays(kind):
    """Under a constant voltage; that of a linear model is F / a_0."""
    volts = np.array([300.0, 500.0])
    states = settled_states(kind, volts, DT, np.zeros(2))
    along = model_runs(kind, np.repeat(volts[:, None], STEPS, 1), DT, states)[0]
    np.testing.assert_allclose(along - states[:, None], 0, atol=2e-6)  # half a cell of the last grid
    if isinstance(kind.encoder, ConstantEncoder):
        x = np.asarray(kind.input_map.force(volts)) / kind.physical_coefficients[0]
        np.testing.assert_allclose(states[:, 0], x / kind.scales.state[0], atol=1e-6)


def test_no_settled_state_beyond_ten_scaled_displacements(linear):
    assert np.isnan(settled_states(linear(2), np.array([0.0, 1e6]), DT, np.zeros(2))[:, 0]).tolist() == [False, True]


def test_the_film_lags_and_delays_as_in_the_differentiable_way(linear):
    delays = [spec(jnp.float32(t)) for spec, t in ((next(s for s in CATALOGUE if s.kernel is DELAY), 2.4e-3),) * 2]
    model = replace(linear(2), drive=LAG, effects=tuple(delays))
    volts = VOLTS + 100
    for first in (0.0, 1.0):  # at rest, the film is uncharged
        found = film_of(model, volts, DT, np.full((3, 2), first))
        truth = [ports.filmed(model, jnp.asarray(v, jnp.float32), DT, first == 0) for v in volts]
        np.testing.assert_allclose(found, truth, rtol=0, atol=2e-3)


def test_every_run_may_have_a_model_of_its_own(linear):
    """Two models with other coefficients, lags and delays, side by side as each alone."""
    spec = next(s for s in CATALOGUE if s.kernel is DELAY)

    def one(stiffer, delay, tau):
        model = linear(2)
        drive, late = ElectrodeLag(jnp.log(jnp.float32(tau))), spec(jnp.float32(delay))
        return replace(model, coefficients=model.coefficients * stiffer, drive=drive, effects=(late,))

    each, start = [one(1.0, 2.4e-3, 5e-3), one(1.3, 5.2e-3, 8e-3)], np.zeros((2, 2))
    both, volts = Models.of(each), VOLTS[:2] + 100
    alone = [model_runs(m, volts[k : k + 1], DT, start[:1])[1][0] for k, m in enumerate(each)]
    np.testing.assert_allclose(model_runs(both, volts, DT, start)[1], alone, rtol=1e-12, atol=1e-14)
    settled = settled_states(both, volts[:, 0], DT, np.zeros(2))
    for k, m in enumerate(each):
        np.testing.assert_allclose(settled[k], settled_states(m, volts[k, :1], DT, np.zeros(1))[0], rtol=1e-12)
