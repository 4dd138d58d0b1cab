"""The fast inverse against the plain one, and filtered derivatives against the spline and closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pitp_jax.method.invert.equation import invert_path, scaled_equation
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.numerics import spline_derivative
from pitp_jax.method.numerics.spline_derivative import derivatives, fast_derivatives, inner, reach

DT = 1e-3


@settings(max_examples=20, deadline=None, derandomize=True)
@given(order=st.integers(1, 6), samples=st.sampled_from((500, 1200)), seed=st.integers(0, 10**6))
def test_filtered_derivatives_are_the_splines(order, samples, seed):
    """On noise as well: in units of a sample every derivative is of order one."""
    x = np.random.default_rng(seed).normal(0, 1, samples)
    found, truth = fast_derivatives(x, 1.0, order), derivatives(x, 1.0, order)
    assert found.shape == truth.shape
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-10 * np.abs(truth).max())


@pytest.mark.parametrize(("order", "limit"), [(2, 3e-6), (4, 3e-4)])
def test_derivatives_of_a_sine(order, limit):
    dt = 0.05
    t = np.arange(700) * dt
    truth = np.stack([np.sin(t + k * np.pi / 2) for k in range(order + 1)], -1)
    inside = slice(reach(order), -reach(order))
    found = inner(np.sin(t), dt, order)
    np.testing.assert_allclose(found, truth[inside], rtol=0, atol=limit)
    assert np.abs(found - truth[inside]).max() > 1e-12  # a spline, not the function


def test_reach_is_as_far_as_anything_is_felt():
    """A sample beyond the reach changes nothing, the next one in does."""
    r = reach(2)

    def felt(distance):
        """By x and its two derivatives at sample 2 R of an impulse that far away."""
        return np.abs(inner(np.eye(5 * r)[2 * r + distance], 1.0, 2)[r]).max()

    assert felt(1) > 0.1
    assert felt(r) < 1e-16


def paths(order, samples):
    t = np.arange(samples) * DT
    return 3e-4 * np.sin(2.5 * np.pi * t) ** (2 * order) * (1.3 + np.sin(19 * t))


def lagging(model):
    return eqx.tree_at(lambda m: m.drive, model, ElectrodeLag(jnp.asarray(-5.5, jnp.float32)))


@pytest.fixture(scope="module")
def models(nonlinear):
    linear_input = eqx.tree_at(lambda m: m.input_map, nonlinear(1), LinearInput())
    aged = eqx.tree_at(lambda m: m.memory, nonlinear(2, tau=(0.1,)), ElapsedTime(2.0))
    return {"order 1, linear": linear_input, "order 2, electrode": lagging(nonlinear(2)), "order 3": nonlinear(3),
            "elapsed time": aged, "second mass": nonlinear(2, ring=(60.0, 0.1)),
            "frugal": nonlinear(2, frugal=True)}  # fmt: skip


def instant_by_instant(model, equation):
    """Force, voltage and features with the tokens read at one instant, vmapped."""

    def force(f, x):
        tokens, offset = model.tokens(f)
        return tokens @ x + offset

    memory = model.memory.trajectory(equation[:, 0], DT, model.memory.initial(jnp.zeros(())))
    features = jnp.concatenate([equation[:, :-1], memory], 1)
    found = jax.jit(jax.vmap(force))(features, equation)
    return found, model.drive.lead(model.input_map.voltage(found * model.scales.force), DT), features


@pytest.mark.slow
@example(name="second mass", size=3e-4, hz=2.0, seed=1)
@example(name="frugal", size=3e-4, hz=2.0, seed=1)
@settings(max_examples=24, deadline=None, derandomize=True)
@given(
    name=st.sampled_from(("order 1, linear", "order 2, electrode", "order 3", "elapsed time")),
    size=st.floats(1e-5, 5e-4), hz=st.floats(0.3, 4.0), seed=st.integers(0, 10**6),
)  # fmt: skip
def test_equals_the_plain_path(models, shake, name, size, hz, seed):
    """Any weights, any motion: the same force, and the same voltage away from the root's corner at F = 0."""
    model = eqx.tree_at(lambda m: m.encoder, models[name], shake(models[name].encoder, 0.1, seed))
    t = np.arange(700) * DT
    x = size * np.sin(np.pi * hz * t) ** (2 * model.order) * (1.3 + np.sin(19 * t))
    equation = jnp.asarray(derivatives(x, DT, model.order) / np.asarray(model.scales.state), jnp.float32)
    (force, voltage, features), truth = invert_path(model, equation, DT), instant_by_instant(model, equation)
    scale = float(jnp.abs(truth[0]).max())
    np.testing.assert_allclose(force, truth[0], rtol=0, atol=5e-6 * scale)
    np.testing.assert_allclose(features, truth[2], rtol=0, atol=1e-6)
    clear = np.convolve(np.abs(truth[0]) < 1e-2 * scale, np.ones(9), "same") == 0
    np.testing.assert_allclose(voltage[clear], truth[1][clear], rtol=0, atol=1e-3 * max(np.abs(truth[1]).max(), 1.0))


def test_from_displacement(models):
    model = models["order 2, electrode"]
    x = paths(2, 1500)
    equation = jnp.asarray(derivatives(x, DT, 2) / np.asarray(model.scales.state), jnp.float32)
    force, truth, _ = (np.asarray(a) for a in invert_path(model, equation, DT))
    clear = np.convolve(np.abs(force) < 1e-3 * np.abs(force).max(), np.ones(9), "same") == 0
    found = np.asarray(invert_path(model, scaled_equation(model, fast_derivatives(x, DT, 2)), DT)[1])
    np.testing.assert_allclose(found[clear], truth[clear], rtol=0, atol=3e-4 * truth.max())


def test_short_paths_are_the_splines():
    x = np.random.default_rng(0).normal(0, 1, 30)
    np.testing.assert_array_equal(fast_derivatives(x, DT, 2), derivatives(x, DT, 2))
    assert spline_derivative.reach(2) > 30
