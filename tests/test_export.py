"""Exported C against the same steps in Python, those against rollouts and eq. 13; limits, files and refusals."""

import subprocess
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exported import COMPILERS, FLAGS, Exported, truth

import pitp_jax as pitp
from pitp_jax.files.export.c99 import write_sources
from pitp_jax.files.export.plan import plan, played
from pitp_jax.method.effects import effect, lookup
from pitp_jax.method.invert import steps
from pitp_jax.method.invert.equation import invert_path
from pitp_jax.method.model.coordinate import from_model
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import PaperEncoder
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.model.programs import in_double
from pitp_jax.method.numerics.spline_derivative import derivatives
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout

DT, COUNT = 1e-3, 1500
TIME = np.arange(COUNT) * DT
DRIVE = 900 * np.sin(2 * np.pi * 1.1 * TIME) ** 2 * (1 + np.sin(2 * np.pi * 3.3 * TIME)) / 2
TARGET = 4e-4 * (1 - np.exp(-((6 * TIME) ** 5))) * (1 + 0.4 * np.sin(2 * np.pi * 2 * TIME))
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")


def number(value):
    return jnp.asarray(value, jnp.float32)


EFFECTS = (
    effect("voltage_clip", inverse=1 / 600), effect("delay", time=2.3e-3), effect("electrode_rc", tau=3e-3),
    effect("end_stop", kappa=3.0, place=0.35),
    effect("creep", kappa=0.2, tau=0.5),
    effect("hysteresis", form="Bouc-Wen, either sign", kappa=0.3, width=0.1, gamma=-0.5),
    effect("coulomb_friction", level=0.01),
    effect("added_mass", d=0.1), effect("sensor_lag", tau=2e-3),
)  # fmt: skip


@pytest.fixture(scope="module")
def models(linear, nonlinear, bounded):
    """fn(kind): a model of that kind, made once."""

    def trained():
        lag = ElectrodeLag(number(np.log(4e-3)))
        return bounded(eqx.tree_at(lambda m: m.drive, nonlinear(2, offset=1e-3, polarity=-1.0), lag))

    def paper():
        encoder = PaperEncoder(4, 4, key=jax.random.key(1), width=24)
        readout = 0.05 * jnp.ones_like(encoder.networks.readout.weight)
        encoder = eqx.tree_at(lambda e: e.networks.readout.weight, encoder, readout)
        return eqx.tree_at(lambda m: (m.encoder, m.memory), linear(3, substeps=3), (encoder, ElapsedTime(2.0)))

    make = {
        "linear": lambda: bounded(linear(2)),
        "trained": trained,
        "effects": lambda: replace(trained(), effects=EFFECTS),
        "paper": paper,
        "first": lambda: linear(1, input_map=LinearInput()),
        "looped": lambda: nonlinear(2, substeps=40),
        "ringing": lambda: nonlinear(3, ring=(60.0, 0.1), frugal=True),
        "bandlimited": lambda: linear(2, hold="bandlimited"),
    }
    return cache(lambda kind: make[kind]())


def kinds(*default):
    """These, and all others where long tests run."""
    every = ("linear", "trained", "effects", "paper", "first", "looped", "ringing", "bandlimited")
    later = [pytest.param(k, marks=pytest.mark.exhaustive) for k in every if k not in default]
    return pytest.mark.parametrize("kind", [*default, *later])


@pytest.fixture(scope="module")
def truths(models):
    """fn(kind, inverse): states before and after every step and outputs, by JAX in float64."""

    @cache
    def run(kind, inverse):
        model = double(models(kind))
        step = (steps.inverse if inverse else steps.predict)(model, DT)
        return truth(step, inputs(model, inverse), 0.0)

    return run


def motion(model, x=TARGET):
    """[y, ..., y^(n)] of a motion, from 0 V."""
    return from_model(model, derivatives(x, DT, model.order))


def export(model, folder, precision="double"):
    (folder / "c").mkdir()
    write_sources(plan(model, "model", None, precision), folder / "c")
    return Exported(folder / "c", model.order, single=precision == "single")


def double(model):
    with jax.enable_x64(True):
        return in_double(model)


def inputs(model, inverse):
    return motion(model) if inverse else DRIVE


@pytest.mark.slow
@kinds("linear", "effects")
def test_a_step_is_pythons(models, truths, tmp_path, kind):
    """From the same state to 1e-12 of its range; free runs to 1e-9. The inverse in force: a root magnifies bits."""
    model = models(kind)
    found, rest = export(model, tmp_path), model.output.offset
    for inverse in (False, True):
        before, after, out = truths(kind, inverse)
        span = np.maximum(np.ptp(after, 0), 1e-30)
        assert np.ptp(out[:, 0]) > 0
        then, said = found.follow(inverse, before, inputs(model, inverse))
        assert np.abs((then - after) / span).max() < 1e-12
        power = 2 if inverse and kind != "first" else 1
        wanted = out[:, 0] ** power
        assert np.abs(said[:, 0] ** power - wanted).max() < 1e-12 * np.ptp(wanted)
        run = found.plan(motion(model), rest) if inverse else found.predict(DRIVE, rest)
        assert np.abs(run**power - wanted).max() < 1e-9 * np.ptp(wanted)


