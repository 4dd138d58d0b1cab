"""Planted linear systems come back from noisy sweeps, within their own standard errors."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from effort import calls
from scipy.signal import chirp, cont2discrete, lfilter, lsim
from typed import of_kind

from pitp_jax import BadInput, ComputationFailed, Record, predict
from pitp_jax.application.commands.identify import delay_text
from pitp_jax.method.diagnose.data import build_case
from pitp_jax.method.diagnose.library import OFFSET
from pitp_jax.method.diagnose.search import Search
from pitp_jax.method.identify.beginnings import find_beginnings
from pitp_jax.method.identify.identification import identify
from pitp_jax.method.model.expected_error import expected_error

DT, SAMPLES, NOISE = 1e-3, 8000, 5e-3  # noise over the output's rms
TIME = np.arange(SAMPLES) * DT
SWEEP = 1000 * (1 - np.cos(2 * np.pi * (0.1 * TIME + 14.9 * TIME**2 / 16)))  # 0.1 to 15 Hz, the force to 30 Hz


def simulate(a, voltage, *, square=True, hold="foh", fine=16):
    """Exact response of sum a_i x^(i) = F for a force linear (foh: between 16 times finer samples) or held."""
    fine = fine if hold == "foh" else 1
    places = np.arange((len(voltage) - 1) * fine + 1) / fine
    drive = np.interp(places, np.arange(len(voltage)), voltage)
    top, bottom, _ = of_kind(tuple, cont2discrete(([1.0], a[::-1] / a[0]), DT / fine, method=hold))
    return lfilter(top.ravel(), bottom, drive**2 if square else drive)[::fine] / a[0]


def sweep(a, seed=0, *, voltage=SWEEP, name="sweep", **options):
    x = simulate(a, voltage, **options)
    noise = NOISE * x.std() * np.random.default_rng(seed).standard_normal(SAMPLES)
    return Record(name, TIME, voltage, x + noise)


def changed(record, displacement):
    return Record(record.name, record.time, record.voltage, displacement)


def errors(fit, a):
    """Coefficient errors in standard errors, which must be small enough to mean something."""
    assert (fit.stderr < 0.02 * a).all()
    return np.abs(fit.coefficients - a) / fit.stderr


def moving(a, seed):
    """A record cut from the middle of a longer one, at high velocity: neither position nor velocity start at zero."""
    lead = np.concatenate([SWEEP[1000:3500][::-1], SWEEP])
    x = simulate(a, lead)
    start = 500 + int(np.argmax(np.abs(np.diff(x[500:2400]))))
    x = x[start : start + SAMPLES] + 1e-3
    x = x + NOISE * x.std() * np.random.default_rng(seed).standard_normal(SAMPLES)
    return Record("cut", TIME, lead[start : start + SAMPLES], x)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_planted_orders_come_back(coefficients, order):
    a = coefficients(order)
    found = identify([sweep(a, order)], order=order, hold="foh")
    assert errors(found.chosen, a).max() < 5
    assert found.rest == {"sweep": True}
    assert found.chosen.rms == pytest.approx(NOISE * simulate(a, SWEEP).std(), rel=0.05)
    model = found.model
    np.testing.assert_allclose(model.physical_coefficients, found.chosen.coefficients, rtol=1e-6)
    assert model.order == order and model.hold == "foh"
    if order == 2:
        assert found.chosen.natural_hz == pytest.approx([5.0], rel=1e-3)
        assert found.chosen.damping == pytest.approx([0.1], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 3])
def test_auto_picks_the_planted_order(coefficients, order):
    a = coefficients(order)
    found = identify([sweep(a, 10 + order)], order="auto")
    assert (found.chosen.order, found.chosen.hold) == (order, "foh")
    assert errors(found.chosen, a).max() < 5
    mae = [f.mae for f in found.orders]
    assert mae[order - 2] > 1.5 * mae[order - 1]  # the next smaller order is far worse


def test_offset_and_reversed_laser(coefficients):
    a = coefficients(2)
    record = sweep(a, 20)
    found = identify([changed(record, 7.5e-3 - record.displacement)], order=2, hold="foh").chosen
    assert found.polarity == -1.0
    assert found.offset == pytest.approx(7.5e-3, abs=1e-3 * np.ptp(record.displacement))
    assert errors(found, a).max() < 5


def test_gaps_are_masked(coefficients):
    a = coefficients(2)
    record = sweep(a, 21)
    x = record.displacement.copy()
    for start in (0, 1500, 3300, 6000):
        x[start + 300 : start + 500] = np.nan
    x[2000:2003] = np.nan
    assert errors(identify([changed(record, x)], order=2, hold="foh").chosen, a).max() < 5


def test_coefficients_follow_the_units(coefficients):
    record = sweep(coefficients(2), 22)
    first, second = (
        identify([changed(record, k * record.displacement)], order=2, hold="foh").chosen for k in (1.0, 1e3)
    )
    np.testing.assert_allclose(second.coefficients, first.coefficients * 1e-3, rtol=1e-6)
    np.testing.assert_allclose(second.stderr, first.stderr * 1e-3, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("begin", [sweep, moving])  # offset taken from rest; offset and start fitted
@pytest.mark.parametrize(("order", "noise"), [(1, 1e-2), (2, 5e-3), (3, 1e-3)])
@pytest.mark.parametrize("count", [5, pytest.param(14, marks=pytest.mark.exhaustive)])
def test_standard_errors_cover(coefficients, monkeypatch, order, noise, begin, count):
    """Errors over seeds are of the size the standard errors say, neither hidden nor inflated."""
    monkeypatch.setitem(globals(), "NOISE", noise)
    a = coefficients(order)
    z = np.stack([errors(identify([begin(a, s)], order=order, hold="foh").chosen, a) for s in range(30, 30 + count)])
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    assert np.mean(z > 4) < 0.02


def test_held_voltage_is_told_from_linear(coefficients):
    a = coefficients(2)
    found = identify([sweep(a, 23, hold="zoh")], order=2)
    assert found.chosen.hold == found.model.hold == "zoh"
    assert errors(found.chosen, a).max() < 5


def test_a_moving_start(coefficients):
    a, record = coefficients(2), moving(coefficients(2), 24)
    found = identify([record], order=2, hold="foh")
    assert found.rest == {"cut": False}
    assert found.chosen.offset == pytest.approx(1e-3, abs=1e-3 * np.ptp(record.displacement))
    assert errors(found.chosen, a).max() < 5


def test_linear_input(coefficients):
    a, voltage = coefficients(1), (SWEEP - 1000) * np.minimum(TIME / 0.5, 1)
    found = identify([sweep(a, 25, voltage=voltage, square=False)], order=1, hold="foh", input_map="linear")
    assert errors(found.chosen, a).max() < 5


@pytest.mark.parametrize("order", [3, 4, 5, 6])
def test_one_sine_cannot_carry_many_orders(coefficients, order):
    voltage = 1000 * (1 - np.cos(2 * np.pi * 3 * TIME))
    with pytest.raises(ComputationFailed, match=f"order {order} cannot be identified"):
        identify([sweep(coefficients(2), 26, voltage=voltage)], order=order, hold="foh")


def test_nothing_to_identify(coefficients):
    record = sweep(coefficients(2))
    with pytest.raises(BadInput, match="input never changes"):
        identify([Record("flat", TIME, np.full(SAMPLES, 500.0), record.displacement)], order=2)
    with pytest.raises(BadInput, match="output never changes"):
        identify([changed(record, np.full(SAMPLES, 2e-3))], order=2)
    with pytest.raises(BadInput, match="order 7"):
        identify([record], order=7)
    with pytest.raises(BadInput, match="unknown input map 'cubic'"):
        identify([record], input_map="cubic")


@pytest.mark.parametrize("samples", [0.6, 3.3])
def test_a_planted_delay_comes_back(coefficients, samples):
    """A delay of parts of a sample to several, from rest: within its standard errors, and carried by the model."""
    a, late = coefficients(2), np.interp(np.arange(SAMPLES) - samples, np.arange(SAMPLES), SWEEP, left=0.0)
    record = sweep(a, 27, voltage=late)
    record = Record("late", TIME, SWEEP, record.displacement)
    found = identify([record], order=2, hold="foh", learn=("delay",))
    assert abs(found.chosen.delay - samples * DT) < 4 * found.chosen.delay_stderr < 0.1 * DT
    assert errors(found.chosen, a).max() < 5
    assert float(found.model.effects[0].time) == pytest.approx(found.chosen.delay)
    with pytest.raises(BadInput, match="'mass' cannot be learned"):
        identify([record], learn=("mass",))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "linear"), [(402, True), (403, True), (403, False)])
def test_a_delay_is_as_sure_as_stated_or_the_models_error_is_named(monkeypatch, seed, linear):
    """Another simulation (RK4). A hardening spring shifts the delay by 16 of its standard errors, which a line says."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "experiments"))
    script, plants = import_module("learned_delay"), import_module("_hardening")
    plant, rng = script.drawn(seed, linear=linear)
    found = identify([plants.record(plant, "sweep", plants.sweep(), rng)], order=2, learn=("delay",))
    off = abs(found.chosen.delay - plant.delay) / found.chosen.delay_stderr
    warned = "can shift the delay by more" in delay_text(found)
    assert found.chosen.delay_stderr < 0.1 * plants.DT
    assert (off < 3 and not warned) if linear else warned


