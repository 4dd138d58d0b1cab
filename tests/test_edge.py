"""What a user meets, by public names and exported C alone, with plants and a harness of its own.

Nothing here knows the package from inside, so that the file can be run against any version (`--noconftest`).
"""

import ctypes
import shutil
import subprocess
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import chirp, cont2discrete, lfilter

import pitp_jax as pitp

TOP, HZ, ZETA, STROKE = 3000.0, 7.4, 0.1, 1e-3
NONE = float("nan")


def response(force, hz=HZ, zeta=ZETA, rate=1000.0, stroke=STROKE, state=None):
    """Stroke of x'' + 2 zeta w x' + w^2 x = w^2 force, force 1 at TOP, linear between samples; from rest or a state."""
    b, a = coefficients(hz, zeta, rate, stroke)
    return np.asarray(lfilter(b, a, force)) if state is None else lfilter(b, a, force, zi=state)


@cache
def coefficients(hz, zeta, rate, stroke):
    w = 2 * np.pi * hz
    sampled = cont2discrete(([w * w * stroke], [1, 2 * zeta * w, w * w]), 1 / rate, method="foh")
    return tuple(np.ravel(np.asarray(part)) for part in sampled[:2])  # pyright: ignore[reportIndexIssue]


def reading(name, voltage, rate=1000.0, polarity=1.0, offset=0.0, noise=0.0, **plant):
    x = np.asarray(response((voltage / TOP) ** 2, rate=rate, **plant))
    y = offset + polarity * x + noise * np.random.default_rng(0).standard_normal(len(x))
    return pitp.Record(name, np.arange(len(x)) / rate, voltage, y)


def sweep(rate=1000.0, seconds=12.0, low=0.5, high=25.0, top=TOP):
    t = np.arange(int(seconds * rate)) / rate
    return top / 2 * (1 - chirp(t, low, seconds, high))


# ------------------------------------------------------------------------------------------------ exported C

HARNESS = """
#include "{id}.h"
#include <stddef.h>
static {id}_state s;
void begin({real} y0) {{ {id}_init(&s, y0, 0); }}
double respond({real} u) {{ return (double){id}_predict_step(&s, u); }}
double follow({real} y) {{ unsigned f; return (double){id}_inverse_target_step(&s, y == y ? &y : NULL, &f); }}
double trim(const {real} *y, {real} x) {{ unsigned f; return (double){id}_pi_step(&s, y, x, &f); }}
unsigned ahead(void) {{ return {UP}_LOOK_AHEAD; }}
"""


@pytest.fixture
def exported(tmp_path):
    """fn(model, precision) -> (begin, follow, trim, respond, look-ahead) of the exported C."""
    if not shutil.which("gcc"):
        pytest.skip("no C compiler")

    def make(model, precision="double"):
        folder, real = tmp_path / precision, {"single": "float", "double": "double"}[precision]
        pitp.export_c(model, folder, precision=precision)
        name = next(folder.glob("pitp_*.h")).stem
        text = HARNESS.format(id=name, UP=name.upper(), real=real)
        (folder / "harness.c").write_text(text.replace("unsigned f;", "uint32_t f;"))
        library = folder / "harness.so"
        sources = ["harness.c", f"{name}.c"]
        subprocess.run(
            ["gcc", "-O2", "-std=c99", "-shared", "-fPIC", "-o", library, *sources, "-lm"], cwd=folder, check=True
        )
        c, kind = ctypes.CDLL(str(library)), ctypes.c_float if real == "float" else ctypes.c_double
        c.begin.argtypes, c.begin.restype = [kind], None
        for one in (c.follow, c.respond):
            one.argtypes, one.restype = [kind], ctypes.c_double
        c.trim.argtypes, c.trim.restype = [ctypes.POINTER(kind), kind], ctypes.c_double

        def trim(target, measured):
            return c.trim((kind * 3)(*target), measured)

        return c.begin, c.follow, trim, c.respond, int(c.ahead())

    return make


def nominal(**sensor):
    return pitp.identify([reading("sweep", sweep(), **sensor)], order=2, hold="foh").model


