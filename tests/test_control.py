"""The exported controller in a closed loop: against withheld plants, with lost samples, in single precision."""

import importlib
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from effect_numbers import NUMBERS
from exported import COMPILERS, Exported
from scipy.linalg import expm

import pitp_jax as pitp
from pitp_jax import BadInput
from pitp_jax.method.effects import effect, lookup
from pitp_jax.method.invert.loop import margins, responding
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.input_map import SquareInput
from pitp_jax.method.model.model import Output, linear_model

pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
TOP, HZ, ZETA, STROKE, DT = 3000.0, 7.0, 0.08, 1e-3, 1e-3
VOLTAGE, SLEW, NO_TARGET, NO_SENSOR = 4, 8, 32, 64
ROOT = Path(__file__).parents[1]


def actuator(order=2, *, dt=DT, hz=HZ, zeta=ZETA, slew=1e6, region=(), **output):
    """1 mm at 3000 V; at order 3 a real pole at six times the resonance."""
    w, stiffness = 2 * np.pi * hz, TOP**2 / STROKE
    a = np.array([1, 2 * zeta / w, 1 / w**2])
    a = stiffness * (np.convolve(a, [1, 1 / (6 * w)]) if order == 3 else a)
    known = Domain(dt=dt, voltage_range=(0.0, TOP), slew=slew, region=region)
    return linear_model(
        a, input_map=SquareInput(), state_scale=STROKE * w ** np.arange(order + 1), force_scale=TOP**2,
        output=Output(**output), hold="foh", substeps=4 if order == 3 else 1, domain=known,
    )  # fmt: skip


def export(model, folder, precision="double"):
    pitp.export_c(model, folder / "c", precision=precision)
    return Exported(folder / "c", model.order, single=precision == "single", options=("-O2",))


# ------------------------------------------------------------------------------------------------ the gains


def test_the_margins_of_a_lightly_damped_pair_are_the_closed_form():
    """L = (1 + 2 zeta s/w) / (lambda s (1 + 2 zeta s/w + (s/w)^2)): at lambda = 2/(zeta w) it passes -1/4.

    At the default it passes -g with 1 / (1 - g) = 1.7.
    """
    slow = 2 / (0.02 * 2 * np.pi * HZ)
    chosen = pitp.pi_gains(actuator(dt=1e-4, zeta=0.02)).time_constant
    assert chosen == pytest.approx(slow / 4 / (1 - 1 / 1.7), rel=0.05)
    gains = pitp.pi_gains(actuator(dt=1e-4, zeta=0.02), time_constant=slow)
    assert gains.time_constant == slow
    assert gains.i == pytest.approx(TOP**2 / STROKE / gains.time_constant, rel=1e-5)
    assert gains.p / gains.i == pytest.approx(2 * 0.02 / (2 * np.pi * HZ), rel=1e-5)
    assert gains.gain_margin == pytest.approx(4, rel=0.02)
    assert gains.max_sensitivity == pytest.approx(4 / 3, rel=0.02)


def test_a_loop_too_fast_is_refused_with_one_that_is_not(tmp_path):
    w = 2 * np.pi * HZ
    with pytest.raises(BadInput, match=r"maximum sensitivity .* above 2 .* give at least"):
        pitp.export_c(actuator(), tmp_path / "c", time_constant=0.8 / (ZETA * w))
    assert not (tmp_path / "c").exists()
    assert pitp.pi_gains(actuator(), time_constant=1.2 / (ZETA * w)).max_sensitivity < 2


@pytest.mark.slow
def test_a_late_drive_makes_the_loop_slower():
    """A delay of half the time constant turns the loop by half a radian where it crosses one: more sensitive."""
    late = replace(actuator(zeta=0.6), effects=(effect("delay", time=0.2),))
    plain, slow = pitp.pi_gains(actuator(zeta=0.6)), pitp.pi_gains(late)
    assert slow.time_constant > plain.time_constant and slow.max_sensitivity < 1.7


# ------------------------------------------------------------------------------------------------ withheld plants


