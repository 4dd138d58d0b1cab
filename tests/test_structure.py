"""The structure of a model by its error on excitations left out: closed forms, planted effects, and who is grouped."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax.method.diagnose.search import Search
from pitp_jax.method.model.encoder import CompactEncoder
from pitp_jax.method.model.fitted import model_of
from pitp_jax.method.signal.excited import distinct
from pitp_jax.method.structure.choice import STRUCTURES, Fitting, best_structure, choose, impose
from pitp_jax.method.structure.left_out import folds_of, with_stand_ins
from pitp_jax.method.structure.physical import as_training
from pitp_jax.method.train.errors import Score

KEY = jax.random.key(3)
DT = 2e-3
TIME = np.arange(4000) * DT


def sine(hz: float, amplitude: float = 1.0) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * hz * TIME)


def test_repetitions_are_one_excitation_and_other_frequencies_or_amplitudes_are_not():
    rng = np.random.default_rng(1)
    noisy = [sine(3.0) + 0.02 * rng.standard_normal(len(TIME)) for _ in range(2)]
    white = [rng.standard_normal(len(TIME)) for _ in range(2)]
    signals = [noisy[0], sine(3.0, 2.0), white[0], noisy[1], sine(4.5), white[1], np.zeros(len(TIME))]
    assert distinct(signals, DT) == ((0, 3), (1,), (2, 5), (4,), (6,))


def test_every_excitation_is_left_out_whole_and_once():
    drives = [sine(hz, a) for hz in (1.0, 2.0, 4.0, 8.0, 16.0) for a in (1.0, 1.01)]
    records = [pitp.Record(f"{k}", TIME, u, np.zeros_like(u)) for k, u in enumerate(drives)]
    found = folds_of(records)
    assert len(found.excitations) == 5 and len(found.folds) == 3
    assert sorted(k for fold in found.folds for k in fold) == list(range(10))
    assert all(set(e) <= set(fold) or not set(e) & set(fold) for e in found.excitations for fold in found.folds)


def test_stand_ins_are_as_long_as_those_left_out_and_hold_nothing_of_them():
    """Each of the others is copied once before any is copied twice; a copy that is too short ends with gaps."""
    records = [pitp.Record(f"{k}", 5.0 + TIME[:n], np.full(n, 10.0 + k), np.full(n, 20.0 + k))
               for k, n in enumerate((400, 1000, 600, 500))]  # fmt: skip
    filled = with_stand_ins(records, (1, 3))
    assert [r.samples for r in filled] == [r.samples for r in records] and len({r.name for r in filled}) == 4
    assert filled[0] is records[0] and filled[2] is records[2]
    for place, donor in ((1, 2), (3, 0)):
        one, seen = filled[place], min(records[place].samples, records[donor].samples)
        np.testing.assert_array_equal(one.displacement[:seen], records[donor].displacement[:seen])
        assert np.isnan(one.displacement[seen:]).all() and (one.voltage == 10.0 + donor).all()


CONSTANT = np.full(4, 35.0)


@pytest.mark.parametrize(
    ("physical", "encoder", "both", "chosen"),
    [
        ([8.0, 9.0, 8.0, 9.0], [4.0, 4.5, 4.0, 4.5], [4.0, 4.5, 4.0, 4.5], "encoder"),
        ([8.0, 9.0, 8.0, 9.0], [4.0, 4.5, 4.0, 4.5], [2.0, 2.2, 2.0, 2.2], "both"),
        ([4.0, 5.0, 4.0, 5.0], [4.1, 4.9, 4.1, 4.9], [3.9, 5.1, 3.9, 5.1], "physical"),
        ([1.0, 1.0, 1.0, np.inf], [4.0, 4.5, 4.0, 4.5], [9.0, 9.0, 9.0, 9.0], "encoder"),
        ([1.0, 1.0, 1.0, 36.0], [4.0, 4.5, 4.0, 4.5], [9.0, 9.0, 9.0, 9.0], "encoder"),
        ([np.inf] * 4, [np.inf] * 4, [36.0] * 4, "encoder"),
    ],
)
def test_fewest_parameters_of_those_that_predict_as_well(physical, encoder, both, chosen):
    """Equal within the standard error; a structure that predicts one excitation worse than a constant is out."""
    found = {"physical": np.array(physical), "encoder": np.array(encoder), "both": np.array(both)}
    assert tuple(found) == STRUCTURES
    assert best_structure(found, CONSTANT)[0] == chosen


def test_corrections_of_a_remainder_fade_outside_the_trained_region(shake):
    """Exactly the plain encoder inside, exactly the nominal beyond twice the region, monotonous between."""
    bounds = np.array([[-2.0, -4.0, -1e6], [2.0, 4.0, 1e6]])
    plain, held = (
        shake(CompactEncoder(2, 1, width=4, frugal=True, remainder=r, bounds=bounds, key=KEY), 0.5, 0)
        for r in (False, True)
    )
    # inside; halfway in both coordinates, s = 1/2 each; outside in one
    points = jnp.array([[0.9, -1.8, 0.3], [1.5, 3.0, 0.3], [0.2, 4.1, 0.3]])
    whole, faded = (np.asarray(eqx.filter_jit(jax.vmap(e))(points)) for e in (plain, held))
    np.testing.assert_allclose(faded, np.array([[1.0], [0.25], [0.0]]) * whole, rtol=1e-5)
    assert (np.abs(whole).max(1) > 0.01).all()
    assert all(np.asarray(leaf).all() for leaf in jax.tree.leaves(held.token_nets()) if eqx.is_inexact_array(leaf))


def stiffened(drive: np.ndarray, rng) -> np.ndarray:
    """A second-order actuator of 5 Hz behind V^2 whose spring hardens with x^3, in mm, by its own small steps."""
    omega, x, v, out = 2 * np.pi * 5.0, 0.0, 0.0, []
    for u in drive:
        for _ in range(16):
            v += DT / 16 * omega**2 * (u**2 - x - 2.0 * x**3 - 0.4 * v / omega)
            x += DT / 16 * v
        out.append(x)
    return 1e-3 * (np.array(out) + 1e-4 * rng.standard_normal(len(out)))


@pytest.fixture
def fitting(monkeypatch):
    """Three excitations of an actuator that hardens, a search among three effects, a training that learns nothing."""
    rng = np.random.default_rng(0)
    time = TIME[:2000]
    drives = {"2 Hz": 0.5 * (1 - np.cos(4 * np.pi * time)), "4 Hz": 0.4 * (1 - np.cos(8 * np.pi * time)),
              "noise": np.abs(np.interp(time, np.arange(0, 4.01, 0.1), rng.uniform(0, 0.9, 41)))}  # fmt: skip
    records = [pitp.Record(n, time, 1e3 * u, stiffened(u, rng), "V", "m") for n, u in drives.items()]
    tried = Search._is_tried
    few = {"spring", "drag", "sensor_lag"}
    monkeypatch.setattr(Search, "_is_tried", lambda self, form: form.name in few and tried(self, form))

    def nominal(some):
        return pitp.identify(some, order=2).model

    def train(start, some, *, settings, **how):
        return as_training(model_of(start), start, some, 0.0)  # the search must not end at this time

    monkeypatch.setattr("pitp_jax.method.structure.left_out.train", train)
    monkeypatch.setattr("pitp_jax.method.structure.choice.train", train)
    how = Fitting(nominal(records), nominal, pitp.Settings(), KEY)
    return how, records, train(how.nominal, records, settings=None)


@pytest.mark.slow
def test_a_hardening_spring_predicts_each_excitation_left_out(fitting):
    """The effect is refitted without the excitation and predicts it four times as well as the linear model."""
    how, records, encoder = fitting
    found = choose(how, records, encoder)
    assert found.structure == "physical"
    assert found.errors["physical"] < found.errors["encoder"] / 4
    assert found.errors["both"] == pytest.approx(found.errors["physical"])
    assert [h.name for h in found.held_out] == [r.name for r in records]
    assert {e.name for e in found.training.model.effects} == {"stiffening"}
    assert all(e.trained < e.nominal / 4 for e in found.training.errors)
    imposed = impose("physical", how, records, cross_validate=True)
    assert [h.predicted for h in imposed.held_out] == pytest.approx([h.predicted for h in found.held_out], rel=1e-3)


@pytest.mark.parametrize(
    ("physical", "tried"), [(8.0, ["physical", "encoder"]), (4.0, [*STRUCTURES]), (np.inf, ["physical", "encoder"])]
)
def test_networks_beside_effects_are_tried_only_where_these_help(actuator, monkeypatch, physical, tried):
    """A training with effects takes several times as long as one without."""
    errors, asked = {"physical": physical, "encoder": 4.1, "both": 1.0}, []

    def left_out(structures, records, *rest, **how):
        asked.extend(structures)
        return {s: [Score(errors[s], ())] * len(records) for s in structures}

    chosen = pitp.Training(pitp.Fitted(actuator), (), False)
    monkeypatch.setattr("pitp_jax.method.structure.choice.errors_left_out", left_out)
    monkeypatch.setattr("pitp_jax.method.structure.choice.find_physical", lambda *_: None)
    monkeypatch.setattr("pitp_jax.method.structure.choice.errors", lambda model, records: np.zeros(len(records)))
    records = [pitp.Record(f"{hz}", TIME, sine(hz), 1e-3 * sine(hz)) for hz in (1.0, 2.0, 4.0)]
    found = choose(Fitting(actuator, lambda some: actuator, pitp.Settings(), KEY), records, chosen)
    assert asked == tried == [*found.errors]
    assert found.structure == ("both" if "both" in tried else "encoder")


@pytest.mark.parametrize("count", [1, 8])
def test_one_excitation_or_eight_keep_the_encoder(actuator, count):
    """The first cannot be left out, the last are enough: no search, no fold."""
    drives = [sine(1.0 * 2 ** (k / 2)) for k in range(count)] * 2
    some = [pitp.Record(f"{k}", TIME, u, 1e-3 * u) for k, u in enumerate(drives)]
    encoder = pitp.Training(pitp.Fitted(actuator), (), False)
    found = choose(Fitting(actuator, lambda some: pytest.fail("compared"), pitp.Settings(), KEY), some, encoder)
    assert (found.structure, found.errors, found.training) == ("encoder", {}, encoder)
