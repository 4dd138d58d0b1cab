"""The virtual actuators against closed forms, scipy, energy balance and diffrax."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from typed import of_kind

from pitp_jax import ComputationFailed, plant, record, simulate, stepper

NAMES = ("cone100", "cone122", "cone150", "roll")


def sine(name, frequency, seconds):
    """The paper's sine for that plant (1-5 kV or 200-1200 V) at its own sampling rate."""
    p = plant(name)
    amplitude, offset = (500.0, 700.0) if name == "roll" else (2e3, 3e3)
    time = np.arange(round(seconds * p.rate_hz)) / p.rate_hz
    return time, offset + amplitude * np.sin(2 * np.pi * frequency * time - np.pi / 2)


def line(time, x, frequency):
    """Amplitude of one frequency over a whole number of its periods at the end of the record."""
    dt = time[1] - time[0]
    n = round(np.floor(0.5 * len(time) * dt * frequency) / frequency / dt)
    return 2.0 * abs(np.mean(x[-n:] * np.exp(-2j * np.pi * frequency * time[-n:])))


def damping_ratio(p):
    mode = max(np.linalg.eigvals(p.linearised()), key=np.imag)
    return -mode.real / abs(mode)


def energy(p, state):
    """Energy in J: Gent potential, branches, gravity and motion; state (2 + branches,)."""
    x, v = state[0] * p.scale, state[1] * p.scale
    q = p.geometry.stretch(p.rest_position + x)[0]
    p2 = p.prestretch**2
    gent = -0.5 * p.spring * p.limit * np.log(1.0 - (p2 * q + p2 + 1.0 / (p2**2 * q) - 3.0) / p.limit)
    ratio = p.stretch_ratio(x)
    memory = sum(k / 4 * (ratio / b + b / ratio - 2.0) for (k, _), b in zip(p.branches, 1.0 + state[2:], strict=True))
    return gent + memory - p.mass * 9.81 * x + 0.5 * p.mass * v**2


def test_unknown_names_are_refused_with_the_list():
    with pytest.raises(ValueError, match="cone100, cone122, cone150, roll"):
        plant("cone")
    p, t = plant("cone100"), np.arange(100) / 1e3
    with pytest.raises(ValueError, match="unknown hold"):
        simulate(p, t, 0 * t, hold="spline")
    with pytest.raises(ValueError, match="unknown method"):
        simulate(p, t, 0 * t, method="euler")
    with pytest.raises(ValueError, match="voltage"):
        simulate(p, t, np.zeros(7))
    with pytest.raises(ValueError, match="uniformly"):
        simulate(p, t**2, 0 * t)


@pytest.mark.slow
def test_resonances_are_the_papers():
    assert plant("cone100").resonance_hz == pytest.approx(7.4, rel=0.01)
    assert plant("roll").resonance_hz == pytest.approx(142.0, rel=0.01)
    assert plant("cone100").resonance_hz > plant("cone122").resonance_hz > plant("cone150").resonance_hz
    assert 0.05 < damping_ratio(plant("cone100")) < 0.1
    assert 0.03 < damping_ratio(plant("roll")) < 0.05


def test_one_mode_only():
    for name in NAMES:
        assert np.sum(np.abs(np.linalg.eigvals(plant(name).linearised()).imag) > 0.0) == 2


@pytest.mark.parametrize("name", NAMES)
def test_static_is_the_root_of_the_force_balance(name):
    p = plant(name)
    u = np.linspace(0.0, p.max_voltage, 7)
    x = p.static(u)
    assert x.shape == u.shape
    assert x[0] == pytest.approx(0.0, abs=1e-12)
    assert (np.diff(x) > 0).all()
    w, p2, c = p.geometry.width, p.prestretch**2, p.capacitance

    def balance(z):  # written out anew, by the derivative of the energies
        q, dq = (1 + z / w) ** 2 if name == "roll" else 1 + (z / w) ** 2, p.geometry.stretch(z)[1]
        invariant = p2 * q + p2 + 1 / (p2**2 * q) - 3
        pull = p.spring / 2 * p.limit / (p.limit - invariant) * (p2 - 1 / (p2**2 * q**2)) * dq
        return p.mass * 9.81 - pull + c / 2 * u[-1] ** 2 * dq

    z = of_kind(float, brentq(balance, p.rest_position, p.rest_position + 3e-3, xtol=1e-14))
    assert x[-1] == pytest.approx(z - p.rest_position, rel=1e-8)
    h = 1e-7
    slope = (p.geometry.stretch(z + h)[0] - p.geometry.stretch(z - h)[0]) / (2 * h)
    assert p.geometry.stretch(z)[1] == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("name", ["cone100", "roll"])
def test_free_motion_only_loses_energy(name):
    p = plant(name)
    with jax.enable_x64(True):
        step, rest = stepper(p)
        start = rest.at[0].set(1.5)
        states = jax.jit(lambda y: jax.lax.scan(lambda s, _: (step(s, 0.0, 0.0)[0],) * 2, y, length=int(p.rate_hz))[1])(
            start
        )
    states = np.vstack([np.asarray(start)[None], np.asarray(states)])
    e = np.array([energy(p, s) for s in states]) - energy(p, np.zeros(len(rest)))
    assert (np.diff(e) <= 1e-7 * e[0]).all()
    assert e[-1] < 0.01 * e[0]
    periods = 3
    later = states[round(periods * p.rate_hz / p.resonance_hz) :, 0]
    assert np.abs(later).max() == pytest.approx(1.5 * np.exp(-2 * np.pi * periods * damping_ratio(p)), rel=0.3)