@pytest.fixture(scope="module")
def withheld():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "experiments"))
        yield importlib.import_module("closed_loop"), importlib.import_module("_withheld.mechanical")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "polarity"), [("healthy", 1.0), ("stiffening", -1.0)])
def test_a_limit_hit_is_left_in_four_time_constants(withheld, tmp_path, polarity, kind):
    """A plant 20 % too weak at the limit for 6 s, then 15 % too strong; without anti-windup it takes longer."""
    script, mechanical = withheld
    forms = () if kind == "healthy" else (mechanical.STIFFENING[0],)
    model = actuator(polarity=polarity, offset=5e-3 if polarity < 0 else 0.0)
    made, offset = export(model, tmp_path), float(model.output.offset)
    lag = pitp.pi_gains(model).time_constant
    assert lag <= 2 / (ZETA * 2 * np.pi * HZ) * (1 + 1e-6)
    reaches, turns, count = 1.0, 8.0, int((8 + 9 * lag) / DT)
    t = np.arange(count) * DT
    rise = 0.9 * STROKE * script.smooth(t / reaches) - 0.3 * STROKE * script.smooth((t - turns - 5 * lag) / 0.5)
    rows = [rise]
    for _ in range(2):
        rows.append(np.gradient(rows[-1], DT))
    target = np.stack(rows, 1)

    def run(bounded):
        plant = script.Plant(forms, [0.1] * len(forms), [{}] * len(forms), ZETA, 2 * np.pi * HZ * DT)

        def read(k, u):
            return offset + polarity * STROKE * plant(u / TOP, 0.8 if k * DT < turns else 1.15)

        y, u, flags = made.loop(read, target, offset, 0.0, bounded=bounded)
        assert u.min() >= 0 and u.max() <= TOP
        assert (flags[int(3 / DT) : int(turns / DT)] & VOLTAGE).all()  # at the limit
        return np.abs(polarity * (y - offset) - target[:, 0]) / STROKE

    error = run(True)
    after = slice(int((turns + 4 * lag) / DT), int((turns + 5 * lag) / DT))
    assert error[after].max() < 0.02
    assert error[-int(0.1 / DT) :].max() < 0.02  # and after the target has moved on
    assert run(False)[after].max() > 0.02


# ------------------------------------------------------------------------------------------------ what is lost


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return export(actuator(), tmp_path_factory.mktemp("rig"))


def cosine(hz, stroke, dt, seconds, ahead=0.0):
    t = np.arange(int(seconds / dt)) * dt + ahead
    return 0.5 * stroke * (1 - np.cos(2 * np.pi * hz * t))


@pytest.mark.parametrize(("lost", "volts"), [(1, 0.5), (8, 15.0)])
def test_a_target_that_is_lost_is_carried_on(rig, lost, volts):
    """4 Hz: the voltage stays nearly what it would have been."""
    target = 1e-4 + cosine(4.0, STROKE / 2, DT, 1.2)
    whole, _ = rig.command(4, target)
    target[530 : 530 + lost] = np.nan
    kept, flags = rig.command(4, target)
    assert (flags[530 : 530 + lost] & NO_TARGET).all() and not (flags[:530] & NO_TARGET).any()
    assert np.abs(kept - whole)[100:].max() < volts
    assert whole[100:].max() - whole[100:].min() > 500


def test_a_target_lost_for_long_ramps_down_and_comes_back(rig):
    target = np.full(3000, 4e-4)
    target[500:1500] = np.nan
    u, flags = rig.command(4, target)
    assert u[499] > 1500 and u[515] == pytest.approx(u[499], rel=1e-6)
    assert u[1400] == 0 and u[-1] == pytest.approx(u[499], rel=1e-6)


