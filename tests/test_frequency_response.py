"""The empirical frequency response against the plant's own, and what optimistix makes of it in an identification."""

import numpy as np
import optimistix
import pytest
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.application.demo.protocol import kind, measure
from pitp_jax.method.identify.candidates import HALF, search
from pitp_jax.method.identify.frequency_fit import fit_response
from pitp_jax.method.identify.frequency_response import frequency_response
from pitp_jax.method.identify.identification import identify
from pitp_jax.method.identify.linear_ode import poles
from pitp_jax.method.identify.output_error import build_problem
from pitp_jax.method.signal.initial_state import Beginning
from pitp_jax.method.signal.record import Record

DT, SAMPLES = 2e-3, 8000
TIME = np.arange(SAMPLES) * DT
SWEEP = np.sin(2 * np.pi * (0.2 * TIME + 12 * TIME**2 / 16 / 2))
A = np.array([(2 * np.pi * 4.0) ** 2, 2 * 0.1 * 2 * np.pi * 4.0, 1.0])


def swept(noise=0.0, seed=0, start=0):
    x = lsim(([A[0]], A[::-1]), SWEEP, TIME)[1]
    x = x + noise * x.std() * np.random.default_rng(seed).standard_normal(SAMPLES)
    return Record("sweep", TIME[start:], SWEEP[start:], x[start:])


def response(record):
    return frequency_response(build_problem([record], "linear", [Beginning("moving", 1.0, 0.0, 0.0, 0, True)]))


@pytest.mark.parametrize("start", [0, 900])  # at rest; in motion, which only the transient's polynomial explains
def test_it_is_the_plants(start):
    found = response(swept(start=start))
    seen = found.coherent & (found.hz > 0.5) & (found.hz < 10)
    s = 2j * np.pi * found.hz[seen]
    truth = A[0] / np.polyval(A[::-1], s)
    assert seen.sum() > 40 and found.rich
    assert np.median(np.abs(found.value[seen] / truth - 1)) < 0.01


def test_its_standard_error_covers():
    """Over lines and seeds, of the real and the imaginary part together."""
    z = []
    for seed in range(4):
        found = response(swept(0.05, seed))
        seen = (found.hz > 0.5) & (found.hz < 8)
        truth = A[0] / np.polyval(A[::-1], 2j * np.pi * found.hz[seen])
        z.append(np.abs(found.value[seen] - truth) / found.stderr[seen])
    assert 0.7 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.5


def test_one_sine_is_not_rich():
    sine = np.sin(2 * np.pi * 3 * TIME)
    x = lsim(([A[0]], A[::-1]), sine, TIME)[1]
    x = x + 1e-3 * np.random.default_rng(0).standard_normal(SAMPLES)
    assert not response(Record("sine", TIME, sine, x)).rich


@pytest.mark.parametrize("late", [0.0, 5.5])
def test_poles_and_delay_from_the_response(late):
    drive = np.interp(np.arange(SAMPLES) - late, np.arange(SAMPLES), SWEEP, left=0.0)
    x = lsim(([A[0]], A[::-1]), drive, TIME)[1] + 1e-3 * np.random.default_rng(0).standard_normal(SAMPLES)
    fits = fit_response(response(Record("late", TIME, SWEEP, x)), DT, [2])
    found = fits[2, late > 0]
    np.testing.assert_allclose(np.abs(poles(found[:2])), 2 * np.pi * 4.0, rtol=0.01)
    if late:
        assert np.exp(found[2]) == pytest.approx(late * DT, rel=0.05)


def test_a_search_starts_from_it_and_an_identification_goes_without_one_that_misleads(monkeypatch):
    """Its result spoilt, the search from it explains nothing; the search without it finds the plant."""
    record, solve = swept(0.01), optimistix.least_squares
    problem = build_problem([record], "linear", [Beginning("moving", 1.0, 0.0, 0.0, 0, True)])

    def searched():
        found = frequency_response(problem)
        return search(problem, found, orders=[2], holds=["foh"], delays=[False], progress=lambda line: None)[0]

    def spoilt(fn, solver, y0, **how):
        found = solve(fn, solver, y0, **how)
        return type("Spoilt", (), {"value": found.value - 12.0})

    assert searched().score < 0.02
    monkeypatch.setattr(optimistix, "least_squares", spoilt)
    assert searched().score > HALF
    found = identify([record], order=2, input_map="linear", hold="foh", leave_out=("delay",)).chosen
    np.testing.assert_allclose(found.coefficients[:3] * A[0], A, rtol=0.01)


@pytest.mark.slow
def test_sines_far_below_a_third_pole_start_it_nowhere():
    """The lower half of a cone's protocol: the fit in frequency moves the pole to infinity, the one in time decides."""
    sines = pitp.excitation.protocol(kind("cone100"), "train")
    low = list(measure(pitp.plant("cone100"), sines[: len(sines) // 2]))
    fit = identify(low, order=3)
    assert fit.model.order == 3 and np.isfinite(fit.chosen.coefficients).all()
