"""A second mass that hangs on the moved one: found along the motion, not imagined, and worth it in a free run."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typed import some

from pitp_jax import Settings, identify, predict, train
from pitp_jax.common.metrics import rmse
from pitp_jax.method.model.memory import FadingMemory, RingingMemory
from pitp_jax.method.signal.preprocess import cutoff, force_band, preprocess
from pitp_jax.method.signal.record import Record
from pitp_jax.method.train.second_resonance import second_mass
from pitp_jax.method.train.settings import memory_of

DT, OMEGA, SECOND, SHARE = 2e-3, 2 * np.pi * 7.0, 2 * np.pi * 11.0, 0.2
LAGS = np.array([0.05, 0.5])


def hanging(hertz, amplitude, share=SHARE, cubic=0.0, seconds=4.0):
    """m x'' = u^2 - k x - d x' - c x^3 + p m (W^2 (r - x)), r'' = W^2 (x - r) - 0.1 W r', in mm and 100 V, noisy."""
    time = np.arange(int(seconds / DT)) * DT

    def drive(t):
        return amplitude * np.sin(np.pi * hertz * t) ** 2

    def slope(t, s):
        x, v, r, w = s
        force = OMEGA**2 * drive(t) ** 2 * (1 - np.exp(-((t / 0.05) ** 2)))
        film = OMEGA**2 * (x + cubic * x**3) + 0.16 * OMEGA * v
        pull = share * SECOND**2 * (r - x)
        return v, force - film + pull, w, SECOND**2 * (x - r) - 0.1 * SECOND * w

    found = solve_ivp(slope, (0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-8, atol=1e-10).y[0]
    noise = np.random.default_rng(int(100 * hertz)).normal(0, 1e-3 * np.ptp(found), len(time))
    return Record(f"{hertz:g}Hz_{amplitude:g}", time, 100 * drive(time), 1e-3 * (found + noise))


HERTZ = (1.0, 2.0, 3.0, 4.5, 5.5, 6.5)


@pytest.fixture(scope="module")
def ringing():
    return [hanging(f, a) for f in HERTZ for a in (0.6, 1.0)]


def motion(records, order=2):
    forces, dt = [r.voltage**2 for r in records], records[0].dt
    cut = cutoff(force_band(forces, dt), dt)
    return [preprocess(r, order, cut, f) for r, f in zip(records, forces, strict=True)]


def test_it_is_found(ringing):
    w, zeta, left = some(second_mass(motion(ringing), OMEGA, LAGS))
    assert w == pytest.approx(SECOND, rel=0.03)
    assert zeta == pytest.approx(0.05, abs=0.03)
    assert left < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("cubic", [0.0, 0.3])
def test_none_is_found_where_none_hangs(cubic):
    assert second_mass(motion([hanging(f, a, 0.0, cubic) for f in HERTZ for a in (0.6, 1.0)]), OMEGA, LAGS) is None


def test_at_order_1_nothing_has_a_mass(ringing):
    assert second_mass(motion(ringing, 1), OMEGA, LAGS) is None


def test_too_few_samples_decide_nothing():
    assert second_mass(motion([hanging(3.0, 1.0, seconds=0.3)]), OMEGA, LAGS) is None


def test_none_is_taken_that_the_sampling_cannot_follow(ringing):
    """Every fifth sample is enough for it, every eighth (w dt = 1.1) is not."""
    found = [
        second_mass(
            motion([Record(r.name, r.time[::k], r.voltage[::k], r.displacement[::k]) for r in ringing]), OMEGA, LAGS
        )
        for k in (5, 8)
    ]
    assert found[0] is not None and found[0][0] == pytest.approx(SECOND, rel=0.05)
    assert found[1] is None


@pytest.mark.exhaustive
def test_a_free_run_is_better_for_it(ringing):
    """Without it (`ringing=False`) 0.84 of the nominal's error are left after as many steps."""
    nominal = identify(ringing, order=2).model
    told = Settings(width=2, memories=1, epochs=2, stages=1, batch=512, refine_steps=8, drive="direct")
    held_out = hanging(5.0, 0.9)
    found = train(nominal, ringing[1::2], settings=told, key=jax.random.key(0))
    assert found.notes["second_mass_hz"] == pytest.approx(SECOND / (2 * np.pi), rel=0.1)
    after, before = (
        rmse(predict(m, [held_out])[0].displacement, held_out.displacement) for m in (found.model, nominal)
    )
    assert after * 2 < before


@pytest.mark.slow
def test_it_is_only_looked_for_where_asked(ringing):
    nominal = identify(ringing, order=2).model
    kinds = [type(memory_of(Settings(ringing=r), nominal.model, None, motion(ringing))) for r in (True, False)]
    assert kinds == [RingingMemory, FadingMemory]