def test_a_reading_that_is_lost_keeps_the_correction_then_fades(rig):
    """A plant 10 % weak: 20 ms without a reading change nothing; long ones end at the feedforward, without a jump."""
    target = np.tile([4e-4, 0.0, 0.0], (14000, 1))
    ahead = rig.command(0, target)[0][-1]

    def weak(state=[0.0, 0.0]):  # noqa: B006
        w = 2 * np.pi * HZ

        def plant(k, u):
            for _ in range(4):
                a = w**2 * (0.9 * STROKE * (u / TOP) ** 2 - state[0]) - 2 * ZETA * w * state[1]
                state[1] += a * DT / 4
                state[0] += state[1] * DT / 4
            return state[0]

        return plant

    def seen(k, y):
        return np.nan if 6000 <= k < 6015 or 8000 <= k < 13000 else y

    _, u, flags = rig.loop(weak([0.0, 0.0]), target, seen=seen)
    assert (flags[8000:13000] & NO_SENSOR).all() and not flags[6100:7900].any()
    np.testing.assert_array_equal(u[6000:6015], u[6000])
    assert u[7999] == pytest.approx(ahead / np.sqrt(0.9), rel=1e-3)
    assert abs(u[12999] - ahead) < 0.02 * abs(u[7999] - ahead)
    assert np.abs(np.diff(u[5000:])).max() < 2.0  # no jump, when it goes or comes


def test_a_start_takes_over_the_voltage_that_stands(rig):
    """Begun under 1200 V with the target of 2000 V: the first voltage is 1200 V."""
    y0 = STROKE * (1200 / TOP) ** 2
    target = np.tile([STROKE * (2000 / TOP) ** 2, 0.0, 0.0], (3, 1))
    u, flags = rig.command(2, target, measured=np.full(3, y0), y0=y0, u0=1200.0)
    assert u[0] == pytest.approx(1200, rel=1e-4) and (np.diff(u) > 0).all() and not flags.any()


@pytest.mark.slow
@pytest.mark.parametrize("polarity", [1.0, -1.0])
def test_a_live_target_is_reached(tmp_path, polarity):
    """A step without derivatives: no voltage beyond its static one by a half, no overshoot above a tenth, no error."""
    model = actuator(zeta=0.3, polarity=polarity, offset=2e-3)
    made, w = export(model, tmp_path), 2 * np.pi * HZ
    state = [0.0, 0.0]

    def plant(k, u):
        for _ in range(4):
            a = w**2 * (0.9 * STROKE * (u / TOP) ** 2 - state[0]) - 0.6 * w * state[1]
            state[1] += a * DT / 4
            state[0] += state[1] * DT / 4
        return 2e-3 + polarity * state[0]

    y, u, _ = made.loop(plant, np.full(3000, 5e-4), 2e-3, 0.0, alive=True)
    x = polarity * (y - 2e-3)
    assert abs(x[-1] - 5e-4) < 1e-6 and x.max() < 5.5e-4 and u.max() < 1.5 * u[-1]


def test_fast_math_is_refused(tmp_path):
    pitp.export_c(actuator(), tmp_path / "c")
    for option in ("-ffast-math", "-Ofast"):
        command = ["gcc", "-std=c99", option, "-c", "-o", "/dev/null", "pitp_model.c"]
        told = subprocess.run(command, cwd=tmp_path / "c", capture_output=True, text=True)
        assert told.returncode != 0 and "compile without -ffast-math" in told.stderr


# ------------------------------------------------------------------------------------------------ single precision


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("rate", [1000, 5000, 20000])
@pytest.mark.parametrize(("offset", "stroke"), [(5e-2, 20e-6), (0.0, 1e-3)])
def test_single_precision_differentiates_to_half_a_percent(tmp_path, order, rate, offset, stroke):
    """A 4 Hz cosine through inverse_target_step, as float, against its own derivatives through double."""
    dt = 1 / rate
    region = ((0.0, 1.0), *[(-9.0, 9.0)] * (order - 1))
    model = actuator(order, dt=dt, hz=7.4, offset=offset, region=region)
    single = export(model, tmp_path, "single")
    header = (tmp_path / "c" / "pitp_model.h").read_text()
    ahead = int(header.split("LOOK_AHEAD")[1].split("u")[0])
    u, flags = single.command(1, cosine(4.0, stroke, dt, 0.6, ahead * dt))
    t, w = np.arange(len(u)) * dt, 2 * np.pi * 4.0
    a = model.physical_coefficients
    force = a[0] * stroke / 2 - sum(a[i] * stroke / 2 * w**i * np.cos(w * t + i * np.pi / 2) for i in range(order + 1))
    settled = t > 3 * ahead * dt
    error = np.abs(u.astype(float) ** 2 - force)[settled] / force.max()
    assert not (flags[settled] & (VOLTAGE | SLEW)).any()
    assert error.max() < 0.005


