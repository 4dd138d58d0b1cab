"""The output error of several records against one dense least-squares problem, simulated by SciPy."""

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax.method.identify.output_error import OutputError, Structure, build_problem
from pitp_jax.method.signal.initial_state import Beginning
from pitp_jax.method.signal.record import Record

DT, LENGTHS = 0.02, (90, 64, 120, 75)
OMEGA, DAMPING, GAIN = 9.0, 0.2, 3e-3
PLANT = ([OMEGA**2], [1.0, 2 * DAMPING * OMEGA, OMEGA**2])
# at rest with an offset of its own; settled and in motion with one in common, one of them reversed; a known offset
BEGINNINGS = [
    Beginning("rest", 1.0, 0.0, 0.0, 0, True), Beginning("held", -1.0, 0.0, 0.0, 1, True),
    Beginning("moving", 1.0, 0.0, 0.0, 1, True), Beginning("moving", 1.0, 0.01, 0.0, 2, False),
]  # fmt: skip


@pytest.fixture(scope="module")
def recorded():
    rng, records = np.random.default_rng(0), []
    for k, (samples, b) in enumerate(zip(LENGTHS, BEGINNINGS, strict=True)):
        time = np.arange(samples) * DT
        drive = (b.begins != "rest") + np.sin((2 + k) * time)
        state = {"rest": [0, 0], "held": [0, drive[0] / OMEGA**2], "moving": rng.standard_normal(2) * [0.1, 0.02]}
        x = lsim(PLANT, drive, time, X0=state[b.begins])[1]
        y = b.direction * GAIN * x + b.zero + 2e-3 * (b.group == 1) + 1e-6 * rng.standard_normal(samples)
        y[rng.integers(1, samples, 6)] = np.nan
        records.append(Record(f"r{k}", time, drive, y))
    return records


def dense(records, params, ridge):
    """Rows and values of one least-squares problem: gain, two offsets, two initial states of two records."""
    wn, problem = np.exp(params[1] / 2), build_problem(records, "linear", BEGINNINGS)
    plant = ([wn**2], [1.0, np.exp(params[0]), wn**2])
    rows, values = [], []
    for k, (r, b) in enumerate(zip(records, BEGINNINGS, strict=True)):
        start = [0, r.voltage[0] / wn**2] if b.begins != "rest" else [0, 0]
        row = np.zeros((r.samples, 7))
        row[:, 0] = lsim(plant, r.voltage, r.time, X0=start)[1]
        if b.free:
            row[:, 1 + b.group] = b.direction
        seen = np.isfinite(r.displacement)
        rows, values = [*rows, row], [*values, b.direction * (r.displacement - b.zero) / problem.scale]
        if b.begins == "moving":
            pole = np.roots(plant[1])[0]
            free = np.exp(pole * r.time)
            at = 3 + 2 * (k - 2)
            row[:, at], row[:, at + 1] = free.real, free.imag
            weak = np.zeros((2, 7))
            weak[0, at] = weak[1, at + 1] = ridge * np.sqrt(seen.sum())
            rows, values = [*rows, weak], [*values, np.zeros(2)]
    rows, values = np.concatenate(rows), np.concatenate(values)
    return rows[np.isfinite(values)], values[np.isfinite(values)], problem


def cost(records, params):
    rows, values, _ = dense(records, params, 1e-3)
    factors = np.linalg.lstsq(rows, values)[0]
    return float(np.sum((values - rows @ factors) ** 2)), factors


START = np.log([2.3 * DAMPING * OMEGA, 1.1 * OMEGA**2])


def test_gain_offsets_and_initial_states_solve_the_dense_problem(recorded):
    solved = OutputError(START, Structure(2), dense(recorded, START, 0.0)[2]).solved
    truth, factors = cost(recorded, START)
    np.testing.assert_allclose(solved.gains, factors[:3], rtol=1e-7)
    np.testing.assert_allclose(np.abs(np.concatenate(solved.own)), np.abs(factors[3:]), rtol=1e-6)
    assert float(solved.rows @ solved.rows) == pytest.approx(truth, rel=1e-9)


def test_the_gradient_is_the_slope_of_the_cost(recorded):
    found = OutputError(START, Structure(2), dense(recorded, START, 0.0)[2]).normal_equations()
    slopes = [(cost(recorded, START + h)[0] - cost(recorded, START - h)[0]) / 2e-5 for h in 1e-5 * np.eye(2)]
    np.testing.assert_allclose(2 * found.gradient, slopes, rtol=1e-6)


def test_the_hessian_predicts_the_residual_beside_the_minimum(recorded):
    """For residuals that are small, H is the second derivative of half the cost."""
    at = np.log([2 * DAMPING * OMEGA, OMEGA**2])
    found, step = OutputError(at, Structure(2), dense(recorded, at, 0.0)[2]).normal_equations(), 1e-3
    away = [[cost(recorded, at + step * (s * a + t * b))[0] for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            for a, b in ((np.eye(2)[i], np.eye(2)[j]) for i in range(2) for j in range(2))]  # fmt: skip
    second = [(pp - pm - mp + mm) / (4 * step**2) for pp, pm, mp, mm in away]
    np.testing.assert_allclose(found.hessian.reshape(-1), np.array(second) / 2, rtol=0.02, atol=1e-3 * max(second))