@pytest.mark.slow
@kinds("effects")
def test_single_precision(models, truths, tmp_path, kind):
    """2e-6 of range a step and 1e-4 in a free run."""
    model = models(kind)
    found, rest = export(model, tmp_path, precision="single"), model.output.offset
    before, _, out = truths(kind, False)
    _, said = found.follow(False, before, DRIVE)
    assert np.abs(said - out).max() < 2e-6 * np.ptp(out)
    assert np.abs(found.predict(DRIVE, rest) - out[:, 0]).max() < 1e-4 * np.ptp(out)


@pytest.mark.slow
@kinds("effects")
def test_predict_steps_are_the_rollout(models, truths, kind):
    model = double(models(kind))
    with jax.enable_x64(True):
        states = rollout(model, jnp.asarray(np.append(0.0, DRIVE)), DT, rest_state(model))
        whole = from_model(model, np.asarray(ports.readings(model, states)) * model.scales.state[0])
    late = steps.predict(model, DT).late
    found = truths(kind, False)[2][:, 0]
    np.testing.assert_allclose(found[late:], whole[1 : COUNT + 1 - late], rtol=0, atol=1e-12 * np.ptp(whole))


@kinds("effects", "linear")
def test_inverse_steps_are_eq_13(models, kind):
    """Up to how V' is taken (2nd order instead of 4th), and to the delay, which asks for the target ahead."""
    model = double(models(kind))
    if kind == "effects":  # those that act between x and V, and smoothly: `invert_path` begins behind the sensor
        smooth = ("creep", "added_mass", "electrode_rc", "voltage_clip")
        model = replace(model, effects=tuple(e for e in model.effects if e.name in smooth))
    with jax.enable_x64(True):
        rows = jnp.asarray(derivatives(TARGET, DT, model.order) / np.asarray(model.scales.state))
        whole = np.asarray(invert_path(model, rows, DT)[1])
    (found, _) = played(steps.inverse(model, DT), motion(model), 0.0)
    inside = slice(150, COUNT - 3)  # the root has a corner where F leaves 0
    bound = 2e-3 if kind in ("trained", "effects") else 1e-9
    np.testing.assert_allclose(found[inside] ** 2, whole[inside] ** 2, rtol=0, atol=bound * whole.max() ** 2)


@pytest.mark.parametrize("place", range(3))
def test_a_sensor_is_undone_with_its_derivatives(actuator, place):
    """The reading of a known motion and its derivatives give that motion's own."""
    sensor = (
        effect("sensor_gain", d=0.2), effect("sensor_lag", tau=5e-3),
        effect("sensor_lag", form="second order", tau=4e-3, zeta=0.7),
    )[place]  # fmt: skip
    model = double(replace(actuator, effects=(sensor,)))
    w, t = 2 * np.pi * 3, 0.4
    tau = float(getattr(sensor, "tau", 0.0))
    if place == 0:
        gain = 1.2 + 0j
    elif place == 2:
        gain = 1 / (1 + 2 * 0.7j * w * tau - (w * tau) ** 2)
    else:
        gain = 1 / (1 + 1j * w * tau)
    rows = [[((1j * w) ** i * gain * np.exp(1j * w * (t + k * DT))).real for i in range(3)] for k in (-2, -1, 0)]
    truth_ = np.array([((1j * w) ** i * np.exp(1j * w * t)).real for i in range(3)])
    with jax.enable_x64(True):
        scales = np.asarray(model.scales.state)
        found = np.asarray(steps.behind_sensor(model, jnp.asarray(np.array(rows) / scales), DT)) * scales
    np.testing.assert_allclose(found / w ** np.arange(3), truth_ / w ** np.arange(3), rtol=0, atol=3e-3)


def test_a_held_start_stays(models, tmp_path):
    """At the displacement a voltage holds nothing moves, and that voltage comes back."""
    model = models("linear")
    found, u0 = export(model, tmp_path), 700.0
    y0 = float(u0**2 / model.physical_coefficients[0])
    np.testing.assert_allclose(found.predict(np.full(50, u0), y0, u0), y0, rtol=1e-6)
    np.testing.assert_allclose(found.command(0, [[y0, 0, 0]] * 5, y0=y0, u0=u0)[0], u0, rtol=1e-6)


# ------------------------------------------------------------------------------------------------ limits

NUMBER, INFEASIBLE, VOLTAGE, SLEW, DISPLACEMENT, NO_TARGET = (1 << k for k in range(6))