def test_single_precision_beyond_that_is_refused(tmp_path):
    """The third derivative of 500,000 samples a second: no window of float's rounding is long enough."""
    model = actuator(3, dt=2e-6, region=((0.0, 1.0), *[(-9.0, 9.0)] * 2))
    with pytest.raises(BadInput, match="double"):
        pitp.export_c(model, tmp_path / "c", precision="single")


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("arm-none-eabi-gcc"), reason="no cross compiler")
def test_a_cortex_m4_takes_it_and_what_it_takes_is_told(tmp_path):
    """Without a number in double precision; the README's flash is right to a factor of two, its RAM to the byte."""
    pitp.export_c(
        actuator(3, dt=1 / 20000, offset=5e-2, region=((0.0, 1.0), *[(-9.0, 9.0)] * 2)),
        tmp_path / "c",
        precision="single",
    )
    said = subprocess.run(["make", "size"], cwd=tmp_path / "c", capture_output=True, text=True, check=True).stdout
    called = subprocess.run(
        ["arm-none-eabi-nm", "-u", "pitp_model_chip.o"], cwd=tmp_path / "c", capture_output=True, text=True
    )
    assert "__aeabi_d" not in called.stdout and "__aeabi_f2d" not in called.stdout
    flash = int(said.splitlines()[-1].split()[0])
    page = (tmp_path / "c" / "README.md").read_text()
    told = float(page.split("flash about ")[1].split(" kB")[0]) * 1024
    assert told / 2 < flash < 2 * told
    size = tmp_path / "c" / "size.c"
    size.write_text('#include "pitp_model.h"\nconst unsigned size = sizeof(pitp_model_state);\n')
    assembly = subprocess.run(
        ["arm-none-eabi-gcc", "-S", "-o", "-", "size.c"], cwd=tmp_path / "c", capture_output=True, text=True, check=True
    )
    assert f".word\t{page.split('RAM ')[1].split(' bytes')[0]}\n" in assembly.stdout


# ------------------------------------------------------------------------------------------------ trained models


@pytest.fixture(scope="module")
def loops():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "experiments"))
        yield importlib.import_module("_trained_loops")


@pytest.mark.slow
@pytest.mark.parametrize("place", [1, 6])
def test_the_default_of_a_trained_model_holds_changed_plants(loops, tmp_path, place):
    """Compiled C on plants with stiffness and gain 20 % off: under 2 % five time constants after a load step."""
    kind = loops.KINDS[place]
    made = loops.Loop(kind, loops.made(kind), tmp_path)
    default = made.gains.time_constant
    assert max(made.error(plant, default) for plant in loops.PLANTS) < 0.02
    assert default <= made.slowest
    assert made.error("same", default / 3) > 0.02  # and not more than three times what the simulation bears


@pytest.mark.slow
@pytest.mark.parametrize("place", [k for k in range(12) if k not in (1, 6)])
def test_every_accepted_time_constant_of_a_trained_model_is_borne(loops, tmp_path, place):
    row = loops.verified(loops.KINDS[place], tmp_path)
    assert row["worst_accepted"] < 0.02
    assert row["over_slowest"] <= 1 and row["over_smallest"] <= 3
    if loops.KINDS[place].size < 0.1:
        assert 1 / 1.5 < row["gain_margin"] / row["linear_gain_margin"] < 1.5


