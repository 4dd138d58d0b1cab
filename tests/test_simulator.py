"""The diagnosis' simulator beside SciPy, and every form of its library beside the package's own rollout."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim, lti

import pitp_jax as pitp
from pitp_jax.method.diagnose.clocks import Fault
from pitp_jax.method.diagnose.data import build_case
from pitp_jax.method.diagnose.library import (  # fmt: skip
    AHEAD,
    DELAY,
    FAULTS,
    INDEX,
    LAG,
    LOGARITHM,
    MONITOR,
    OFF,
    PLACES,
    ROWS,
    SHAPE,
    SHIFT,
    Scale,
    coefficients_of,
    model_of,
    sections,
    slots_of,
)
from pitp_jax.method.diagnose.simulator import Drive, Simulator
from pitp_jax.method.effects import CATALOGUE, effect
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.fitted import model_of as model_of_file
from pitp_jax.method.model.input_map import LinearInput, SquareInput
from pitp_jax.method.signal.record import Record
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout
from pitp_jax.method.simulate.model_runs import model_runs

MODELS = Path(__file__).parent / "files" / "models_0_2_0"
DT, SAMPLES = 2e-3, 2000
TIME = np.arange(SAMPLES) * DT
SCALE = Scale(
    tau=0.03, dt=DT, duration=4.0, session=0.0, reach=1.0, top=1.0, bottom=-1.0, speed=30.0, acceleration=1e3, fall=1e3,
    voltage=1400.0, slew=1e4, area=100.0, a0=1.0, a1=0.006, a2=0.001, force=2.0,
)  # fmt: skip
VOLTS = 600 * (1.3 - np.cos(2 * np.pi * (0.5 + 1.2 * TIME) * TIME))


@pytest.fixture(scope="module")
def nominal(linear):
    return replace(linear(hz=5.0, dt=DT), substeps=8)


def simulator_of(square=True, scale=1.0, dt=DT, volts=VOLTS, substeps=4, start=(0.0, 0.0), before: float | None = 0.0):
    """One record; rates of 31.4 1/s."""
    square_or_linear = SquareInput() if square else LinearInput()
    of = pitp.linear_model(
        np.ones(3), dt=dt, input_map=square_or_linear, state_scale=31.4 ** np.arange(3.0), force_scale=scale
    )
    return Simulator((Drive(volts, dt, start, 0.0, before),), of, None, OFF, substeps)


def free_run(slots, volts=VOLTS, dt=DT, square=True, scale=1.0, substeps=4, start=(0.0, 0.0), before=None):
    return simulator_of(square, scale, dt, volts, substeps, start, before).run(slots[None], [0], np.array([start]))[0]


LINEAR = ((2.0, 0.3, 0.05), (2.0, 0.3, 0.0), (0.0, 0.3, 0.05), (2.0, 1.5, 0.05), (1e-6, 1e-3, 0.05))


@pytest.fixture(scope="module")
def linear_runs():
    """Time, input, and the runs of `LINEAR` with one and with two steps a sample; 40 samples in a period of 1 Hz."""
    time = np.arange(300) * 0.025
    u = np.sin(0.6 * np.pi * time) + np.sign(np.sin(0.22 * np.pi * time))
    slots = np.tile(OFF, (len(LINEAR), 1))
    for row, a in zip(slots, LINEAR, strict=True):
        row[[INDEX[k] for k in ("a0", "a1", "a2")]] = a
    simulators = [simulator_of(False, dt=0.025, volts=u, substeps=n, before=None) for n in (1, 2)]
    return time, u, [s.run(slots, [0] * len(slots), np.zeros((len(slots), 2))) for s in simulators]


@pytest.mark.parametrize("k", range(len(LINEAR)), ids=[str(a) for a in LINEAR])
def test_the_linear_part_is_of_order_four(linear_runs, k):
    """Beside SciPy's exact response: without damping, without a spring, of order one, and with two real poles."""
    (time, u, runs), a = linear_runs, LINEAR[k]
    plant = lti([1.0], [v for v in a[::-1] if v or v == a[0]])
    truth = lsim(plant, u, time)[1]
    coarse, fine = (run[k] - truth for run in runs)
    assert np.abs(coarse).max() < 1e-3 * np.abs(truth).max()
    assert np.abs(fine).max() < max(np.abs(coarse).max() / 12, 1e-9 * np.abs(truth).max())


