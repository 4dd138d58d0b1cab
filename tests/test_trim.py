"""The PI trim against the plant's own simulation and the closed forms of a first-order step."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pitp_jax import BadInput, pi_trim, plant, simulate, stepper
from pitp_jax.method.invert.pi_control import KV_PER_MM
from pitp_jax.method.model.input_map import SquareInput

POLE, GAIN, DT = 0.9, 2e-7, 1e-3  # x' = POLE x + GAIN u + load


def first_order(load=0.0):
    """One sample of a first-order plant that sees the voltage at the sample's start."""

    def step(state, now, later):
        following = POLE * state + GAIN * now + load
        return following, following

    return step


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def run(voltage, target, *, load=0.0, start=0.0, **options):
    u, wanted = (jnp.asarray(np.asarray(v, np.float64)) for v in (voltage, target))
    x, u = pi_trim(first_order(load), jnp.asarray(start), u, wanted, DT, **options)
    return np.asarray(x), np.asarray(u)


@pytest.mark.parametrize("name", ["cone100", "roll"])
def test_without_gains_it_is_the_plant_under_the_feedforward(name):
    p = plant(name)
    time = np.arange(600) / p.rate_hz
    u = 0.3 * p.max_voltage * (1 - np.cos(2 * np.pi * 5 * time)) * np.linspace(0.2, 1, 600)
    step, state = stepper(p)
    x, played = pi_trim(step, state, jnp.asarray(u), jnp.full(600, 1e-3), 1 / p.rate_hz, p=0.0, i=0.0)
    truth = simulate(p, time, u)
    np.testing.assert_allclose(x, truth, atol=1e-9 * np.ptp(truth))
    np.testing.assert_array_equal(played, u)


def test_first_samples_by_hand():
    p, i = 1e6, 1e8
    x, u = run([100.0, 200.0, 300.0], [1e-4, 2e-4, 3e-4], p=p, i=i)
    state, total, by_hand = 0.0, 0.0, []
    for feed, wanted in zip([100.0, 200.0, 300.0], [1e-4, 2e-4, 3e-4], strict=True):
        error = wanted - state
        total += error * DT
        by_hand.append((state, feed + p * error + i * total))
        state = POLE * state + GAIN * by_hand[-1][1]
    np.testing.assert_allclose(x, [row[0] for row in by_hand], rtol=1e-12)
    np.testing.assert_allclose(u, [row[1] for row in by_hand], rtol=1e-12)


def test_over_a_sample_the_feedforward_runs_on_and_the_correction_is_held():
    u = jnp.asarray([0.0, 10.0, 40.0, 90.0])
    endless = (-float("inf"), float("inf"))
    # this plant's displacement is the rise of its voltage over the sample: the correction must not show
    rise, _ = pi_trim(
        lambda s, now, later: (s, later - now), jnp.zeros(()), u, jnp.full(4, 1e-3), DT, p=1e3, i=1e3, limits=endless
    )
    np.testing.assert_allclose(rise, [0.0, 10.0, 30.0, 50.0], rtol=1e-9)


@pytest.mark.parametrize("load", [0.0, 2e-6, -1e-6])
def test_final_values_are_the_closed_form(load):
    """Rest of x (1 - POLE) = GAIN (u + P (w - x)) + load; an integral part leaves no error."""
    u, w, p = 1000.0, 1.5e-3, 2e5
    feed, wanted = np.full(4000, u), np.full(4000, w)
    alone = (GAIN * u + load) / (1 - POLE)
    with_p = (GAIN * (u + p * w) + load) / (1 - POLE + GAIN * p)
    assert run(feed, wanted, load=load, p=0.0, i=0.0)[0][-1] == pytest.approx(alone, rel=1e-9)
    assert run(feed, wanted, load=load, p=p, i=0.0)[0][-1] == pytest.approx(with_p, rel=1e-9)
    x, voltage = run(feed, wanted, load=load, p=p, i=2e7)
    assert x[-1] == pytest.approx(w, rel=1e-9)
    assert voltage[-1] == pytest.approx((w * (1 - POLE) - load) / GAIN, rel=1e-9)
    # the proportional part alone divides the offset by 1 + GAIN P / (1 - POLE)
    assert (w - with_p) * (1 + GAIN * p / (1 - POLE)) == pytest.approx(w - alone, rel=1e-9)