@pytest.mark.slow
def test_order_two_behind_a_held_voltage_is_order_two(coefficients):
    """Under foh alone half a sample of lag would be a third pole."""
    found = identify([sweep(coefficients(2), 28, hold="zoh")])
    assert (found.chosen.order, found.chosen.hold, found.chosen.delay) == (2, "zoh", 0.0)
    assert found.chosen.identifiable


@pytest.mark.slow
def test_an_oscillation_that_no_drive_excites_is_no_mode(coefficients):
    """A slow first-order plant and, from the start on, a hum beside it: in sample a second mode halves the error."""
    a = coefficients(1, hz=2.0)
    record = sweep(a, 29)
    x = record.displacement
    found = identify([changed(record, x + 0.1 * x.std() * np.sin(2 * np.pi * 8.3 * TIME + 1))])
    assert found.chosen.order == 1
    assert found.chosen.natural_hz == pytest.approx([1.0], rel=0.05)


@pytest.mark.slow
def test_without_a_spring(coefficients):
    """Torque to angle: the slowest pole is open, which is told and no refusal."""
    drive = np.sin(2 * np.pi * (0.3 * TIME + 0.6 * TIME**2))
    x = of_kind(tuple, lsim(([50.0], [1.0, 20.0, 0.0]), drive, TIME))[1]
    x = x + 1e-3 * np.ptp(x) * np.random.default_rng(5).standard_normal(SAMPLES)
    found = identify([Record("motor", TIME, drive, x)], input_map="linear", leave_out=("delay",))
    assert found.chosen.order == 2 and found.chosen.integrates
    assert any("integrates" in remark for remark in found.remarks)
    a = found.chosen.coefficients
    assert (a[1], a[2]) == pytest.approx((20 / 50, 1 / 50), rel=0.02)