@pytest.fixture(scope="module")
def rig(linear, bounded, tmp_path_factory):
    """1 mm at 1000 V, trained up to 1.2 mm; 0 to 1000 V, 50 kV/s."""
    model = bounded(linear(2), high=1000.0, slew=5e4, region=((0.0, 1.2), (-2.0, 2.0)))
    return export(model, tmp_path_factory.mktemp("rig"))


def held(y, count):
    return np.tile([y, 0.0, 0.0], (count, 1))


def test_range_and_slew_are_kept(rig):
    u, flags = rig.command(0, held(1.1e-3, 40))
    np.testing.assert_allclose(u, np.minimum(50.0 * np.arange(1, 41), 1000.0))
    assert flags[0] == VOLTAGE | SLEW and flags[-1] == VOLTAGE
    u, flags = rig.command(0, held(-1e-5, 5))
    assert (u == 0).all() and (flags == INFEASIBLE).all()


def test_displacement_is_kept(rig):
    u, flags = rig.command(0, np.tile([2e-3, 5.0, 100.0], (60, 1)))
    assert u[-1] == 1000 and flags[-1] == DISPLACEMENT | VOLTAGE
    u, flags = rig.command(0, np.tile([-2e-3, 5.0, 100.0], (60, 1)))
    assert (u == 0).all() and (flags & DISPLACEMENT).all()


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_what_is_no_number_leaves_the_last_voltage(rig, lost):
    rows = held(3e-4, 30)
    rows[20, 1] = lost
    u, flags = rig.command(0, rows)
    assert flags[20] == NUMBER | NO_TARGET and u[20] == u[19]
    without = rig.command(0, np.delete(rows, 20, 0))[0]
    np.testing.assert_array_equal(np.delete(u, 20), without)
    y = rig.predict([100.0, 200.0, lost, 300.0])
    assert y[2] == y[1]
    np.testing.assert_array_equal(np.delete(y, 2), rig.predict([100.0, 200.0, 300.0]))


def test_silence_ramps_to_zero(rig):
    """Kept for 20 ms, then 50 V a step down to 0; a target that comes again is approached within the slew."""
    rows = held(5e-4, 130)
    rows[40:110] = np.nan
    u, flags = rig.command(3, rows)
    assert (flags[40:110] == NO_TARGET).all()
    np.testing.assert_array_equal(u[40:60], u[39])
    np.testing.assert_allclose(u[60:110], np.maximum(u[39] - 50.0 * np.arange(1, 51), 0.0), atol=1e-9)
    assert flags[110] == SLEW and u[110] == 50.0 and abs(u[-1] - u[39]) < 1e-9


def test_a_target_ahead_is_differentiated(rig):
    """As with its own derivatives, twelve samples later."""
    rows = derivatives(TARGET, DT, 2)
    direct, ahead = rig.command(0, rows)[0], rig.command(1, TARGET)[0]
    np.testing.assert_allclose(ahead[112:], direct[100:-12], rtol=0, atol=1e-4 * direct.max())


@pytest.mark.slow
def test_a_delay_is_asked_for_ahead(linear, bounded, tmp_path):
    model = replace(bounded(linear(2)), effects=(effect("delay", time=3.4e-3),))
    u, _ = export(model, tmp_path).command(1, TARGET)
    (tmp_path / "plain").mkdir()
    direct, _ = export(bounded(linear(2)), tmp_path / "plain").command(1, TARGET)
    early = np.interp(np.arange(COUNT) + 3.4 - 4, np.arange(COUNT), direct)  # LOOK_AHEAD is 4 samples more
    np.testing.assert_allclose(u[100:-20], early[100:-20], rtol=0, atol=1e-4 * direct.max())


def test_pi_trims_a_softer_plant(linear, bounded, tmp_path):
    """Its force grows by I e a second; what the range cuts off leaves no more than e I T wound up."""
    model = bounded(linear(2), high=1000.0)
    found, rows, gains = export(model, tmp_path), held(4e-4, 1500), pitp.pi_gains(model)
    error = np.full(1500, 1e-5)
    u, _ = found.command(2, rows, measured=4e-4 - error, y0=4e-4, u0=np.sqrt(4e-4 * 1e9))
    np.testing.assert_allclose(np.diff(u[100:] ** 2), gains.i * 1e-5 * DT, rtol=1e-6)
    seconds = 9 * gains.time_constant
    low = np.concatenate([np.full(int(seconds / DT), 0.0), np.full(2000, 8e-4)])  # the error turns round
    u, flags = found.command(2, held(4e-4, len(low)), measured=low)
    assert flags[-2001] & VOLTAGE
    left = np.argmax(u[-2000:] < 1000.0) * DT
    wound = gains.i * 4e-4 * gains.time_constant - gains.p * 8e-4
    assert 0 < left <= wound / (gains.i * 4e-4)  # and not after the 9 time constants it stood there


