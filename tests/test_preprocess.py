"""Filtering and differentiation against closed forms."""

import numpy as np
import pytest
from scipy.signal import butter, sosfreqz

from pitp_jax import BadInput, Record
from pitp_jax.method.signal.derivative import central, stencil
from pitp_jax.method.signal.preprocess import cutoff, edge_samples, force_band, preprocess, stretches

FS = 1000.0


def record(displacement, fs=FS, voltage=None):
    time = np.arange(len(displacement)) / fs
    return Record("r", time, np.ones_like(time) if voltage is None else voltage, displacement)


def derivatives(f, time, order):
    w = 2 * np.pi * f
    return np.stack([w**i * np.sin(w * time + 0.3 + i * np.pi / 2) for i in range(order + 1)], axis=1)


@pytest.mark.parametrize(("difference", "order"), [(central, 2), (stencil, 8)])
def test_order_of_convergence(difference, order):
    errors = []
    for count in (40, 80):
        t = np.linspace(0, 1, count + 1)
        error = difference(np.sin(6 * t), t[1]) - 6 * np.cos(6 * t)
        errors.append(np.abs(error[5:-5]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize(("reach", "order"), [(0, 2), (1, 2), (2, 4), (3, 6)])
def test_order_near_the_ends(reach, order):
    errors = []
    for dt in (0.04, 0.02):
        t = dt * np.arange(20)
        error = stencil(np.exp(t), dt) / np.exp(t) - 1  # relative: the same wherever a sample lies
        errors.append(max(abs(error[reach]), abs(error[-1 - reach])))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


def test_polynomials_are_exact():
    t = 0.1 * np.arange(12)
    np.testing.assert_allclose(stencil(t**2, 0.1), 2 * t, atol=1e-12)
    np.testing.assert_allclose(stencil(t**8, 0.1)[4:-4], (8 * t**7)[4:-4], rtol=1e-9)
    np.testing.assert_allclose(central(3 * t + 1, 0.1), 3.0, atol=1e-12)


def test_eq_8_attenuates_and_the_stencil_does_not():
    t = 1e-3 * np.arange(500)
    x = np.sin(330 * t)  # w dt = 0.33
    inside = slice(50, -50)

    def gain(difference):
        return difference(difference(x, 1e-3), 1e-3)[inside] @ x[inside] / (-(330**2) * x[inside] @ x[inside])

    assert gain(central) == pytest.approx(1 - 0.036, abs=1e-3)
    assert gain(stencil) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("f", "cutoff_hz"), [(5.0, 100.0), (2.0, 20.0), (40.0, 380.0)])
def test_states_of_a_sine_are_its_derivatives_times_the_filter_gain(f, cutoff_hz):
    time = np.arange(4000) / FS
    truth = derivatives(f, time, 3)
    out = preprocess(record(truth[:, 0]), 3, cutoff_hz, truth[:, 0])
    sos = butter(4, 2 * cutoff_hz / FS, output="sos")
    _, response = sosfreqz(sos, np.array([2 * np.pi * f / FS]))
    gain = np.abs(np.asarray(response)[0]) ** 2
    scale = np.sqrt(np.mean(truth**2, axis=0))
    error = (out.states - gain * truth)[out.valid] / scale
    assert np.abs(error).max() < 0.03
    middle = (out.states - gain * truth)[1500:2500] / scale
    assert np.abs(middle[:, :3]).max() < 1e-4  # no phase: the filter runs both ways
    assert out.states.shape == (4000, 4)
    assert out.valid.sum() == 4000 - 2 * edge_samples(cutoff_hz, 1 / FS, 3)


def test_force_and_states_are_filtered_alike():
    """An equation that holds before filtering holds after, noise and all: 2 x + 0.03 x' = F."""
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.normal(size=5000)) * 0.05
    force = 2 * x + 0.03 * stencil(x, 1 / FS)
    out = preprocess(record(x), 1, 30.0, force)
    residual = out.states @ np.array([2.0, 0.03]) - out.force
    assert np.abs(residual[out.valid]).max() < 0.02 * out.force.std()
    assert np.abs(residual[500:-500]).max() < 1e-9 * np.abs(force).max()