def test_it_takes_a_gain_error_off_a_virtual_actuator_at_the_rate_of_its_gains():
    """Far below resonance the error decays as exp(-I G t / (1 + P G)), G = dx/du of the plant at rest."""
    p = plant("cone100")
    step, state = stepper(p)
    count = 8000
    time = np.arange(count) / p.rate_hz
    u = 3000.0 * np.clip(time, 0, 1) ** 2 * (3 - 2 * np.clip(time, 0, 1))
    target = simulate(p, time, u)
    weak = jnp.asarray(0.95 * u)  # a feedforward from a model 5 % off

    @jax.jit
    def trim(gains):
        x, _ = pi_trim(step, state, weak, jnp.asarray(target), 1 / p.rate_hz, p=gains[0], i=gains[1])
        return jnp.abs(x - target)

    slope = float(np.diff(p.static(np.array([2800.0, 3000.0])))[0] / 200.0)
    alone = np.asarray(trim(jnp.zeros(2)))
    paper = np.asarray(trim(jnp.array([0.1, 0.3]) * KV_PER_MM))
    strong = np.asarray(trim(jnp.array([0.1, 6.0]) * KV_PER_MM))
    assert alone[-1] > 0.05 * np.ptp(target)
    rate = 0.3 * KV_PER_MM * slope / (1 + 0.1 * KV_PER_MM * slope)
    left = (paper[-1] / alone[-1]) / (paper[2000] / alone[2000])
    assert left == pytest.approx(np.exp(-rate * (count - 2001) / p.rate_hz), rel=0.05)
    assert strong[-1] < 0.02 * alone[-1]


def test_the_voltage_keeps_its_limits():
    feed, wanted = np.linspace(0, 1000, 500), np.linspace(0, 5e-3, 500)
    _, u = run(feed, wanted, p=1e6, i=1e7, limits=(100.0, 900.0))
    assert u.min() == 100.0
    assert u.max() == 900.0


def test_a_long_saturation_is_forgotten_like_a_short_one():
    """The integral stops while the voltage is cut: what follows does not depend on how long it was."""

    def after(samples, limits):
        wanted = np.concatenate([np.full(samples, 9e-3), np.full(1300, 1e-3)])  # 9 mm: 2 mm is all 1000 V can do
        return run(np.full(len(wanted), 500.0), wanted, p=1e5, i=2e6, limits=limits)[0][samples:]

    short, long = after(1000, (0.0, 1000.0)), after(4000, (0.0, 1000.0))
    assert short[0] == pytest.approx(2e-3, rel=1e-6)
    np.testing.assert_allclose(long, short, rtol=1e-6)
    assert np.abs(long[-100:] - 1e-3).max() < 2e-5  # after four time constants of the loop, 0.3 s each


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_it_leaves_a_limit_by_itself(direction):
    """A plant 20 % weak, at its limit for 5 s, then 15 % strong: on the target within four time constants."""

    def plant(state, now, later):
        x, k = state
        following = POLE * x + GAIN * jnp.where(k < 5000, 0.8, 1.15) * now
        return (following, k + 1), direction * following

    start = (jnp.zeros(()), jnp.zeros((), int))
    u, wanted = jnp.full(7000, 900.0), jnp.full(7000, direction * 1.8e-3)
    x, played = pi_trim(plant, start, u, wanted, DT, p=1e5, i=2e6, limits=(0.0, 1000.0), direction=direction)
    assert played[4999] == 1000.0
    assert np.abs(np.asarray(x)[5000 + 1200 :] - direction * 1.8e-3).max() < 0.02 * 1.8e-3


def test_gains_on_the_force_make_the_same_loop_at_every_voltage():
    """F = u^2, x' = POLE x + GAIN F: small errors decay alike about 300 V and about 900 V."""

    def decay(volts):
        gain = GAIN / 1000
        still = gain * volts**2 / (1 - POLE)

        def plant(x, now, later):
            return 2 * (POLE * x + gain * now**2 + 0.01 * still * (1 - POLE),)

        u, wanted = jnp.full(1500, volts), jnp.full(1500, still)
        gains = {"p": 1e7, "i": 2e9, "input_map": SquareInput()}
        x, _ = pi_trim(plant, jnp.asarray(still), u, wanted, DT, limits=(0.0, 3000.0), **gains)
        return np.asarray(x) / still - 1

    np.testing.assert_allclose(decay(900.0), decay(300.0), rtol=0, atol=1e-10)


def test_the_rate_is_kept():
    feed, wanted = np.concatenate([[0.0], np.full(199, 1000.0)]), np.full(200, 1e-3)
    _, u = run(feed, wanted, p=1e5, i=1e6, max_slew=2e4)
    assert np.abs(np.diff(u)).max() <= 20.0 * (1 + 1e-12)


def test_gains_of_an_unstable_loop_are_refused():
    """x' = POLE x + GAIN (feed - P x): stable for GAIN P < 1 + POLE; with x as it stands at the sample's start."""
    limit = (1 + POLE) / GAIN
    voltage = np.full(50, 100.0)
    run(voltage, np.full(50, 2e-4), p=0.98 * limit, i=1.0)
    with pytest.raises(BadInput, match="unstable"):
        run(voltage, np.full(50, 2e-4), p=1.02 * limit, i=1.0)
