"""Every form of every effect: it vanishes, it acts, it stays bounded, it is found again, it inverts, it is saved."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beside import Composite, beside
from effect_numbers import NUMBERS
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import pitp_jax as pitp
from pitp_jax.method.effects import CATALOGUE, effect
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout

HZ, DT, SAMPLES = 5.0, 2e-3, 2500
TIME = np.arange(SAMPLES) * DT
FORMS = pytest.mark.parametrize("form", CATALOGUE, ids=lambda f: f.key)


def voltages():
    """Two sines, a chirp and steps, all from rest; the first three swing through the resonance."""
    chirp = np.sin(2 * np.pi * (0.5 + 1.2 * TIME) * TIME)
    steps = np.repeat([0.3, 1.0, 0.5, 0.9, 0.1], SAMPLES // 5)
    waves = [np.sin(2 * np.pi * 2.3 * TIME), np.sin(2 * np.pi * 1.0 * TIME), chirp]
    return [500 + 400 * w for w in waves] + [900 * steps]


@pytest.fixture(scope="module")
def case(linear):
    """A nominal of 5 Hz beside its own runs, with a session clock."""
    model = replace(linear(hz=HZ, dt=DT), domain=replace(linear(dt=DT).domain, voltage_range=(0.0, 1e3), slew=1e6))
    return beside(model, voltages(), DT)


def active(form):
    """The form's numbers, where it acts."""
    return NUMBERS[form.key]


# what no inverse knows, or no open loop can hold: a friction that falls with speed, a play that has to be crossed at
# once; and readings below a sensor's fold, which there are none of
FOLDED = "sensor_nonlinearity: folded"
HARD = ("coulomb_friction: Stribeck", "backlash: play", "backlash: coasting", FOLDED)


# below limits nothing happens; a feedthrough does not change the voltage
LIMITS = ("voltage_clip: hard", "slew_limit: rate limit", "feedthrough: of the force", "feedthrough: of the input")
UNDONE = [f for f in CATALOGUE if f.port in ("IN", "SQ", "OUT") and f.key not in (*HARD, "delay: pure")]


@pytest.mark.parametrize("form", UNDONE, ids=lambda f: f.key)
def test_what_a_form_makes_of_a_slow_signal_is_undone_without_shooting(case, form):
    """Small and slow enough for every limit; all but pure limits move it by more than it is undone to."""
    part = form(*active(form))
    signal = jnp.asarray(1 - np.cos(np.pi * TIME[:501]), jnp.float32) * {"IN": 380.0, "SQ": 0.4, "OUT": 1.0}[form.port]
    if form.port == "SQ":
        made = part.apply(signal, 0.7)
        back, mirrored = part.uncoupled(made, 0.7), part.uncoupled(-made, 0.7)
        np.testing.assert_allclose(mirrored, -back, rtol=3e-7)  # float32's rounding
    else:

        def advance(states, ends):
            after = part.advance(states, ends[0], ends[1], DT)
            return after, part.apply(ends[1], after)

        made = jax.lax.scan(advance, part.start(jnp.zeros(())), (signal[:-1], signal[1:]))[1]
        back, signal, inside = part.undo(made, DT), signal[1:], slice(10, -10)
        if form.port == "IN":
            assert part.passes(made, DT)[inside].all()
        back, signal, made = back[inside], signal[inside], made[inside]
    passed = np.asarray(made) != 0  # what does not get through a dead zone cannot be known
    assert passed.mean() > 0.5 and np.abs(back - signal)[passed].max() < 2e-5 * np.ptp(signal)
    assert (np.abs(made - signal).max() > 1e-3 * np.ptp(signal)) == (form.key not in LIMITS)


@pytest.mark.parametrize(
    ("key", "numbers", "level"),
    [
        ("coulomb_friction: Coulomb", (0.1,), lambda x, v: 0.1),
        ("coulomb_friction: loaded by the spring", (0.05, 0.1), lambda x, v: 0.05 + 0.1 * abs(x)),
        ("coulomb_friction: smooth", (0.1, 0.2), lambda x, v: 0.1 * np.tanh(v / 0.2)),
    ],
)
def test_dry_friction_without_a_mass_stops_the_motion(linear, key, numbers, level):
    """a_1 x' = F - a_0 x - f: what else pulls is what friction answers to; beside SciPy at tight tolerance."""
    form = next(f for f in CATALOGUE if f.key == key)
    bare = linear(1, HZ, 1.0, dt=DT)
    volts = 600 + 350 * np.sin(2 * np.pi * 1.3 * TIME)
    a0, a1 = np.asarray(bare.coefficients, float)[:2]
    rate = float(bare.scales.rates[0])

    def speed(t, x):
        """Scaled x' that all forces but the inertia's, which there is none of, leave in balance."""
        pull = np.interp(t, TIME, volts) ** 2 / float(bare.scales.force) - a0 * x[0]
        if "smooth" in key:
            widest = abs(pull) / a1 + 1
            root: Any = brentq(lambda v: a1 * v + level(x[0], v) - pull, -widest, widest)
            return [rate * root]
        return [rate * np.sign(pull) * max(abs(pull) - level(a0 * x[0], 0.0), 0.0) / a1]

    truth = solve_ivp(speed, (0, TIME[-1]), [0.0], t_eval=TIME, rtol=1e-8, atol=1e-10, max_step=DT).y[0]
    found = rollout(replace(bare, effects=(form(*numbers),)), jnp.asarray(volts, jnp.float32), DT, rest_state(bare))
    found = np.asarray(found)[:, 0]
    plain = np.asarray(rollout(bare, jnp.asarray(volts, jnp.float32), DT, rest_state(bare)))[:, 0]
    assert np.abs(found - truth).max() < 3e-3 * np.ptp(truth) < 0.1 * np.abs(plain - truth).max()