@pytest.mark.parametrize("polarity", [1.0, -1.0])
def test_the_exported_pi_takes_an_error_off_whichever_way_the_sensor_reads(exported, polarity):
    """A plant 5 % weak, 0.4 mm held: the feedforward alone is 20 um short; after 6 s less than 12 um are left."""
    begin, _, trim, *_ = exported(nominal(polarity=polarity, offset=5e-3))
    begin(5e-3)
    state, u, x = np.zeros(2), 0.0, 0.0
    for _ in range(6000):
        u = trim((4e-4, 0.0, 0.0), 5e-3 + polarity * x)
        (x,), state = response([0.95 * (u / TOP) ** 2], state=state)
    assert abs(x - 4e-4) < 12e-6


@pytest.mark.slow
def test_the_exported_pi_leaves_a_limit_by_itself(exported):
    """20 % weak: trimmed at 0.6 mm, then at the limit; 15 % strong from 20 s on: within half of that error by 35 s."""
    begin, _, trim, *_ = exported(nominal())
    begin(0.0)
    state, x, seen = np.zeros(2), 0.0, []
    for k in range(35_000):
        goal = 0.6e-3 * min(k / 2000, 1.0) + 0.35e-3 * np.clip((k - 12_000) / 2000, 0.0, 1.0)
        u = trim((goal, 0.0, 0.0), x)
        (x,), state = response([(0.8 if k < 20_000 else 1.15) * (u / TOP) ** 2], state=state)
        seen.append(u)
    assert seen[19_999] == pytest.approx(TOP, rel=1e-3)
    assert abs(x - 0.95e-3) < 0.1e-3 and seen[-1] < 0.95 * TOP


def test_pi_trim_leaves_a_limit_by_itself():
    """x' = 0.9 x + 2e-7 u, 20 % weak, at the limit for 3 s, then 15 % strong: on the target 2 s later."""
    with jax.enable_x64(True):

        def plant(state, now, later):
            x, k = state
            x = 0.9 * x + 2e-7 * jnp.where(k < 5000, 0.8, 1.15) * now
            return (x, k + 1), x

        start, early = (jnp.zeros(()), jnp.zeros((), int)), jnp.arange(7000) < 2000
        u, goal = jnp.where(early, 500.0, 900.0), jnp.where(early, 1e-3, 1.8e-3)
        x, played = map(np.asarray, pitp.pi_trim(plant, start, u, goal, 1e-3, p=2e4, i=2e6, limits=(0.0, 1000.0)))
    assert played[4999] == 1000.0
    assert abs(x[-1] - 1.8e-3) < 0.02 * 1.8e-3


def cosine(k, ahead, rate, stroke, offset):
    return offset + stroke / 2 * (1 - np.cos(2 * np.pi * 4.0 * (k + ahead) / rate))


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "stroke"), [(5e-2, 20e-6), (0.0, 1e-3)])
def test_a_target_is_differentiated_in_single_precision_to_half_a_percent_of_force(exported, offset, stroke):
    """A 4 Hz cosine at 20 kHz through the exported inverse, float beside double, 50 mm off or not."""
    rate = 20_000.0
    model = nominal(rate=rate, offset=offset, stroke=stroke, noise=0.0)
    volts = []
    for precision in ("single", "double"):
        begin, follow, _, _, ahead = exported(model, precision)
        begin(offset)
        target = cosine(np.arange(8000), ahead, rate, stroke, 0.0)
        volts.append(np.array([follow(y) for y in target]))
    force = np.stack(volts)[:, 2000:] ** 2
    assert np.abs(force[0] - force[1]).max() < 0.005 * force[1].max()


def test_one_sample_of_a_target_that_is_lost_moves_no_voltage(exported):
    """4 Hz at 1 kHz between 1500 and 1870 V, one sample lost: within 2 V of what it is with it."""
    begin, follow, *_ = exported(nominal())
    target = 0.25e-3 + 0.05e-3 * (1 - np.cos(8 * np.pi * np.arange(1200) / 1000))
    volts = []
    for lost in (False, True):
        begin(0.25e-3)
        volts.append([follow(NONE if lost and k == 530 else y) for k, y in enumerate(target)])
    whole, kept = np.array(volts)[:, 400:]
    assert np.abs(kept - whole).max() < 2.0 < 100 < np.ptp(whole)


