"""The structure of a model by its error on excitations left out: closed forms, planted effects, and who is grouped."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax._model import CompactEncoder
from pitp_jax._record.excited import distinct
from pitp_jax._structure.choice import STRUCTURES, Fitting, best_structure, choose, impose
from pitp_jax._structure.left_out import folds_of

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


CONSTANT = np.full(4, 35.0)


@pytest.mark.parametrize(
    ("physical", "encoder", "both", "chosen"),
    [
        ([8.0, 9.0, 8.0, 9.0], [4.0, 4.5, 4.0, 4.5], [4.0, 4.5, 4.0, 4.5], "encoder"),
        ([8.0, 9.0, 8.0, 9.0], [4.0, 4.5, 4.0, 4.5], [2.0, 2.2, 2.0, 2.2], "both"),
        ([4.0, 5.0, 4.0, 5.0], [4.1, 4.9, 4.1, 4.9], [3.9, 5.1, 3.9, 5.1], "physical"),
        ([1.0, 1.0, 1.0, np.inf], [4.0, 4.5, 4.0, 4.5], [9.0, 9.0, 9.0, 9.0], "encoder"),
        ([1.0, 1.0, 1.0, 36.0], [4.0, 4.5, 4.0, 4.5], [9.0, 9.0, 9.0, 9.0], "encoder"),
        ([np.inf] * 4, [np.inf] * 4, [np.inf] * 4, "physical"),
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
        for _ in range(4):
            v += DT / 4 * omega**2 * (u**2 - x - 2.0 * x**3 - 0.4 * v / omega)
            x += DT / 4 * v
        out.append(x)
    return 1e-3 * (np.array(out) + 1e-4 * rng.standard_normal(len(out)))


@pytest.fixture(scope="module")
def fitting():
    """Three excitations of an actuator that hardens, and a training of few steps."""
    rng = np.random.default_rng(0)
    drives = {"2 Hz": 0.5 * (1 - np.cos(4 * np.pi * TIME)), "4 Hz": 0.4 * (1 - np.cos(8 * np.pi * TIME)),
              "noise": np.abs(np.interp(TIME, np.arange(0, 8.01, 0.1), rng.uniform(0, 0.9, 81)))}  # fmt: skip
    records = [pitp.Record(n, TIME, 1e3 * u, stiffened(u, rng), "V", "m") for n, u in drives.items()]
    settings = pitp.Settings(refine_steps=4, epochs=1, stages=1, starts=1, memories=2)

    def nominal(some):
        return pitp.identify(some, order=2).model

    return Fitting(nominal(records), nominal, settings, KEY), records


@pytest.mark.slow
def test_a_hardening_spring_is_found_and_needs_no_network(fitting):
    """The physics predicts an excitation left out better than a network of the other two, and is chosen."""
    how, records = fitting
    encoder = pitp.train(how.nominal, records, settings=how.settings, key=KEY)
    found = choose(how, records, encoder)
    assert found.structure == "physical"
    assert found.errors["physical"] < 0.5 * found.errors["encoder"]
    assert [h.name for h in found.held_out] == [r.name for r in records]
    assert "stiffening" in {e.name for e in found.training.model.effects}
    assert all(e.trained < 1.0 < e.nominal for e in found.training.errors)


@pytest.mark.slow
def test_both_keeps_the_effects_and_adds_a_network(fitting):
    how, records = fitting
    found = impose("both", how, records)
    model = found.training.model
    assert isinstance(model.encoder, CompactEncoder) and model.encoder.remainder and model.effects
    assert not found.errors and max(e.trained for e in found.training.errors) < 1.0
