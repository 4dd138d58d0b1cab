"""Lags and oscillators against closed forms and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax.method.numerics import linear_recurrence
from pitp_jax.method.numerics.linear_recurrence import first_order_lags, lag_after, oscillator


@pytest.mark.parametrize("steps", [1, 2, 3, 17, 400])
def test_lags_of_a_ramp_on_a_level(steps):
    """X = 1 + 2 t from z(0) = 0.3: z = 1 + 2 (t - tau) + (0.3 - 1 + 2 tau) exp(-t / tau)."""
    dt, tau = 0.01, np.array([0.004, 0.1, 30.0])
    t = np.arange(steps)[:, None] * dt
    with jax.enable_x64(True):
        found = first_order_lags(jnp.asarray(1 + 2 * t[:, 0]), jnp.asarray(tau), dt, jnp.full(3, 0.3))
    truth = 1 + 2 * (t - tau) + (0.3 - 1 + 2 * tau) * np.exp(-t / tau)
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-12)


@pytest.mark.parametrize("levels", [2, 3, 4])
def test_lags_of_noise_against_scipy(monkeypatch, levels):
    """Four levels as on a GPU."""
    monkeypatch.setattr(linear_recurrence, "_levels", lambda: levels)
    jax.clear_caches()
    rng, dt, tau = np.random.default_rng(1), 2e-3, np.array([1e-3, 0.05, 2.0])
    x, start = rng.standard_normal(1000), rng.standard_normal(3)
    system = (-np.diag(1 / tau), (1 / tau)[:, None], np.eye(3), np.zeros((3, 1)))
    truth = lsim(system, x, np.arange(1000) * dt, X0=start, interp=True)[2]
    with jax.enable_x64(True):
        found = first_order_lags(jnp.asarray(x), jnp.asarray(tau), dt, jnp.asarray(start))
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-11)


def test_an_oscillator_in_four_levels_is_that_in_two(monkeypatch):
    x, found = np.random.default_rng(3).standard_normal(500), []
    for levels in (2, 4):
        monkeypatch.setattr(linear_recurrence, "_levels", lambda levels=levels: levels)
        jax.clear_caches()
        with jax.enable_x64(True):
            found.append(
                oscillator(jnp.asarray(x), jnp.asarray(60.0), jnp.asarray(0.2), 1e-3, jnp.asarray([0.3, -0.2]))
            )
    np.testing.assert_allclose(*found, rtol=0, atol=1e-12)


def test_lags_of_records_of_one_length_are_one_program(monkeypatch):
    traced, blocked = [], linear_recurrence._blocked
    monkeypatch.setattr(linear_recurrence, "_blocked", lambda *a: (traced.append(1), blocked(*a))[1])
    for level in (0.0, 1.0, 2.0):
        first_order_lags(jnp.full(37, level), jnp.full(2, 0.1 + level), 0.01, jnp.zeros(2))
    assert len(traced) == 1


def test_slow_lags_survive_float32():
    """25,000 samples a time constant, in float32 against float64."""
    x = np.sin(np.arange(20_000) * 0.01) + 0.5
    run = [
        first_order_lags(jnp.asarray(x, jnp.float32), jnp.asarray([25.0]), 1e-3, jnp.asarray([0.0])),
    ]
    with jax.enable_x64(True):
        run.append(first_order_lags(jnp.asarray(x), jnp.asarray([25.0]), 1e-3, jnp.asarray([0.0])))
    assert np.ptp(run[1]) > 0.2
    np.testing.assert_allclose(*run, rtol=0, atol=3e-5)


def test_one_sample_is_one_step_of_many():
    rng, dt, tau = np.random.default_rng(2), 3e-3, np.array([1e-3, 0.2, 40.0])
    x, start = rng.standard_normal(2), rng.standard_normal(3)
    with jax.enable_x64(True):
        truth = first_order_lags(jnp.asarray(x), jnp.asarray(tau), dt, jnp.asarray(start))[1]
        found = lag_after(jnp.asarray(start), jnp.asarray(x[0]), jnp.asarray(x[1]), jnp.asarray(tau), dt)
    np.testing.assert_allclose(found, truth, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 2, 17, 1000])
@pytest.mark.parametrize("zeta", [0.003, 0.5])
def test_an_oscillator_driven_by_noise_against_scipy(steps, zeta):
    rng, dt, w, start = np.random.default_rng(steps), 2e-4, 2 * np.pi * 220, np.array([0.3, -0.2])
    x = rng.standard_normal(steps)
    system = (np.array([[0, w], [-w, -2 * zeta * w]]), np.array([[0], [w]]), np.eye(2), np.zeros((2, 1)))
    truth = start[None] if steps == 1 else lsim(system, x, np.arange(steps) * dt, X0=start, interp=True)[2]
    with jax.enable_x64(True):
        found = oscillator(jnp.asarray(x), jnp.asarray(w), jnp.asarray(zeta), dt, jnp.asarray(start))
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-11)
    single = oscillator(jnp.asarray(x, jnp.float32), jnp.float32(w), jnp.float32(zeta), dt, jnp.float32(start))
    np.testing.assert_allclose(single, truth, rtol=0, atol=2e-4)
