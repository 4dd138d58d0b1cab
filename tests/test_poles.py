"""Stable polynomials by construction, and exact responses to sampled voltages."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from pitp_jax.method.identify.linear_ode import (
    bounded,
    coast,
    logs_from_roots,
    poles,
    polynomial,
    polynomial_slopes,
    respond,
    respond_with_slopes,
)

STEP = 0.4


def coefficients(logs):
    return polynomial(np.asarray(logs, float))


def run(logs, drive, *, square, hold, step=STEP, settled=False):
    return respond(np.asarray(logs, float), drive, step=step, square=square, hold=hold, settled=settled)


decay = st.floats(0.05, 3.0)
pairs = st.lists(st.tuples(decay, st.floats(0.05, 4.0)), max_size=3)
reals = st.lists(st.floats(0.05, 5.0), max_size=2)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(pairs, reals)
def test_every_stable_polynomial_is_reached(pairs, reals):
    roots = [r for a, b in pairs for r in (-a + 1j * b, -a - 1j * b)] + [-a + 0j for a in reals]
    if not roots:
        return
    truth = np.poly(roots).real[::-1]
    np.testing.assert_allclose(coefficients(logs_from_roots(np.array(roots))), truth, rtol=1e-9)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(st.floats(-2.5, 2.5), min_size=1, max_size=4))
def test_any_logarithms_are_stable(logs):
    poly = coefficients(np.array(logs))
    assert poly[-1] == 1 and (poly > 0).all()
    assert np.roots(poly[::-1]).real.max() < 0


def test_unstable_roots_are_reflected():
    logs = logs_from_roots(np.array([0.5 + 2j, 0.5 - 2j, 3.0]))
    np.testing.assert_allclose(
        np.sort_complex(np.roots(coefficients(logs)[::-1])), np.sort_complex(np.array([-0.5 + 2j, -0.5 - 2j, -3.0]))
    )


LOGS = {1: [0.2], 2: [-1.5, 0.1], 3: [-1.0, 0.3, 0.8], 4: [-1.5, 0.1, 0.5, 1.9]}


def system(logs):
    poly = coefficients(logs)
    n = len(logs)
    a = np.eye(n, k=1)
    a[-1] = -poly[:-1]
    return a, np.append(np.zeros(n - 1), poly[0])[:, None], np.eye(n)[:1], np.zeros((1, 1))


@pytest.mark.parametrize("order", LOGS)
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_linear_drive_against_scipy(order, hold):
    """From rest; and from the equilibrium of the first sample, where nothing moves until the drive does."""
    drive = np.random.default_rng(order).standard_normal(60)
    truth = lsim(system(LOGS[order]), drive, np.arange(60) * STEP, interp=hold == "foh")[1]
    np.testing.assert_allclose(run(LOGS[order], drive, square=False, hold=hold), truth, rtol=0, atol=1e-10)
    before = np.append(np.full(900, drive[0]), drive)
    settled = lsim(system(LOGS[order]), before, np.arange(960) * STEP, interp=hold == "foh")[1][900:]
    found = run(LOGS[order], drive, square=False, hold=hold, settled=True)
    np.testing.assert_allclose(found, settled, rtol=0, atol=1e-8)


@pytest.mark.parametrize("order", LOGS)
def test_free_responses_span_every_initial_state(order):
    start = np.random.default_rng(order).standard_normal(order)
    truth = lsim(system(LOGS[order]), np.zeros(60), np.arange(60) * STEP, X0=start)[1]
    columns, rings = coast(np.asarray(LOGS[order], float), 60, step=STEP)
    left = truth - columns @ np.linalg.lstsq(columns, truth, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 and rings.sum() == 2 * (order // 2)


@pytest.mark.parametrize("logs", [[-np.inf], [0.2, -np.inf], [-1.5, 0.1, -np.inf]])
def test_a_pole_at_zero_against_scipy(logs):
    """Without a spring: the response of unit rate, its slopes and its rate, and every initial state."""
    drive, poly, n = np.random.default_rng(len(logs)).standard_normal(60), coefficients(logs), len(logs)
    plant = (*system(logs)[:1], poly[1] * np.eye(n)[:, -1:], np.eye(n)[:1], np.zeros((1, 1)))
    truth = lsim(plant, drive, np.arange(60) * STEP)[1]
    how = {"step": STEP, "square": False, "hold": "foh"}
    found, by_logs, rate = respond_with_slopes(np.array(logs), drive, **how)
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-10)
    np.testing.assert_allclose(respond(np.array(logs), drive, **how), truth, rtol=0, atol=1e-10)
    np.testing.assert_allclose(by_logs.T, slopes(lambda z: respond(z, drive, **how), logs), rtol=0, atol=1e-7)
    early, late = (respond(np.array(logs), drive, late=t, **how) for t in (2.0, 2.0 + 1e-6))
    np.testing.assert_allclose(rate[3:-3], (early - late)[5:-1] / (1e-6 * STEP), rtol=0, atol=1e-4)
    start = np.random.default_rng(9).standard_normal(n)
    free = lsim(plant, np.zeros(60), np.arange(60) * STEP, X0=start)[1]
    columns, _ = coast(np.array(logs), 60, step=STEP)
    assert np.abs(free - columns @ np.linalg.lstsq(columns, free, rcond=None)[0]).max() < 1e-9


@pytest.mark.parametrize(("apart", "moved"), [(1.3e-5, False), (0.8e-5, True)])
def test_two_poles_are_separated_within_a_hundred_thousandth(apart, moved):
    """(s^2 + 4 s + 3)(s + 1 + apart): its roots, or the third away from the second."""
    found = np.sort(np.real(poles(np.log([4.0, 3.0, 1 + apart]))))
    np.testing.assert_allclose(found, [-3, -1 - apart, -1], rtol=0, atol=2e-4 if moved else 1e-9)
    assert np.diff(found).min() > 1e-5


def test_two_poles_at_one_place():
    """(s + 1)^2: partial fractions do not exist, and the response is right nevertheless."""
    drive = np.random.default_rng(0).standard_normal(60)
    truth = lsim(([1.0], [1.0, 2.0, 1.0]), drive, np.arange(60) * STEP)[1]
    found = run([np.log(2.0), 0.0], drive, square=False, hold="foh")
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-8)


@pytest.mark.parametrize("order", [1, 3])
def test_squared_ramps_against_an_adaptive_solver(order):
    """The force u(t)^2 of a voltage linear between samples, integrated sample by sample to 1e-11."""
    drive = np.random.default_rng(3).standard_normal(12)
    a, b, *_ = system(LOGS[order])
    state, truth = np.zeros(order), [0.0]
    for now, later in zip(drive[:-1], drive[1:], strict=True):

        def slope(t, s, now=now, later=later):
            return a @ s + b[:, 0] * (now + (later - now) * t / STEP) ** 2

        state = solve_ivp(slope, (0, STEP), state, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        truth.append(state[0])
    np.testing.assert_allclose(run(LOGS[order], drive, square=True, hold="foh"), truth, rtol=0, atol=1e-9)
    held = lsim(system(LOGS[order]), drive**2, np.arange(12) * STEP, interp=False)[1]
    np.testing.assert_allclose(run(LOGS[order], drive, square=True, hold="zoh"), held, rtol=0, atol=1e-10)


def test_finer_samples_of_the_same_ramps_change_nothing():
    drive = np.random.default_rng(4).standard_normal(40)
    fine = np.interp(np.arange(39 * 5 + 1) / 5, np.arange(40), drive)
    coarse = run(LOGS[2], drive, square=True, hold="foh")
    np.testing.assert_allclose(run(LOGS[2], fine, square=True, hold="foh", step=STEP / 5)[::5], coarse, atol=1e-11)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_unit_static_gain(hold):
    assert run(LOGS[3], np.full(400, 1.7), square=True, hold=hold)[-1] == pytest.approx(1.7**2, rel=1e-9)


def slopes(fn, logs):
    """Central differences of fn by the logarithms, last axis."""
    logs = np.asarray(logs, float)
    return np.stack([(fn(logs + h) - fn(logs - h)) / 2e-6 for h in 1e-6 * np.eye(len(logs))], -1)


@pytest.mark.parametrize("order", LOGS)
def test_slopes_against_differences(order):
    logs = np.asarray(LOGS[order])
    np.testing.assert_allclose(polynomial_slopes(logs), slopes(polynomial, logs), rtol=0, atol=1e-7)


def test_a_pole_far_above_the_samples_is_not_seen():
    """A third pole that decays by e^30 a sample delays the response by 1/30 of one, and rounding stays away."""
    drive = np.sin(0.05 * np.arange(500)) + 1
    third = run([*LOGS[2], np.log(30 / 0.05)], drive, square=True, hold="foh", step=0.05)
    second = run(LOGS[2], drive, square=True, hold="foh", step=0.05)
    late = np.interp(np.arange(500) - 1 / 30, np.arange(500), second)
    np.testing.assert_allclose(third[5:], late[5:], rtol=0, atol=5e-4)  # of 8; the delay is 8e-3


def test_a_pole_too_fast_moves_no_other():
    moved = poles(bounded(logs_from_roots(np.array([-1e4, -16.0, -3 + 4j, -3 - 4j])), 0.0, 600.0))
    assert sorted(np.abs(moved)) == pytest.approx([5.0, 5.0, 16.0, 600.0])


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("late", [0.0, 2.0, 3.4])
def test_records_one_after_another_against_scipy_on_each(hold, late):
    """Of different lengths, shorter than the delay too; two start at rest, two settled at their first input.

    SciPy simulates each of them alone, five times as finely, with the input delayed by whole fine samples.
    """
    rng, lengths, settled = np.random.default_rng(5), (60, 17, 3, 41), np.array([False, True, True, False])
    drives = [np.append(1.5 * s, rng.standard_normal(n - 1)) for n, s in zip(lengths, settled, strict=True)]
    truth = []
    for drive in drives:
        at = np.arange(5 * len(drive) - 4) / 5
        fine = np.interp(at, np.arange(len(drive)), drive) if hold == "foh" else drive[at.astype(int)]
        before = 4500 + round(5 * late)
        driven = lsim(system(LOGS[3]), np.append(np.full(before, drive[0]), fine),
                      np.arange(before + len(fine)) * STEP / 5, interp=hold == "foh")[1]  # fmt: skip
        truth.append(driven[4500::5][: len(drive)])
    how = {"step": STEP, "square": False, "hold": hold, "settled": settled, "heads": np.cumsum([0, *lengths[:-1]])}
    logs, drive = np.array(LOGS[3]), np.concatenate(drives)
    found, by_logs, rate = respond_with_slopes(logs, drive, late=late, **how)
    np.testing.assert_allclose(found, np.concatenate(truth), rtol=0, atol=1e-8)
    np.testing.assert_allclose(by_logs.T, slopes(lambda z: respond(z, drive, late=late, **how), logs), atol=1e-7)
    if late % 1:
        early, after = (respond(logs, drive, late=late + h, **how) for h in (-1e-6, 1e-6))
        np.testing.assert_allclose(rate, (early - after) / (2e-6 * STEP), rtol=0, atol=1e-6)


@pytest.mark.parametrize("hold", ["bandlimited", "cubic"])
def test_no_record_reaches_into_its_neighbour(hold):
    """One after another, each responds as alone."""
    rng, lengths = np.random.default_rng(6), (40, 12, 25)
    drives = [rng.standard_normal(n) for n in lengths]
    how = {"step": STEP, "square": True, "hold": hold, "settled": True, "late": 1.3}
    alone = [respond(np.array(LOGS[2]), drive, **how) for drive in drives]
    both = respond(np.array(LOGS[2]), np.concatenate(drives), heads=np.cumsum([0, *lengths[:-1]]), **how)
    np.testing.assert_allclose(both, np.concatenate(alone), rtol=0, atol=1e-12)