# ------------------------------------------------------------------------------------------------ the folder


@pytest.mark.parametrize("precision", ["single", pytest.param("double", marks=pytest.mark.exhaustive)])
def test_the_folder_checks_itself(models, tmp_path, precision):
    pitp.export_c(models("linear"), tmp_path / "out", name="cone", precision=precision)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "Makefile", "README.md", "loop.c", "main.c", "pitp_cone.c", "pitp_cone.h", "teensy.ino",
    ]  # fmt: skip
    for compiler in COMPILERS:
        command = ["make", "-B", f"CC={compiler}", "CFLAGS=-O1"]
        made = subprocess.run(command, cwd=tmp_path / "out", capture_output=True)
        assert made.returncode == 0, made.stderr
        subprocess.run(["make", "clean"], cwd=tmp_path / "out", check=True)
    assert not [p for p in (tmp_path / "out").iterdir() if "@" in p.read_text().replace("$@", "")]


def test_a_wrong_number_fails_the_check(models, tmp_path):
    pitp.export_c(models("linear"), tmp_path / "out")
    source = tmp_path / "out" / "pitp_model.c"
    text = source.read_text()
    head, core = text.split("static void predict_core")
    place = core.index("0.0")
    source.write_text(head + "static void predict_core" + core[:place] + "0.1" + core[place + 3 :])
    assert subprocess.run(["make"], cwd=tmp_path / "out", capture_output=True).returncode != 0


def test_only_libm_is_needed(models, tmp_path):
    """And nothing is written but the state: no data that is not constant."""
    export(models("effects"), tmp_path)
    build = ["gcc", "-O0", "-fstack-usage", *FLAGS, "-c", "pitp_model.c"]
    subprocess.run(build, cwd=tmp_path / "c", check=True)
    listed = subprocess.run(["nm", "pitp_model.o"], cwd=tmp_path / "c", capture_output=True, text=True).stdout
    symbols = [line.split()[-2:] for line in listed.splitlines()]
    needed = {name for kind, name in symbols if kind == "U"}
    libm = {"sqrt", "tanh", "exp", "expm1", "log", "pow", "fabs", "memcpy", "memset", "memmove"}
    assert needed <= libm
    assert not [name for kind, name in symbols if kind in "bBdDC"]
    stack = (tmp_path / "c" / "pitp_model.su").read_text().split("\n")
    assert all(row.endswith("static") for row in stack if row)  # no alloca, no arrays of variable length


@pytest.mark.exhaustive
def test_another_rate_tells_what_it_costs(models, tmp_path):
    assert pitp.export_c(models("trained"), tmp_path / "own") is None
    fine = pitp.export_c(models("trained"), tmp_path / "fine", rate=2000.0)
    coarse = pitp.export_c(models("trained"), tmp_path / "coarse", rate=200.0)
    assert fine is not None and coarse is not None
    assert 0 < fine < coarse < 20
    assert "e_rms" in (tmp_path / "coarse" / "README.md").read_text()
    assert "PITP_MODEL_DT 0.005" in (tmp_path / "coarse" / "pitp_model.h").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"name": "3d"}, "identifier"),
        ({"name": "a b"}, "identifier"),
        ({"name": ""}, "identifier"),
        ({"rate": 0.0}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"rate": 1.0}, "rate"),
        ({"precision": "half"}, "precision"),
    ],
)
def test_bad_requests_leave_nothing(models, tmp_path, options, said):
    with pytest.raises(pitp.BadInput, match=said):
        pitp.export_c(models("linear"), tmp_path / "out", **options)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(models, tmp_path):
    (tmp_path / "out").mkdir()
    for verb in (pitp.export_c, pitp.export_fmu, pitp.export_matlab):
        with pytest.raises(pitp.BadInput, match="exists already"):
            verb(models("linear"), tmp_path / "out")
        with pytest.raises(pitp.BadInput, match="create it first"):
            verb(models("linear"), tmp_path / "no" / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_what_cannot_be_stepped_is_refused(models, tmp_path):
    """A force by a loop that ends by what it finds."""

    def law(p, now):
        return jax.lax.while_loop(lambda x: jnp.abs(x) > 1e-3, lambda x: x / 2, now.x)

    endless = replace(lookup("stiffening"), law=law)
    waiting = replace(models("linear"), effects=(endless(1.0),))
    with pytest.raises(pitp.BadInput, match="no bounded time"):
        pitp.export_c(waiting, tmp_path / "out")
    members = pitp.Ensemble((models("linear"),) * 2, 0.0)
    with pytest.raises(pitp.BadInput, match="Ensemble"):
        plan(members, "model", None, "double")
    assert list(tmp_path.iterdir()) == []