@pytest.mark.parametrize("seed", range(6))
def test_a_loop_is_stable_where_its_eigenvalues_are(seed):
    """Plants of order 3, half of them unstable by themselves: the margins against the closed loop's own matrix."""
    rng, dt = np.random.default_rng(seed), 1e-2
    stable_loops = 0
    for k in range(60):
        A = rng.standard_normal((3, 3))
        A *= (rng.uniform(0.5, 0.97) if k % 2 else rng.uniform(1.01, 1.05)) / np.abs(np.linalg.eigvals(A)).max()
        B, C = rng.standard_normal((2, 3))
        p, i = rng.uniform(0, 0.5), rng.uniform(0.1, 5)
        plants = [responding(np.vstack([A, C]), np.append(B, 0.0), dt, 1.0)]
        # y_k+1 is the output of the step from k: state, y, integral
        whole = np.zeros((5, 5))
        whole[:3, :3], whole[3, :3] = A, C
        whole[:, 3] += np.append(-B * (p + i * dt), [0, -dt])
        whole[:3, 4], whole[4, 4] = B * i, 1
        radius = np.abs(np.linalg.eigvals(whole)).max()
        stable = np.isfinite(margins(plants, p, i, dt)[1])
        # a loop close to its limit may be refused all the same: no grid of frequencies resolves it
        assert stable == (radius < 1) if abs(radius - 1) > 0.03 else stable <= (radius < 1)
        stable_loops += stable
    assert 5 < stable_loops < 55


def test_what_no_voltage_holds_is_refused_and_exported_without_a_controller(tmp_path):
    """A leak lets every held voltage fade: no equilibrium. With an infinite time constant PI is the feedforward."""
    leaky = replace(actuator(), effects=(effect("charge_leak", kappa=1.0, tau=2.0),))
    for seconds in (None, 0.3):
        with pytest.raises(BadInput, match="no voltage in the model's range holds"):
            pitp.pi_gains(leaky, time_constant=seconds)
    for dt in (0.0, -1e-3, np.nan):
        with pytest.raises(BadInput, match="dt .* is not a positive number"):
            pitp.pi_gains(actuator(), dt)
    pitp.export_c(leaky, tmp_path / "c", time_constant=np.inf)
    assert f"pitp_jax {pitp.__version__}" in (tmp_path / "c" / "pitp_model.h").read_text()
    made, target = Exported(tmp_path / "c", 2), np.zeros((300, 3))
    target[:, 0] = cosine(2.0, STROKE / 2, DT, 0.3)
    alone, trimmed = made.command(0, target)[0], made.command(2, target, measured=np.full(300, 1e-4))[0]
    np.testing.assert_array_equal(trimmed, alone)


@pytest.mark.parametrize(("dt", "precision"), [(5e-5, "double"), pytest.param(5e-5, "single", marks=pytest.mark.slow)])
def test_an_export_proves_itself_at_a_high_rate(tmp_path, dt, precision):
    """7 Hz at 20 kHz, the sensor 50 mm off zero: the vector covers the stroke, and `make` finds a wrong number."""
    pitp.export_c(actuator(dt=dt, offset=5e-2), tmp_path / "c", precision=precision)
    said = subprocess.run(["make"], cwd=tmp_path / "c", capture_output=True, text=True)
    assert said.returncode == 0, said.stdout
    text = (tmp_path / "c" / "main.c").read_text()
    rows = text.split("displacement[COUNT] = {")[1].split("}")[0].replace("f", "").split(",")
    assert np.ptp([float(v) for v in rows]) > 0.5 * STROKE
    source = tmp_path / "c" / "pitp_model.c"
    head, core = source.read_text().split("static void predict_core")
    source.write_text(head + "static void predict_core" + core.replace("0.5", "0.502", 1))
    assert subprocess.run(["make", "-B"], cwd=tmp_path / "c", capture_output=True).returncode != 0


@pytest.mark.parametrize(("name", "numbers"), [("coulomb_friction", {"level": 0.01}), ("backlash", {"width": 0.05})])
def test_dry_friction_and_play_do_not_enter_the_loop(name, numbers):
    """A machine that is held still or within its play has no response; the gains are those of the sliding one."""
    plain = actuator()
    assert pitp.pi_gains(replace(plain, effects=(effect(name, **numbers),))) == pitp.pi_gains(plain)


# ------------------------------------------------------------------------------------------------ its own plant