def test_gaps_are_flagged_and_do_not_leak():
    time = np.arange(3000) / FS
    x = np.sin(2 * np.pi * 3 * time)
    holed = x.copy()
    holed[1000:1200] = np.nan
    holed[2500:2520] = np.nan
    holed[2530:2540] = np.nan
    out = preprocess(record(holed), 2, 60.0, x)
    edge = edge_samples(60.0, 1 / FS, 2)
    assert not out.valid[1000 - edge : 1200 + edge].any()
    assert out.valid[1000 - edge - 1]
    assert out.valid[1200 + edge]
    assert not out.valid[2500 - edge : 2540 + edge].any()  # the stretch of 10 samples is too short
    assert np.isfinite(out.states).all()
    assert np.abs(out.states[:, 0]).max() < 1.01
    spoiled = x.copy()
    spoiled[1200:] += 5.0  # another side of the gap cannot matter
    spoiled[1000:1200] = np.nan
    other = preprocess(record(spoiled), 2, 60.0, x)
    np.testing.assert_array_equal(other.states[:1000], out.states[:1000])
    scale = (2 * np.pi * 3) ** np.arange(3)
    error = (out.states - derivatives_of_sine(3.0, time))[out.valid] / scale
    assert np.abs(error).max() < 0.03


def derivatives_of_sine(f, time):
    w = 2 * np.pi * f
    return np.stack([np.sin(w * time), w * np.cos(w * time), -(w**2) * np.sin(w * time)], axis=1)


def test_edge_errors_are_small_on_broad_band_motion():
    """What `valid` keeps differs little from the same samples filtered inside a longer record."""
    rng = np.random.default_rng(1)
    time = np.arange(6000) / FS
    for cutoff_hz in (30.0, 100.0, 300.0):
        tones = np.linspace(0.02, 0.5, 12) * cutoff_hz
        x = np.sum([rng.normal() * np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in tones], axis=0)
        whole = preprocess(record(x), 3, cutoff_hz, x)
        part = preprocess(record(x[2000:4000]), 3, cutoff_hz, x[2000:4000])
        error = np.abs(part.states - whole.states[2000:4000])[part.valid]
        assert (error.max(axis=0) < np.array([0.002, 0.004, 0.01, 0.02]) * whole.states.std(axis=0)).all()


def test_nothing_long_enough_is_all_invalid_but_finite():
    x = np.sin(np.arange(300) / 20.0)
    x[::10] = np.nan
    out = preprocess(record(x), 2, 30.0, np.zeros(300))
    assert not out.valid.any()
    assert np.isfinite(out.states).all()


def test_corrected_displacement_and_literal_difference():
    x = np.sin(np.arange(1000) / 30.0)
    plain = preprocess(record(x), 1, 100.0, x)
    shifted = preprocess(record(3.0 - x), 1, 100.0, x, displacement=x)
    np.testing.assert_array_equal(plain.states, shifted.states)
    literal = preprocess(record(x), 1, 100.0, x, difference="central")
    np.testing.assert_allclose(
        literal.states[1:-1, 1], (literal.states[2:, 0] - literal.states[:-2, 0]) * FS / 2, rtol=1e-9
    )


def test_force_band():
    time = np.arange(10_000) / FS
    slow, fast = np.sin(2 * np.pi * 5 * time), np.sin(2 * np.pi * 40 * time)
    assert force_band([7.0 + slow], 1 / FS) == pytest.approx(5.0)
    assert force_band([slow + fast], 1 / FS) == pytest.approx(40.0)
    assert force_band([slow + 0.09 * fast], 1 / FS) == pytest.approx(5.0)  # 0.8 % of the energy
    assert force_band([slow + 0.11 * fast], 1 / FS) == pytest.approx(40.0)  # 1.2 %
    assert force_band([slow, fast[:5000]], 1 / FS) == pytest.approx(40.0)
    assert force_band([slow, np.full(500, 3.0)], 1 / FS) == pytest.approx(5.0)
    with pytest.raises(BadInput, match="never changes"):
        force_band([np.full(500, 3.1)], 1 / FS)


def test_cutoff_is_capped():
    assert cutoff(20.0, 1e-3) == 40.0
    assert cutoff(300.0, 1e-3) == pytest.approx(400.0)


def test_stretches():
    assert stretches(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    assert stretches(np.zeros(3, bool)) == []
