"""A stream of blocks of any sizes gives the voltages of the whole path at once."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pitp_jax import BadInput, Model, invert_stream
from pitp_jax.method.invert.equation import invert_path
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.numerics.spline_derivative import derivatives

DT = 1e-3


def path(samples, order):
    t = np.arange(samples) * DT
    return 4e-4 * np.sin(np.pi * t) ** (2 * order) * (1.2 + np.sin(17 * t)) + 1e-4 * (1 - np.cos(3 * t)) ** 2


def whole(model, x):
    equation = derivatives(x, DT, model.order) / np.asarray(model.scales.state)
    return invert_path(model, jnp.asarray(equation, jnp.float32), DT)


@pytest.fixture(scope="module")
def models(nonlinear):
    lag = ElectrodeLag(jnp.asarray(np.log(4e-3), jnp.float32))
    lagging: dict[int | str, Model] = {n: eqx.tree_at(lambda m: m.drive, nonlinear(n), lag) for n in (2, 3)}
    lagging["ringing"] = eqx.tree_at(lambda m: m.drive, nonlinear(2, ring=(60.0, 0.1)), lag)
    return lagging | {"elapsed": eqx.tree_at(lambda m: (m.memory, m.encoder), nonlinear(2, tau=(0.1,)),
                                             (ElapsedTime(7.0), nonlinear(2, tau=(0.1,)).encoder))}  # fmt: skip


@pytest.mark.slow
@settings(max_examples=10, deadline=None, derandomize=True)
@given(
    key=st.sampled_from((2, 3, "elapsed", "ringing")),
    samples=st.just(1301),
    cuts=st.lists(st.floats(0, 1), max_size=6),
    window=st.just(600),
)
def test_blocks_equal_the_whole(models, key, samples, cuts, window):
    model = models[key]
    x = path(samples, model.order)
    blocks = np.split(x, sorted(int(c * samples) for c in cuts))
    pieces = list(invert_stream(model, blocks, DT, window=window))
    found = np.concatenate([p.voltage for p in pieces])
    force, voltage, _ = (np.asarray(a, np.float64) for a in whole(model, x))
    assert found.shape == voltage.shape
    # u = sqrt(F) magnifies rounding near F = 0: compare where the force is not lost in it
    clear = np.convolve(np.abs(force) < 3e-4, np.ones(9), "same") == 0
    assert clear.mean() > 0.5
    np.testing.assert_allclose(found[clear], voltage[clear], rtol=0, atol=5e-5 * voltage.max())
    assert (np.concatenate([p.infeasible for p in pieces])[clear] == (force < 0)[clear]).all()


def test_memory_does_not_grow(models):
    """Every piece is a window long, however long the stream is."""
    block = path(500, 2)
    sizes = [len(p.voltage) for p in invert_stream(models[2], (block for _ in range(40)), DT, window=1000)]
    assert sum(sizes) == 20_000
    assert max(sizes) <= 1000


def test_a_reversed_sensor_does_not_change_a_target(linear):
    """A target is measured from 0 V and grows as the actuator extends."""
    plain, turned = linear(2), linear(2, offset=3e-3, polarity=-1.0)
    x = path(2000, 2)
    a, b = ([p.voltage for p in invert_stream(m, [y], DT)] for m, y in ((plain, x), (turned, x)))
    np.testing.assert_allclose(np.concatenate(a), np.concatenate(b), rtol=0, atol=1e-3 * np.concatenate(a).max())


def test_too_short_a_stream_is_refused(models):
    with pytest.raises(BadInput, match="samples"):
        list(invert_stream(models[2], [np.zeros(4)], DT))


def test_a_missing_sample_is_told_with_its_place(models):
    blocks = [np.zeros(300), np.where(np.arange(300) == 41, np.nan, 0.0)]
    with pytest.raises(BadInput, match="sample 341 "):
        list(invert_stream(models[2], blocks, DT, window=64))


@pytest.mark.parametrize(("dt", "window"), [(DT, 4), (0.0, 64), (-DT, 64)])
def test_what_cannot_run_is_refused_at_once(models, dt, window):
    with pytest.raises(BadInput, match="must be positive"):
        invert_stream(models[2], [], dt, window=window)