def held_plant(model, weaker=1.0, slew=np.inf, late=0):
    """fn(k, u) -> displacement one sample on: the equation under held voltages, delayed and slowed, exactly."""
    a, n = model.physical_coefficients, model.order
    exact = np.zeros((n + 1, n + 1))
    exact[: n - 1, 1:n] = np.eye(n - 1)
    exact[n - 1, :n], exact[n - 1, n] = -a[:-1] / a[-1], 1 / a[-1]
    parts = 16 if np.isfinite(slew) else 1  # the amplifier moves within a sample
    exact = expm(exact * DT / parts)
    state, line, volts = np.zeros(n + 1), [0.0] * (late + 1), [0.0]

    def plant(k, u):
        line.append(u)
        for _ in range(parts):
            volts[0] += np.clip(line[-1 - late] - volts[0], -slew * DT / parts, slew * DT / parts)
            state[n] = weaker * volts[0] ** 2
            state[:] = exact @ state
        return state[0]

    return plant


GRID = [(n, late, noise, slew) for n in (1, 2, 3) for late in range(5) for noise in (1e-4, 5e-3) for slew in (0, 1)]
QUICK = [(2, 3, 5e-3, 1), (1, 4, 1e-4, 0)]


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=() if c in QUICK else pytest.mark.slow, id="-".join(map(str, c))) for c in GRID]
)
def test_on_the_plant_it_was_made_for_the_loop_is_never_worse_than_none(tmp_path, case):
    """Orders, delays of whole samples, sensor noise (of the stroke), and a slew limit that the target just meets."""
    order, late, noise, limits = case
    model = order_of(order)
    slew = 4e4
    parts = [effect("slew_limit", inverse=1 / slew)] * limits + [effect("delay", time=late * DT)] * bool(late)
    domain = replace(model.domain, noise=noise * STROKE)
    model = replace(model, hold="zoh", effects=tuple(parts), domain=domain)
    made, drawn = export(model, tmp_path), np.random.default_rng(3)
    count = 4000
    rows = [0.6 * STROKE * np.sin(np.pi * 3.0 * np.arange(count + 20) * DT) ** 4]
    for _ in range(order):
        rows.append(np.gradient(rows[-1], DT))
    target = np.stack(rows, 1)
    ahead, wanted = target[late : late + count], target[:count, 0]

    def errors(weaker):
        found = []
        for open_loop in (True, False):
            plant = held_plant(model, weaker, slew if limits else np.inf, late)
            told = noise * STROKE * drawn.standard_normal(count)
            if open_loop:
                u = made.command(0, ahead)[0]
                y = np.array([plant(k, v) for k, v in enumerate(u)])
            else:
                y, u, _ = made.loop(plant, ahead, seen=lambda k, y, told=told: y + told[k])
                y = np.append(y[1:], plant(count, u[-1]))
            found.append(100 * np.sqrt(np.mean((y[count // 2 :] - wanted[count // 2 :]) ** 2)) / STROKE)
        return found

    without, with_loop = errors(1.0)
    # at the slew limit the decoder's samples are not the amplifier's ramp: the expectation is 0.1 % of the stroke off,
    # and the loop adds up to a seventh of that
    assert with_loop <= 1.001 * without + (0.015 if limits else 0.001)
    without, with_loop = errors(0.85)
    assert with_loop < 0.9 * without


def order_of(order):
    """1 mm at 3000 V: a lag of 50 ms, the resonance, or the resonance behind a lag."""
    if order > 1:
        return actuator(order, zeta=0.3)
    stiffness = TOP**2 / STROKE
    known = Domain(dt=DT, voltage_range=(0.0, TOP), slew=1e6)
    return linear_model([stiffness, 0.05 * stiffness], input_map=SquareInput(), domain=known, force_scale=TOP**2)


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("part", [pytest.param(k, marks=() if "plays of" in k else pytest.mark.slow) for k in NUMBERS])
def test_the_self_test_of_a_correct_export_passes_whatever_its_parts(tmp_path, part, precision):
    name, form = part.split(": ", 1)
    model = replace(actuator(zeta=0.3), effects=(lookup(name, form)(*NUMBERS[part]),))
    pitp.export_c(model, tmp_path / "c", precision=precision, time_constant=np.inf)
    said = subprocess.run(["make"], cwd=tmp_path / "c", capture_output=True, text=True)
    assert said.returncode == 0, said.stdout + said.stderr[-300:]