def axis(seed, *, offset, kind=SAMPLES // 2):
    """A motor axis under a position controller at 200 Hz: 2.7 x'' + 5.8 x' = u + offset, and 0.05 % of noise."""
    dt, rng = 5e-3, np.random.default_rng(seed)
    top, bottom, _ = of_kind(tuple, cont2discrete(([1.0], [2.7, 5.8, 0.0]), dt, method="zoh"))
    (_, b1, b2), (_, a1, a2) = top.ravel(), bottom
    goal = np.repeat(0.1 * rng.standard_normal(kind // 250), 250)
    goal = lfilter([0.03], [1, -0.97], goal)
    x, u = np.zeros(kind), np.zeros(kind)
    for t in range(kind):
        x[t] = -a1 * x[t - 1] - a2 * x[t - 2] + b1 * (u[t - 1] + offset) + b2 * (u[t - 2] + offset) if t > 1 else 0.0
        u[t] = 80 * (goal[t] - x[t]) - 8 * (x[t] - x[t - 1]) / dt * (t > 0)
    noise = 5e-4 * np.ptp(x)
    return Record(f"axis{seed}", dt * np.arange(kind), u, x + noise * rng.standard_normal(kind)), noise


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_an_axis_without_a_spring_predicts_other_motions_at_the_noise(offset):
    """The controller's input balances an offset of the amplifier, which an integrator would run away with."""
    record, noise = axis(1, offset=offset)
    found = identify([record], input_map="linear", leave_out=("delay",))
    fit = found.chosen
    assert fit.integrates and fit.order == 2 and not any("unstable" in line for line in found.remarks)
    assert fit.coefficients == pytest.approx([0.0, 5.8, 2.7], rel=3e-3, abs=1e-6)
    assert fit.input_offset == pytest.approx(offset, abs=3e-3) and fit.rms < 1.03 * noise
    other, noise = axis(2, offset=offset)
    (run,) = predict(found.model, [other])
    assert np.sqrt(np.mean((run.displacement - other.displacement)[run.scored] ** 2)) < 1.5 * noise


def test_a_diagnosis_refits_the_offset_of_an_axis():
    """It belongs to the linear model of a plant without a spring, and is no effect of its own there."""
    records = [axis(seed, offset=offset, kind=2000)[0] for seed, offset in ((1, 0.3), (3, 0.1))]
    nominal = identify(records[:1], input_map="linear", order=2, leave_out=("delay",)).model
    search = Search(build_case(nominal.model, records[1:]), True)
    assert search.linear.fit.value(OFFSET) == pytest.approx(0.1, abs=5e-3)
    assert all(form.name != "voltage_offset" for form in search.library)


def test_what_is_left_out_of_fold_by_band(coefficients):
    """White noise alone is left of a linear plant: in every octave as much as its width says; the model carries it."""
    found = identify([sweep(coefficients(2), 30)], order=2, hold="foh", leave_out=("delay",))
    own, noise = found.out_of_fold, NOISE * simulate(coefficients(2), SWEEP).std()
    assert np.sqrt(np.sum(np.square(own.error))) == pytest.approx(noise, rel=0.1)
    width = np.diff(own.edges_hz)[6:-1] * 2 * DT
    assert np.square(own.error)[6:-1] / noise**2 == pytest.approx(width, rel=0.5)
    assert found.model.origin.out_of_fold == own
    # the error to expect of a motion is then this noise, whatever its frequency and amplitude
    x = simulate(coefficients(2), SWEEP)
    expected = expected_error(found.model, x, DT)
    assert expected is not None and expected.percent == pytest.approx(100 * noise / np.ptp(x), rel=0.1)


def test_what_a_search_costs(coefficients):
    """A sweep's response leads to its start and orders: a grid of starts, with every order after it, costs three times.

    Counted in runs of a mode, not in seconds.
    """
    record = sweep(coefficients(2), 31)
    # the grid of starts stays for beginnings: without it an order three behind a delay was called at rest
    assert calls(lambda: find_beginnings([record], "square"), "_linear_filter") < 250
    assert calls(lambda: identify([record]), "_linear_filter") < 1500


def test_a_zero_that_the_first_samples_bend_is_fitted_where_the_model_leaves_only_noise():
    """A slow drive moves the plant within the noise of the samples that a zero was read from: 7 standard errors off."""
    time = np.arange(4000) * 5e-3
    slow = chirp(time, 0.05, time[-1], 0.5, phi=-90)
    x = of_kind(tuple, lsim(([350.0], [1.0, 5.6, 350.0]), slow, time))[1]
    x = x + 0.02 * np.random.default_rng(1).standard_normal(len(time))
    found = identify([Record("slow", time, slow, x)], order=2, input_map="linear", hold="foh", leave_out=("delay",))
    assert found.chosen.rms == pytest.approx(0.02, rel=0.03)
    assert abs(found.chosen.offset) < 4 * found.beginnings["slow"].stderr < 0.01


def test_a_record_at_rest_is_at_rest_whatever_the_model_leaves(coefficients):
    """A sensor that reads |x|: no linear model explains it, and a start in motion took up what it could."""
    drive = np.sin(2 * np.pi * (0.2 * TIME + 11.8 * TIME**2 / TIME[-1] / 2))
    x = simulate(coefficients(2, hz=2.0), drive, square=False) * coefficients(2, hz=2.0)[0]
    y = np.abs(x + 0.3) - 0.3 + 5e-3 * np.random.default_rng(0).standard_normal(SAMPLES)
    (begun,), _, _ = find_beginnings([Record("folded", TIME, drive, y)], "linear")
    assert begun.begins == "rest" and abs(begun.zero) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("order", "hz", "late"), [(1, 8.0, 11.3), (3, 5.0, 16.0), (4, 3.2, 8.2)])
def test_a_record_cut_from_a_motion_behind_a_delay(coefficients, order, hz, late):
    """Called held, at rest, or unexplained by orders 1 to 3: its free run elsewhere was off by up to 50 noises."""
    a = coefficients(order, hz=hz, stiffness=1.0)
    drive = 1.5 + np.sin(2 * np.pi * (0.3 * TIME + 14.9 * TIME**2 / 16))
    drawn = np.random.default_rng(1).standard_normal(SAMPLES)
    coloured = np.asarray(lfilter([np.sqrt(1 - 0.81)], [1.0, -0.9], drawn))

    def moved(u):
        behind = np.interp(np.arange(SAMPLES) - late, np.arange(SAMPLES), u)
        return simulate(a, behind - behind[0], square=False) + behind[0]

    x, size = moved(drive), 5e-4 * np.ptp(moved(drive))
    found = identify([Record("cut", TIME[700:], drive[700:], (x + size * coloured)[700:])], input_map="linear")
    assert found.chosen.order == order and found.beginnings["cut"].begins == "moving"
    other = np.sin(2 * np.pi * 0.7 * TIME) * np.sin(2 * np.pi * 0.31 * TIME) + 0.5 * np.sin(2 * np.pi * 3.1 * TIME)
    truth = moved(other)
    (run,) = predict(found.model, [Record("other", TIME, other, truth)])
    assert np.std((run.displacement - truth)[run.scored]) < 0.5 * size


def test_a_delay_that_is_asked_for_and_vanishes_is_none(coefficients):
    """As one more number, 1e-11 s long, it cost the held-out scores of the order that it stood beside."""
    found = identify([sweep(coefficients(2), 32)], order=2, hold="foh", learn=("delay",))
    assert found.chosen.delay == 0.0 and not found.model.effects
    assert errors(found.chosen, coefficients(2)).max() < 5


@pytest.mark.parametrize(("hz", "order"), [(2.3, 2), (2.7, None)])
def test_two_seconds_into_a_fast_sweep_of_ten(hz, order):
    """The mode is found from a fit with a vanished delay; half of a slow pair is a real pole without a spring."""
    rate, time = 200.0, np.arange(2000) / 200.0
    u = 1500 * (1 - chirp(time, 0.3 * hz, 10.0, 3 * hz))
    w = 2 * np.pi * hz
    top, bottom, _ = of_kind(tuple, cont2discrete(([w * w], [1, 0.04 * w, w * w]), 1 / rate, method="foh"))
    x = np.asarray(lfilter(np.ravel(top), bottom, u))
    found = identify([Record("r", time[:1600], u[400:], x[400:])], input_map="linear")
    assert order is None or found.chosen.order == order