@pytest.fixture(scope="module")
def composite(case):
    """All forms in one program."""
    return Composite(case, CATALOGUE, DT)


@pytest.fixture(scope="module")
def runs(case, composite):
    """Every form's readings on every record at its first start."""
    jobs = [(k, f, active(f)) for f in CATALOGUE for k in range(len(case.series))]
    found = composite.runs(jobs).reshape(len(CATALOGUE), len(case.series), SAMPLES)
    return dict(zip(CATALOGUE, found, strict=True))


@pytest.mark.slow
def test_all_forms_neutral_together_are_the_nominal(case, composite):
    for s, y in zip(case.series, composite.runs([(k, None, ()) for k in range(len(case.series))]), strict=True):
        np.testing.assert_allclose(y, s.run, atol=2e-6 * s.span)


@FORMS
def test_an_active_form_acts_and_stays_bounded(case, runs, form):
    moved = [np.abs(y - s.run).max() / s.span for y, s in zip(runs[form], case.series, strict=True)]
    assert np.isfinite(moved).all()
    assert 1e-3 < max(moved) < 5


@pytest.fixture(scope="module")
def finer(case, runs):
    """Every form's readings at half the step, on the record that it moves most: the record and the readings."""
    halved = replace(case, model=replace(case.model, substeps=2 * case.model.substeps))
    plain = np.array([s.run for s in case.series])
    most = [int(np.argmax(np.abs(runs[f] - plain).max(axis=1))) for f in CATALOGUE]
    found = Composite(halved, CATALOGUE, DT).runs([(k, f, active(f)) for k, f in zip(most, CATALOGUE, strict=True)])
    return dict(zip(CATALOGUE, zip(most, found, strict=True), strict=True))


@FORMS
def test_half_the_step_changes_little(case, runs, finer, form):
    """The frozen step is fine enough: half of it moves the reading by less than 3 % of what the effect does."""
    k, y = finer[form]
    change = np.sqrt(np.mean((runs[form][k] - case.series[k].run) ** 2))
    assert np.sqrt(np.mean((y - runs[form][k]) ** 2)) < 0.03 * change


def planned(case, form):
    """The model with an active form, a smooth target, and the feedforward for it."""
    model = replace(case.model, effects=(form(*active(form)),))
    x = 4e-4 * (1 - np.exp(-((5 * TIME) ** 3))) * (1 + 0.5 * np.sin(2 * np.pi * 2 * TIME))
    return model, x, pitp.feedforward(model, pitp.Target(TIME, x))


def of_each_name(forms):
    """The forms, those behind the first of their effect for the exhaustive tests."""
    first = {f.name: f for f in reversed(forms)}.values()
    return [pytest.param(f, marks=pytest.mark.slow if f in first else pytest.mark.exhaustive, id=f.key) for f in forms]


@pytest.mark.parametrize("form", of_each_name([f for f in CATALOGUE if f.key not in HARD]))
def test_feedforward_undoes_it(case, form):
    """The model with the effect follows a smooth target to 0.5 %."""
    assert planned(case, form)[2].self_check_e_rms_percent < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("form", [f for f in CATALOGUE if f.key in HARD and f.key != FOLDED], ids=lambda f: f.key)
def test_feedforward_of_a_hard_form_is_better_than_without_it(case, form):
    model, x, plan = planned(case, form)
    blind = pitp.feedforward(case.model, pitp.Target(TIME, x))
    states = rollout(model, jnp.asarray(blind.voltage, jnp.float32), DT, rest_state(model))
    y = np.asarray(ports.readings(model, states), float)[blind.target] * 1e-3
    assert plan.self_check_e_rms_percent < pitp.e_rms_percent(y, x)


@FORMS
def test_a_file_keeps_it(case, form, tmp_path):
    values = active(form)
    model = replace(case.model, effects=(form(*values),))
    pitp.save(tmp_path / "m.pitp", model)
    back = pitp.load(tmp_path / "m.pitp").effects[0]
    assert back.spec is form
    np.testing.assert_array_equal(jax.tree.leaves(back), jax.tree.leaves(model.effects[0]))


# ---- against closed forms; every form against its equation: test_effect_equations ----


