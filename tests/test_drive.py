"""Drives against scipy and closed forms: forth exactly, back exactly, and through a whole feedforward."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from pitp_jax.common.metrics import e_rms_percent
from pitp_jax.method.invert.feedforward_plan import feedforward
from pitp_jax.method.model.drive import DirectDrive, ElectrodeLag
from pitp_jax.method.signal.target import Target
from pitp_jax.method.simulate.decoder import rest_state, rollout

DT = 1e-3
REST, SETTLED = jnp.asarray(True), jnp.asarray(False)


def lag(tau):
    return ElectrodeLag(jnp.log(jnp.asarray(tau)))


def noise(samples, seed=0):
    return np.random.default_rng(seed).uniform(0, 2000, samples)


@pytest.mark.parametrize("tau", [0.02 * DT, DT, 30 * DT])
@pytest.mark.parametrize("rest", [True, False])
def test_the_film_follows_a_voltage_linear_between_samples(tau, rest):
    """scipy's first-order hold is the same assumption; a film that is not at rest has settled at u(0)."""
    u = noise(700)
    start = 0.0 if rest else u[0]
    truth = lsim(([[-1 / tau]], [[1 / tau]], [[1.0]], [[0.0]]), u, np.arange(700) * DT, X0=[start], interp=True)[1]
    with jax.enable_x64(True):
        found = lag(tau).film(jnp.asarray(u), DT, jnp.asarray(rest))
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-9 * u.max())


def test_the_film_charges_as_an_exponential():
    """A constant voltage on an uncharged film: V = u (1 - exp(-t / tau)), in float32 too."""
    found = lag(0.05).film(jnp.full(300, 3000.0), DT, REST)
    np.testing.assert_allclose(found, 3000 * -np.expm1(-np.arange(300) * DT / 0.05), rtol=0, atol=3000 * 3e-6)


def test_finer_samples_of_the_same_voltage_change_nothing():
    u = noise(100)
    fine = np.interp(np.arange(991) / 10, np.arange(100), u)
    with jax.enable_x64(True):
        coarse, found = (lag(3e-3).film(jnp.asarray(v), h, REST) for v, h in ((u, DT), (fine, DT / 10)))
    np.testing.assert_allclose(found[::10], coarse, rtol=0, atol=1e-9)


def lead_error(samples, inner):
    """Of the drive that makes V = 1000 + 800 sin(20 t), over one second, away from the ends or at them."""
    with jax.enable_x64(True):
        t = np.linspace(0, 1, samples)
        found = np.asarray(lag(0.03).lead(jnp.asarray(1000 + 800 * np.sin(20 * t)), t[1]))
    error = np.abs(found - (1000 + 800 * np.sin(20 * t) + 0.03 * 16000 * np.cos(20 * t)))
    return error[2:-2].max() if inner else error.max()


@pytest.mark.parametrize(("inner", "order"), [(True, 4), (False, 1)])
def test_the_lead_has_its_order(inner, order):
    """4 inside; the first and last samples have one-sided first differences."""
    errors = [lead_error(n, inner) for n in (101, 201, 401)]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), order, atol=0.1)
    assert lead_error(401, True) < 1e-2


@eqx.filter_jit
def forth_and_back(drive, voltage, rest):
    return drive.undo(drive.film(voltage, DT, rest), DT, voltage[0])


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(ratio=st.floats(np.log(0.1), np.log(100.0)), seed=st.integers(0, 10**6), rest=st.booleans())
def test_undo_gives_back_the_voltage(ratio, seed, rest):
    """Rounding of V reaches u times 2 tau / dt at once, and sums up over 3 tau / dt samples as it decays."""
    tau, u = DT * np.exp(ratio), noise(300, seed)
    with jax.enable_x64(True):
        found = forth_and_back(lag(tau), jnp.asarray(u), jnp.asarray(rest))
        assert found.dtype == jnp.float64
    bound = 10 * np.finfo(float).eps * (1 + 2 * tau / DT) * (1 + 3 * tau / DT)
    np.testing.assert_allclose(found, u, rtol=0, atol=bound * u.max())


def test_undo_is_traceable():
    """It stands inside compiled inverses, one record or many."""
    u = jnp.asarray(np.stack([noise(20, k) for k in range(3)]), jnp.float32)
    drive = lag(2e-3)
    found = eqx.filter_vmap(forth_and_back, in_axes=(None, 0, None))(drive, u, REST)
    np.testing.assert_allclose(found, u, rtol=0, atol=0.2)


def test_a_direct_drive_is_no_drive():
    u = jnp.asarray(noise(50), jnp.float32)
    drive = DirectDrive()
    for found in (drive.film(u, DT, REST), drive.lead(u, DT), drive.undo(u, DT, u[0])):
        np.testing.assert_array_equal(found, u)


def test_a_short_lag_is_a_direct_drive():
    u = noise(200)
    with jax.enable_x64(True):
        drive, voltage = lag(1e-9 * DT), jnp.asarray(u)
        found = drive.film(voltage, DT, SETTLED)
        lead = drive.lead(voltage, DT)
    np.testing.assert_allclose(found, u, rtol=0, atol=1e-5)
    np.testing.assert_allclose(lead, u, rtol=0, atol=1e-5)


@pytest.mark.parametrize("start", ["rest", "moving"])
def test_a_rollout_sees_the_film(linear, start):
    """A model with a lag under u moves as the bare model under the film's voltage."""
    model, u = linear(2), jnp.asarray(noise(300), jnp.float32)
    lagging = eqx.tree_at(lambda m: m.drive, model, lag(4e-3))
    state = rest_state(model) if start == "rest" else jnp.asarray([0.5, -0.3])
    film = lagging.drive.film(u, DT, jnp.asarray(start == "rest"))
    truth = rollout(model, film, DT, state)
    np.testing.assert_allclose(rollout(lagging, u, DT, state), truth, rtol=0, atol=1e-6)
    assert float(jnp.abs(truth - rollout(model, u, DT, state)).max()) > 1e-2


@pytest.mark.slow
def test_a_feedforward_leads_the_lag(linear):
    """u = V + tau V' is all but right before shooting; without the lead the target is missed twentyfold."""
    known = replace(linear(2).domain, voltage_range=(0.0, 3e3), slew=1e9)
    model = eqx.tree_at(lambda m: m.drive, replace(linear(2), domain=known), lag(8e-3))
    time = np.arange(800) * DT
    target = Target(time, 1e-3 + 4e-4 * np.sin(2 * np.pi * 3 * time))
    found = feedforward(model, target)
    assert not found.saturated.any() and not found.infeasible.any()
    assert found.self_check_e_rms_percent < 0.02
    naive = feedforward(eqx.tree_at(lambda m: m.drive, model, DirectDrive()), target)
    x = rollout(model, jnp.asarray(naive.voltage, jnp.float32), DT, rest_state(model))[:, 0]
    missed = e_rms_percent(np.asarray(x)[naive.target] * 1e-3, target.displacement)
    assert missed > 20 * found.equation_e_rms_percent > 20 * found.self_check_e_rms_percent