def test_a_drive_that_jumps_at_its_first_sample_is_there_at_once():
    """From rest at 0 V: as a ramp over the first step it once left 1.5 times the noise in every healthy record."""
    slots = OFF.copy()
    for k, v in (("a0", 1.0), ("a1", 0.006), ("a2", 0.001)):
        slots[INDEX[k]] = v
    u = 600 + 350 * np.sin(7 * TIME)
    truth = lsim(([1.0], [0.001, 0.006, 1.0]), u, TIME)[1]
    run = free_run(slots, u, square=False, substeps=4, before=0.0)
    np.testing.assert_allclose(run, truth, atol=1e-6 * np.abs(truth).max())


@pytest.mark.parametrize("square", [False, True])
@pytest.mark.parametrize("delay", [0.0, 0.7 * DT])
def test_a_band_limited_input_is_not_linear_between_samples(delay, square):
    """Beside SciPy on a grid 40 times as fine: a sine at a fifth of the rate has lost an eighth of it on lines."""
    slots = OFF.copy()
    slots[[INDEX[k] for k in ("a0", "a1", "a2", DELAY)]] = 1.0, 0.006, 2e-5, delay
    fine = np.arange(40 * SAMPLES) * DT / 40
    wave = [2.0 + np.sin(2 * np.pi * 0.2 * t / DT) * np.minimum(t / 0.5, 1) for t in (TIME, fine - delay)]
    truth = lsim(([1.0], [2e-5, 0.006, 1.0]), (wave[1] ** 2 if square else wave[1]), fine)[1][::40]
    lines = simulator_of(square, volts=wave[0], before=None)
    smooth = replace(lines, model=replace(lines.model, hold="bandlimited"))
    late = SAMPLES // 2  # the sine begins slowly, and the value at 0 s has settled
    runs = [s.run(slots[None], [0], np.zeros((1, 2)))[0][late:-20] for s in (lines, smooth)]
    straight, found = (np.abs(run - truth[late:-20]).max() / np.ptp(truth[late:-20]) for run in runs)
    assert found < 2e-3 < 0.05 < straight