def test_friction_takes_a_fixed_length_off_every_swing(linear):
    """Free swings with Coulomb friction lose 4 F_c / k a period (closed form), and end where |k x| < F_c."""
    model = linear(hz=HZ, dt=DT, damping=1e-5)
    level = 0.02 * float(model.coefficients[0])
    here = replace(model, effects=(effect("coulomb_friction", level=level),))
    start = rest_state(here).at[0].set(1.0)
    x = np.asarray(rollout(here, jnp.zeros(SAMPLES), DT, start)[:, 0])
    period = round(1 / HZ / DT)
    tops = x[::period][:10]
    np.testing.assert_allclose(np.diff(tops), -0.08, rtol=0.03)
    stuck = x[-200:]
    assert np.ptp(stuck) < 1e-4 and abs(stuck[-1]) < 0.02


def test_a_play_remembers_where_it_was_pushed():
    """A stop element's force after a triangle: hand-computed."""
    play = effect("hysteresis", kappa=1.0, width=1.0)
    states = play.start(jnp.asarray(0.0))
    for x in (2.0, 1.0):
        states = play.advance(states, 0.0, jnp.asarray(x), 0.0)
    np.testing.assert_allclose(states, [1.15, 1.4, 1.0, 0.0], atol=1e-6)


def test_backlash_is_crossed_at_every_reversal_and_undone_between_them():
    """A triangle by hand; a sine's x behind its reading wherever it moves on."""
    play, states, seen = effect("backlash", width=0.1), jnp.zeros(1), []
    for before, x in ((0.0, 1.0), (1.0, 0.6), (0.6, 0.0), (0.0, -0.1)):
        states = play.advance(states, before, jnp.asarray(x), DT)
        seen.append(float(play.apply(jnp.asarray(x), states)))
    np.testing.assert_allclose(seen, [0.95, 0.65, 0.05, -0.05], atol=1e-6)
    x, y = np.sin(2 * np.pi * TIME[:500]), [0.0]
    for now in x[1:]:
        y.append(float(np.clip(y[-1], now - 0.05, now + 0.05)))
    moving = np.abs(np.gradient(y, DT)) > 4.0
    assert moving.mean() > 0.2
    np.testing.assert_allclose(np.asarray(play.undo(jnp.asarray(y), DT))[moving], x[moving], atol=1e-4)


@pytest.mark.parametrize("gain", [0.8, 1.5])
def test_a_mass_before_the_sensor_is_undone_up_to_the_gain_from_which_it_cannot_be(gain):
    """From gain 1 on the reading has a zero in the right half plane: then it is handed on as it is."""
    mode = effect("second_mode", form="between film and sensor", gain=gain, omega=60.0, zeta=0.05)
    x, z, read = np.sin(2 * np.pi * TIME[:500]) ** 3, mode.start(jnp.asarray(0.0)), [0.0]
    for before, after in zip(x[:-1], x[1:], strict=True):
        z = mode.advance(z, before, after, DT)
        read.append(float(mode.apply(after, z)))
    np.testing.assert_allclose(mode.undo(jnp.asarray(read), DT), x if gain < 1 else read, atol=1e-4)
    assert np.abs(read - x).max() > 0.02


@pytest.mark.slow
def test_a_stretched_film_stays_softer_for_the_session(linear):
    """The first cycle differs from the second; the next record begins where the session has been."""
    model = replace(linear(hz=HZ, dt=DT), effects=(effect("mullins", d=0.4, length=0.5),))
    u = jnp.asarray(900 * np.abs(np.sin(2 * np.pi * 0.4 * TIME)), jnp.float32)
    x = np.asarray(rollout(model, u, DT, rest_state(model))[:, 0])
    far = np.abs(x).max()
    again = np.asarray(rollout(model, u, DT, ports.resumed(model, rest_state(model), far))[:, 0])
    assert again[200] > 1.05 * x[200]
    np.testing.assert_allclose(again[1250:], x[1250:], atol=0.02 * far)
    late = pitp.Record("late", TIME + 20, np.asarray(u), again * model.scales.state[0])
    early = pitp.Record("early", TIME, np.asarray(u), x * model.scales.state[0])
    for told, truth in zip(pitp.predict(model, [early, late]), (x, again), strict=True):
        assert pitp.e_rms_percent(told.displacement, truth * model.scales.state[0]) < 0.1


def test_lags_are_exact_for_a_ramp():
    """tau y' = x - y under x = t: y = t - tau (1 - exp(-t / tau)), for every first-order state."""
    tau, t = 0.03, TIME[:200]
    truth = t - tau * (1 - np.exp(-t / tau))
    for lag in (effect("electrode_rc", tau=tau), effect("sensor_lag", tau=tau), effect("creep", kappa=1.0, tau=tau)):
        z, seen = lag.start(jnp.asarray(0.0)), [0.0]
        for a, b in zip(t[:-1], t[1:], strict=True):
            z = lag.advance(z, a, b, DT)
            seen.append(float(z[0]))
        np.testing.assert_allclose(seen, truth, atol=1e-6)