@pytest.mark.parametrize(("name", "least", "most"), [("cone100", 0.04, 0.15), ("roll", 0.01, 0.06)])
def test_a_step_creeps_on_towards_static(name, least, most):
    p = plant(name)
    time = np.arange(round(10 * p.rate_hz)) / p.rate_hz
    u = 0.5 * p.max_voltage
    x = simulate(p, time, np.full(time.shape, u))
    period = round(2 * p.rate_hz / p.resonance_hz)
    means = [x[round(s * p.rate_hz) - period :][:period].mean() for s in (2, 3, 5, 7, 10)]
    assert (np.diff(means) > 0).all()
    early = x[round(0.3 * p.rate_hz) :][: round(0.4 * p.rate_hz)].mean()
    assert least < means[-1] / early - 1 < most
    assert means[-1] < p.static(u)


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize(("name", "frequency", "seconds"), [("cone100", 7.0, 4.0), ("roll", 130.0, 0.5)])
def test_fixed_steps_match_diffrax(name, frequency, seconds, hold):
    time, u = sine(name, frequency, seconds)
    fast = simulate(plant(name), time, u, hold=hold)
    tight = simulate(plant(name), time, u, hold=hold, method="adaptive")
    assert fast[0] == tight[0] == 0.0
    assert np.abs(fast - tight).max() < 1e-6 * np.ptp(tight)


def test_small_motion_is_the_linear_one():
    p = plant("cone100")
    time = np.arange(4000) / p.rate_hz
    u = 100.0 * (1 - np.cos(2 * np.pi * 2.0 * time))
    gain = p.capacitance / 2 * p.geometry.stretch(p.rest_position)[1] / (p.mass * p.scale)
    a = p.linearised()
    force = np.zeros(len(a), dtype=complex)
    force[1] = gain * 0.5 * 100.0**2  # cos(4 pi 2 t) / 2 from the square of the cosine
    expected = abs(np.linalg.solve(2j * np.pi * 4.0 * np.eye(len(a)) - a, force)[0]) * p.scale
    assert line(time, simulate(p, time, u), 4.0) == pytest.approx(expected, rel=0.01)


def test_half_the_resonance_excites_it_through_the_square():
    time, u = sine("cone100", 3.7, 10.0)
    x = simulate(plant("cone100"), time, u)
    assert line(time, x, 7.4) > 0.5 * line(time, x, 3.7)
    assert np.ptp(x[5000:]) > 1.1 * np.ptp(simulate(plant("cone100"), *sine("cone100", 4.5, 10.0))[5000:])


@pytest.mark.parametrize("name", NAMES)
def test_the_papers_sweep_stays_in_range(name):
    p = plant(name)
    seconds, last = (90.0, 180.0) if name == "roll" else (200.0, 20.0)
    time = np.arange(round(seconds * p.rate_hz)) / p.rate_hz
    a = p.max_voltage / 2
    u = a * np.sin(np.pi * ((last - 0.01) / seconds * time + 0.02) * time - np.pi / 2) + a
    x = simulate(p, time, u)
    assert 0.3 * p.scale < np.abs(x).max() < 0.5 * p.sensor_range
    assert p.rest_position + x.min() > 0.0 or name == "roll"
    peak = time[np.argmax(np.abs(x))] * last / seconds
    assert peak == pytest.approx(p.resonance_hz, rel=0.1)


def test_a_pull_in_is_an_error_with_advice():
    p = plant("cone100")
    with pytest.raises(ComputationFailed, match="keep the voltage below 6000 V"):
        simulate(p, np.arange(1000) / 1e3, np.full(1000, 4e4))


def test_records_share_one_integration_and_leave_the_precision_alone():
    p = plant("cone100")
    time, u = sine("cone100", 2.0, 1.0)
    both = simulate(p, time, np.stack([u, 0.5 * u]))
    np.testing.assert_allclose(both[1], simulate(p, time, 0.5 * u), rtol=1e-9, atol=1e-15)
    assert jnp.zeros(1).dtype == jnp.float32
    assert both.dtype == np.float64


def test_a_record_is_reproducible_and_read_in_16_bit():
    p = plant("roll")
    time, u = sine("roll", 40.0, 0.5)
    clean = record(p, "a", time, u, seed=1, noise=False)
    np.testing.assert_array_equal(clean.displacement, simulate(p, time, u))
    first = record(p, "a", time, u, seed=1)
    np.testing.assert_array_equal(first.displacement, record(p, "a", time, u, seed=1).displacement)
    assert (first.displacement != record(p, "a", time, u, seed=2).displacement).any()
    assert (first.displacement != record(p, "b", time, u, seed=1).displacement).any()
    assert np.std(first.displacement - clean.displacement) == pytest.approx(p.noise_std, rel=0.1)
    counts = first.displacement / (2e-3 / 2**16)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert (first.name, first.displacement_unit, first.samples) == ("a", "m", len(time))


def test_the_stepper_is_the_plant_one_sample_at_a_time():
    p = plant("cone100")
    time, u = sine("cone100", 5.0, 1.0)
    step, state = stepper(p)
    pairs = jnp.asarray(np.stack([u[:-1], u[1:]], axis=1))
    _, x = jax.jit(lambda s: jax.lax.scan(lambda s, pair: step(s, *pair), s, pairs))(state)
    reference = simulate(p, time, u)
    assert np.abs(np.asarray(x) - reference[1:]).max() < 1e-4 * np.ptp(reference)  # float32
    assert x.dtype == jnp.float32