# numbers at which every row acts on these records, in the model's scaled coordinates (rates of 31.4 1/s)
NUMBERS = {
    "stiffening: cubic": (0.3,), "stiffening: limited chain": (0.4,), "stiffening: polynomial": (0.1, 0.1, 0.02),
    "softening: quadratic": (0.1,), "softening: saturating": (0.6,), "softening: exponential": (0.4,),
    "softening: gravity": (0.9,), "softening: root": (0.4,),
    "softening: weight on an arm": (0.3, 0.9), "mullins: exponential": (0.2, 0.4),
    "end_stop: above": (4.0, 0.5), "end_stop: below": (4.0, 0.05), "end_stop: each side": (4.0, 0.5, 0.1),
    "end_stop: each side, damped": (4.0, 0.5, 0.1, 0.02),
    "creep: one branch": (0.3, 0.5), "relaxation: one branch": (0.3, 0.05), "hysteresis: plays": (0.5, 0.1),
    "hysteresis: Dahl": (0.4, 0.2), "hysteresis: Bouc-Wen, either sign": (0.4, 0.2, -0.5),
    "hysteresis: Dahl at four widths": (0.4, 0.2, 0.5, 2.0),
    "stiffness_drift: settling": (0.1, 2.0), "second_mode: hung on": (0.2, 55.0, 0.05), "drag: quadratic": (2.0,),
    "drag: three powers": (0.7, 0.7, 0.7),
    "coulomb_friction: Coulomb": (0.05,), "coulomb_friction: loaded by the spring": (0.05, 0.1),
    "coulomb_friction: loaded by spring and mass": (0.05, 0.1),
    "coulomb_friction: smooth": (0.05, 0.016), "coulomb_friction: Stribeck": (0.05, 0.5, 0.16),
    "coulomb_friction: bristles under load": (0.2, 0.1, 0.05),
    "force_limit: inside the loop": (3.0,),
    "bleeder: one lag each way": (0.01, 0.04), "force_lag: one lag": (0.02,), "clock_shift: early output": (0.0073,),
    "clock_shift: lagging input": (0.01, 0.002),
    "slack: free fall": (1.1,), "electrode_rc: one lag": (0.02,),
    "electrode_rc: far part": (0.03, 0.7), "slew_limit: rate limit": (5e-5,),
    "voltage_clip: hard": (1 / 900,), "dead_zone: symmetric": (80.0,), "voltage_offset: constant": (60.0,),
    "delay: pure": (0.0073,), "charge_leak: one trap": (0.2, 0.5), "charge_retention: one store": (0.2, 0.5),
    "hysteresis: plays of the drive": (0.1, 0.2, -0.05, 0.1, 500.0),
    "hysteresis: Dahl of the command's integral": (80.0, 30.0), "stretch_coupling: linear": (0.2,),
    "stretch_coupling: exponential": (-0.3,), "dielectric_saturation: rational": (0.5,),
    "dielectric_saturation: sharp": (0.7,), "sensor_gain: share": (0.1,),
    "feedthrough: of the force": (1e-7,), "feedthrough: of the input": (1e-4,),
    "sensor_nonlinearity: quadratic and cubic": (0.1, 0.03), "sensor_nonlinearity: saturating": (0.5,),
    "sensor_nonlinearity: folded": (0.2,), "backlash: play": (0.1,), "backlash: coasting": (0.1, 5.0),
    "sensor_lag: one lag": (0.01,), "sensor_lag: second order": (0.008, 0.7),
    "second_mode: between film and sensor": (0.3, 55.0, 0.05), "found_term: products": (0.02, 0.3, 0.05),
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(nominal):
    """Free runs of the nominal alone (None) and with every row, side by side in one call."""
    plain = slots_of(nominal)[0]
    slots = np.tile(plain, (1 + len(ROWS), 1))
    for row, numbers in zip(ROWS, slots[1:], strict=True):
        numbers[PLACES[row]] = NUMBERS[row.key]
    simulator = Simulator((Drive(VOLTS, DT, (0.0, 0.0), 0.0, 0.0),), nominal, None, plain, 8)
    found = simulator.run(slots, [0] * len(slots), np.zeros((len(slots), 2)))
    return dict(zip((None, *(r.key for r in ROWS)), zip(slots, found, strict=True), strict=True))


@pytest.fixture(scope="module")
def package():
    """fn(model): the package's own scaled readings, shape (T,); all other forms are neutral, so one program does."""
    volts = jnp.asarray(VOLTS, jnp.float32)

    @eqx.filter_jit
    def run(model):
        return ports.readings(model, rollout(model, volts, DT, rest_state(model)))

    def readings(model):
        (own,) = model.effects
        forms = {form: form.neutral() for form in CATALOGUE} | {own.spec: own}
        return np.asarray(run(replace(model, effects=tuple(forms.values()))), float)

    return readings


@pytest.mark.slow
@pytest.mark.parametrize("row", [r for r in ROWS if r not in FAULTS], ids=lambda r: r.key)
def test_a_form_of_the_library_acts_as_in_the_package(nominal, runs, package, row):
    """What a fit has found is what the model that is handed back does (in float32), at the same steps."""
    slots, mine = runs[row.key]
    plain = runs[None][1]
    scale = replace(SCALE, tau=0.005 if row.name == "creep" else 0.5 if row.name == "relaxation" else 0.03)
    model, added = model_of(slots_of(nominal)[0], slots, nominal, scale)
    assert [e.name for e, _ in added] == [row.name] and len(model.effects) == 1
    truth = package(model)
    effect = np.std(truth - plain)
    assert effect > 5e-3 * np.std(plain)
    assert np.std(mine - truth) < 0.03 * effect + 2e-4 * np.std(plain)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("trained", [False, True])
@pytest.mark.parametrize("refit", [False, True])
def test_an_effect_is_added_to_the_model_that_was_given(linear, nonlinear, order, trained, refit):
    """It keeps its parts, and its order where no effect comes before its lag; a refit moves its poles."""
    given = (nonlinear if trained else linear)(order, hz=5.0, damping=0.2, dt=DT)
    before = slots_of(given)[0]
    slots = before.copy()
    if refit:
        slots[:3] *= np.array([1.2, 1.1, 0.9])
        slots[INDEX[LAG]] *= 1.5
    row = next(r for r in ROWS if r.name == ("coulomb_friction" if order < 3 or trained else "slew_limit"))
    slots[PLACES[row]] = 0.1
    made, added = model_of(before, slots, given, SCALE)
    assert made.order == order and [e.name for e in made.effects] == [row.name] == [e.name for e, _ in added]
    assert type(made.encoder) is type(given.encoder)
    found, _ = slots_of(made)
    core = slice(min(order, 2) + 1)
    np.testing.assert_allclose(found[core], slots[core], rtol=1e-4)
    np.testing.assert_allclose(found[INDEX[LAG]], slots[INDEX[LAG]], rtol=1e-4)
    np.testing.assert_allclose(found[PLACES[row]], slots[PLACES[row]], rtol=1e-5)
    if trained and not refit:
        same = replace(made, effects=())
        for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(given), strict=True):
            np.testing.assert_allclose(np.asarray(a, float), np.asarray(b, float), rtol=1e-5)