def test_the_check_of_an_export_fails_with_a_wrong_inverse_of_a_reversed_sensor(tmp_path):
    if not shutil.which("gcc"):
        pytest.skip("no C compiler")
    pitp.export_c(nominal(polarity=-1.0, offset=5e-3), tmp_path / "c")
    source = tmp_path / "c" / "pitp_model.c"
    assert subprocess.run(["make"], cwd=tmp_path / "c", capture_output=True).returncode == 0
    head, core = source.read_text().split("static void inverse_core")
    end = core.index("\n}\n")
    source.write_text(head + "static void inverse_core" + core[:end] + "\n    out[0] *= (real)0.9;" + core[end:])
    assert subprocess.run(["make"], cwd=tmp_path / "c", capture_output=True).returncode != 0


# ------------------------------------------------------------------------------------------------ beginnings


def test_a_record_cut_at_a_turning_point_is_in_motion():
    """A sweep begun at 0 V while the actuator stands at its farthest, without a speed: it was called at rest."""
    rate, t = 500.0, np.arange(700) / 500.0
    before = TOP / 2 * (1 - np.cos(2 * np.pi * (3.0 * (t - t[-1]) + 0.5)))
    whole = reading("sweep", np.concatenate([before, sweep(rate, 8.0)]), rate, noise=3e-6)
    cut = pitp.Record("sweep", whole.time[700:], whole.voltage[700:], whole.displacement[700:])
    found = pitp.identify([cut], order=2, hold="foh")
    assert found.beginnings["sweep"].begins == "moving"
    assert found.model.physical_coefficients[0] == pytest.approx(TOP**2 / STROKE, rel=0.01)


def test_a_changed_number_is_as_sure_as_the_noise_lets_it_be():
    """A tenth softer, white noise, a plant that the model is right about: known to half a percent (0.63 % once)."""
    rate, noise = 500.0, 6e-6
    model = pitp.identify([reading("sweep", sweep(rate, 8.0), rate, noise=noise)], order=2, hold="foh").model
    softer = {"hz": HZ * 0.9**0.5, "zeta": ZETA / 0.9**0.5, "stroke": STROKE / 0.9}
    told = pitp.adapt(model, reading("later", sweep(rate, 8.0), rate, noise=noise, **softer)).changed["stiffness"]
    assert told.ci95[0] < 0.9 < told.ci95[1] < told.ci95[0] + 0.005


# ------------------------------------------------------------------------------------------------ proposals


@pytest.mark.parametrize(
    "hz", [1.4, pytest.param(3.1, marks=pytest.mark.slow), pytest.param(8.3, marks=pytest.mark.slow)]
)
def test_what_a_plan_lets_follow_keeps_the_stroke_at_a_damping_of_a_hundredth(hz):
    """Strokes so far just below what a recording asks for: it goes no farther than the limit."""
    plan = pitp.plan(max_voltage=3000.0, max_slew=1e5, band=(0.5, 10.0), duration=60.0, max_displacement=1e-3)
    rate = 1 / plan.recordings[0].time[1]
    reached = [np.abs(response((r.voltage / TOP) ** 2, hz, 0.01, rate)).max() for r in plan.recordings]
    for k in range(1, len(reached)):
        assert plan.recordings[k].go_on / max(reached[:k]) * reached[k] <= 1e-3 * 1.05


# ------------------------------------------------------------------------------------------------ the decoder's step


@pytest.fixture(scope="module")
def ringing():
    """Model and record of damping 1e-4, 20 samples a period, 1,000 periods swept; its exact response, input in V."""
    rate, hz = 200.0, 10.0
    u = sweep(rate, 100.0, 0.5, 20.0)
    record = pitp.Record("ringing", np.arange(len(u)) / rate, u, np.asarray(response(u / TOP, hz, 1e-4, rate)))
    model = pitp.identify([record], order=2, hold="foh", input_map="linear").model
    sampled = cont2discrete(([1.0], model.physical_coefficients[::-1]), 1 / rate, method="foh")
    b, a = (np.ravel(np.asarray(part)) for part in sampled[:2])  # pyright: ignore[reportIndexIssue]
    return model, record, np.asarray(lfilter(b, a, u))


def test_a_prediction_is_the_exact_discretisation_to_two_parts_in_ten_thousand(ringing):
    model, record, exact = ringing
    run = pitp.predict(model, [record])[0].displacement
    assert np.abs(run - exact).max() < 2e-4 * np.ptp(exact)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_so_is_an_exported_one(ringing, exported, precision):
    model, record, exact = ringing
    begin, _, _, respond, _ = exported(model, precision)
    begin(0.0)
    run = [respond(u) for u in record.voltage]
    assert np.abs(run - exact).max() < 2e-4 * np.ptp(exact)
