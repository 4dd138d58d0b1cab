"""Free runs as one least-squares problem: slopes are those of the errors, on one core, on many, on a mesh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from normal import normal_equations

from pitp_jax import records_mesh, rest_state
from pitp_jax.method.fit import free_run_problem
from pitp_jax.method.fit.forward_sensitivity import Runs
from pitp_jax.method.fit.free_run_problem import FreeRuns
from pitp_jax.method.fit.lower_bound import LowerBound
from pitp_jax.method.fit.parameters import parameters

DT, EVERY = 2e-3, 3


@pytest.fixture(scope="module")
def problem(nonlinear):
    """A model, two batches of runs off it, and a prior."""
    model = nonlinear(2, key=2, size=0.1, tau=(0.015, 0.06, 0.3), dt=DT)
    rng = np.random.default_rng(4)

    def runs(count, samples):
        start = np.tile(np.asarray(rest_state(model)), (count, 1))
        drawn = rng.uniform(0, 900, (count, samples)), rng.normal(0.3, 0.4, (count, samples))
        weight = rng.uniform(0.5, 2, (count, samples))
        return Runs(*(jnp.asarray(a, jnp.float32) for a in (start, *drawn, weight)))

    vector, _ = parameters(model)
    prior = rng.uniform(0.1, 1, len(vector)), vector + rng.normal(0, 1, len(vector))
    return model, (runs(13, 200), runs(3, 90)), prior, vector


def built(problem, **how):
    model, batches, prior, _ = problem
    return FreeRuns(model, batches, DT, EVERY, prior=prior, **how)


def sums(runs, vector):
    errors, slopes = runs.errors(vector), [np.asarray(s) for s in runs.slopes(vector)]
    assert [s.shape[:-1] for s in slopes] == [e.shape for e in errors]
    rows = [s.reshape(-1, len(vector)).astype(np.float64) for s in slopes]
    flat = [e.ravel().astype(np.float64) for e in errors]
    return (
        sum(e @ e for e in flat),
        sum(s.T @ e for s, e in zip(rows, flat, strict=True)),
        sum(s.T @ s for s in rows),
    )


def close(found, truth):
    for a, b in zip(found, truth, strict=True):
        assert np.isfinite(b).all()
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-5 * np.abs(b).max())


@pytest.mark.slow
def test_they_are_the_normal_equations_and_the_prior(problem):
    model, batches, (rho, centre), vector = problem
    parts = [normal_equations(model, runs, DT, EVERY, vector) for runs in batches]
    away = vector - centre
    truth = (
        sum(p.cost for p in parts) + (rho * away) @ away,
        sum(p.gradient for p in parts) + rho * away,
        sum(p.hessian for p in parts) + np.diag(rho),
    )
    close(sums(built(problem), vector), truth)


@pytest.mark.slow
@pytest.mark.parametrize("cores", [1, 2, 3, 64])
def test_runs_are_shared_among_cores(problem, cores, monkeypatch):
    """Thirteen runs in parts of equal size, a core has at least four: the sums of all at once, to rounding."""
    truth = sums(built(problem, mesh=records_mesh(jax.devices()[:1])), problem[3])
    monkeypatch.setattr(free_run_problem, "cores", lambda: cores)
    shared = built(problem)
    assert [part.voltage.shape[1] for part in shared._parts] == [200] * min(cores, 3) + [90]
    assert len({part.voltage.shape for part in shared._parts}) == 2
    weight = sum(float(part.weight.sum()) for part in shared._parts)
    assert weight == pytest.approx(sum(float(runs.weight.sum()) for runs in problem[1]), rel=1e-6)
    close(sums(shared, problem[3]), truth)


@pytest.mark.slow
def test_very_many_are_cut(problem, monkeypatch):
    """Beyond what stays in a core's memory: more parts than cores."""
    monkeypatch.setattr(free_run_problem, "cores", lambda: 2)
    monkeypatch.setattr(free_run_problem, "_MOST_RUNS", 3)
    cut = built(problem)
    assert [part.voltage.shape for part in cut._parts] == [(3, 200)] * 5 + [(3, 90)]
    close(sums(cut, problem[3]), sums(built(problem, mesh=records_mesh(jax.devices()[:1])), problem[3]))


@pytest.mark.slow
def test_slopes_of_bounded_parameters_follow_the_chain_rule(problem):
    """dr/dv = dr/dp dp/dv, with a bound so near to the time constants that they differ from their coordinates."""
    vector = problem[3]
    least = np.full(len(vector), -np.inf)
    least[-3:] = vector[-3:] - 0.3  # the logarithms of the lags
    bound = LowerBound(least)
    there = bound.coordinates(vector)
    near, free = built(problem, bound=bound), built(problem)
    assert (bound.slopes(there) < 1).sum() == 3
    prior = len(free._parts)  # its block changes with the coordinates
    for k, (one, other) in enumerate(zip(near.slopes(there), free.slopes(vector), strict=True)):
        if k != prior:
            np.testing.assert_allclose(one, other * bound.slopes(there), rtol=1e-4, atol=1e-4 * np.abs(other).max())
    for k, (one, other) in enumerate(zip(near.errors(there), free.errors(vector), strict=True)):
        if k != prior:
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4 * np.abs(other).max())