@pytest.mark.parametrize("order", [3, 4])
@pytest.mark.parametrize("name", ["force_limit", "slack", "stiffening", "coulomb_friction", "end_stop"])
@pytest.mark.parametrize("hold", ["foh", "bandlimited"])
def test_an_effect_before_the_lag_acts_in_a_model_of_a_higher_order(linear, order, name, hold):
    """The run of the fit is that of the model handed back: in one of order three it would act on what lags."""
    given = linear(order, hz=5.0, damping=0.2, dt=DT, hold=hold)
    slots = slots_of(given)[0]
    row = next(r for r in ROWS if r.name == name)
    slots[PLACES[row]] = NUMBERS[row.key]
    simulator = Simulator((Drive(VOLTS, DT, (0.0, 0.0), 0.0, 0.0),), given, None, slots, 8)
    plain, mine = simulator.run(np.stack([slots_of(given)[0], slots]), [0, 0], np.zeros((2, 2)))
    made, _ = model_of(slots_of(given)[0], slots, given, SCALE)
    assert made.hold == hold
    made = replace(made, substeps=8)
    whole = model_runs(made, VOLTS[None], DT, np.asarray(rest_state(made))[None])[1][0]
    assert np.std(mine - plain) > 0.05 * np.std(plain)
    assert np.std(whole - mine) < 0.02 * np.std(mine - plain)


@pytest.mark.parametrize("part", [0.0, 0.2, 0.5, 0.8])
def test_an_input_that_acts_before_half_a_sample_is_not_held(linear, part):
    """A fitted delay (samples, from the mean of a held input on) is that of the model that is handed back."""
    given = linear(2, hz=5.0, damping=0.2, dt=DT, hold="zoh")
    before = slots_of(given)[0]
    slots = before.copy()
    slots[INDEX[DELAY]] = part * DT
    made, _ = model_of(before, slots, given, SCALE)
    np.testing.assert_allclose(slots_of(made)[0], slots, rtol=1e-5, atol=1e-9)
    assert made.hold == ("foh" if part < 0.5 else "zoh")


def test_an_early_output_is_the_run_of_the_voltage_to_come(runs):
    """y(t) = x(t + T): the same samples, T sooner."""
    plain, early = runs[None][1], runs[SHIFT.key][1]
    later = np.interp(TIME[200:-50] + NUMBERS[SHIFT.key][0], TIME, plain)
    assert np.abs(early[200:-50] - later).max() < 2e-3 * np.ptp(plain) < 0.02 * np.abs(early - plain).max()


@pytest.mark.parametrize("late", [-0.004, 0.006])
def test_a_lagging_input_is_the_voltage_before_its_low_pass(late):
    """The recorded voltage is SciPy's low pass of the true one, and late; the row and the correction undo both."""
    tau, true = 0.01, VOLTS - VOLTS[0]
    filtered = lsim(([1.0], [tau, 1.0]), true, TIME)[1]
    recorded = np.interp(TIME - late, TIME, filtered)
    slots = OFF.copy()
    for k, v in (("a0", 1.0), ("a1", 0.006), ("a2", 0.001)):
        slots[INDEX[k]] = v
    aim, before = free_run(slots, true, scale=1e6), free_run(slots, recorded, scale=1e6)
    found = slots.copy()
    found[INDEX[MONITOR]], found[INDEX[AHEAD]] = tau, late
    seen = slice(20, -20)
    assert np.abs(free_run(found, recorded, scale=1e6) - aim)[seen].max() < 0.02 * np.abs(before - aim).max()
    (repaired,) = Fault(late, tau).corrected([Record("r", TIME, recorded, aim)])
    again = free_run(slots, repaired.voltage, scale=1e6)
    assert np.abs(again - repaired.displacement)[seen].max() < 0.02 * np.abs(before - aim).max()


def test_every_row_is_off_at_its_off_value(nominal):
    """Numbers that only shape an effect change nothing where the effect is off."""
    plain = slots_of(nominal)[0]
    slots = np.where(SHAPE, 1.7 * plain, plain)
    np.testing.assert_array_equal(free_run(slots), free_run(plain))
    assert SHAPE.sum() > 20 and LOGARITHM[INDEX["a1"]]


@pytest.mark.slow
@pytest.mark.parametrize("square", [True, False])
def test_machine_code_equals_the_scan_for_every_row(nominal, square, monkeypatch):
    """2,000 steps in float64: no row, every row alone, and all together."""
    slots = np.tile(slots_of(nominal)[0], (2 + len(ROWS), 1))
    for k, row in enumerate(ROWS):
        slots[[k, -1], PLACES[row]] = NUMBERS[row.key]
    simulator = simulator_of(square, float(nominal.scales.force) if square else 1e3, substeps=1)
    run = lambda: np.array(simulator.run(slots, [0] * len(slots), np.zeros((len(slots), 2))))  # noqa: E731
    found = run()
    monkeypatch.setattr("pitp_jax.method.simulate.free_runs.kernel", lambda *_: None)
    scan = run()
    np.testing.assert_array_equal(np.isnan(found), np.isnan(scan))
    largest = np.nanmax(np.abs(scan), axis=1, keepdims=True)
    np.testing.assert_allclose(found / largest, scan / largest, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["compact_order_2", "compact_order_3"])
def test_a_trained_nominal_runs_with_its_encoder_beside_an_effect_and_changed_coefficients(name):
    """Beside the rollout of the model that would be handed back, from records of which the case is made."""
    given = pitp.load(MODELS / f"{name}.pitp")
    model = replace(model_of_file(given), substeps=4)
    model = replace(model, drive=ElectrodeLag(jnp.float32(np.log(0.3 / model.natural_frequency))))
    time, top = np.arange(600) * model.dt, np.sqrt(float(model.scales.force))
    factors = np.array([1.2, 0.8, 1.1, *[1.0] * (model.order - 2)])
    lag = effect("electrode_rc", tau=0.4 / model.natural_frequency)
    plant = replace(model.changed(factors), effects=(*model.effects, lag))
    volts = [top * np.sin(f * model.natural_frequency * time) ** 2 for f in (0.1, 0.35)]
    records = [
        pitp.Record(f"r{k}", time, v, pitp.rollout(plant, v, model.dt, begins="rest", zero="sensor"))
        for k, v in enumerate(volts)
    ]
    case = build_case(model, records)
    slots = case.nominal.copy()
    slots[:3] = coefficients_of(slots, 2) * factors[:3]
    if model.order == 3:  # (a_0 + a_1 s + a_2 s^2)(1 + tau s)
        core, late, _ = sections(plant.physical_coefficients)
        slots[:3], slots[INDEX[LAG]] = core * model.scales.state[0] / model.scales.force, late
    slots[PLACES[lag.spec]] = float(lag.tau)
    runs = case.simulator.run(np.tile(slots, (2, 1)), [0, 1], case.starts)
    for run, s in zip(runs, case.series, strict=True):
        assert np.abs(run - s.output)[s.counts].max() < 1e-3 * s.span
    apart = case.simulator.run(np.tile(case.nominal, (2, 1)), [0, 1], case.starts)
    assert np.abs(apart[1] - case.series[1].output).max() > 0.05 * case.series[1].span
