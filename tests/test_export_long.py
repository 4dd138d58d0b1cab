"""Exported C at length: every effect of the catalogue over 10^5 steps, sanitizers, MISRA, instruction counts, time."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from effect_numbers import NUMBERS
from exported import FLAGS, truth
from test_export import DT, double, export, models, number  # noqa: F401  (a fixture)

import pitp_jax as pitp
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.invert import steps
from pitp_jax.method.numerics.spline_derivative import derivatives

pytestmark = [pytest.mark.exhaustive, pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")]
COUNT = 100_000
TIME = np.arange(COUNT) * DT
# impacts, sticking, thresholds: the last bit decides when they happen, so free runs part after a while
SHARP = ("end_stop", "slack", "coulomb_friction", "hysteresis", "voltage_clip", "slew_limit")


def drive():
    return 400 * np.sin(2 * np.pi * 1.3 * TIME) ** 2 * (1 + np.sin(2 * np.pi * 3.1 * TIME + 1e-3 * TIME**2))


def target():
    return 4e-4 * (1 - np.exp(-((5 * TIME) ** 3))) * (1 + 0.5 * np.sin(2 * np.pi * 2 * TIME))


@pytest.mark.parametrize("form", CATALOGUE, ids=lambda f: f.key)
def test_every_effect_is_pythons(bounded, linear, tmp_path, form):
    effect = form(*NUMBERS[form.key])
    model = replace(bounded(linear(2)), effects=(effect,))
    free = 1000 if form.name in SHARP else COUNT
    motion = derivatives(target(), DT, 2)
    (seen, _, y), (known, _, out) = (
        truth(steps.predict(double(model), DT), drive()),
        truth(steps.inverse(double(model), DT), motion),
    )
    span, force = np.ptp(y), out[:, 0] ** 2
    for precision, step_bound, run_bound in (("double", 1e-12, 1e-9), ("single", 2e-6, 1e-4)):
        (tmp_path / precision).mkdir()
        found = export(model, tmp_path / precision, precision)
        assert np.abs(found.follow(False, seen, drive())[1] - y).max() < step_bound * span
        assert np.abs(found.predict(drive())[:free] - y[:free, 0]).max() < run_bound * span
        said = found.follow(True, known, motion)[1][:, 0] ** 2
        # slopes between kept samples: their rounding over dt, twice over in a second-order sensor
        lead = 20 if precision == "single" and form.port in ("IN", "OUT") else 1
        assert np.abs(said - force).max() < lead * step_bound * force.max()


@pytest.mark.parametrize("kind", ["trained", "effects", "looped"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_sanitizers_are_silent(models, tmp_path, kind, precision):  # noqa: F811
    """10^6 random steps within twice the limits, with what is no number among them."""
    model = models(kind)
    export(model, tmp_path, precision)
    (tmp_path / "c" / "random.c").write_text(RANDOM)
    checks = "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -O1 -g".split()
    run = ["gcc", "-std=c99", *checks, "-o", "random", "random.c", "pitp_model.c", "-lm"]
    subprocess.run(run, cwd=tmp_path / "c", check=True)
    done = subprocess.run(["./random"], cwd=tmp_path / "c", capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr


RANDOM = """
#include <math.h>
#include <stdlib.h>
#include "pitp_model.h"
static pitp_model_real any(double low, double high)
{
    if (rand() % 1000 == 0) { return (pitp_model_real)(rand() % 2 ? NAN : INFINITY); }
    return (pitp_model_real)(low + (high - low) * rand() / RAND_MAX);
}
int main(void)
{
    pitp_model_state s;
    pitp_model_init(&s, 0, 0);
    for (int k = 0; k < 1000000; k++) {
        pitp_model_real y[PITP_MODEL_TOKENS];
        uint32_t flags = 0;
        double size = 2e-3;
        for (unsigned i = 0; i < PITP_MODEL_TOKENS; i++) { y[i] = any(-size, size); size *= 60; }
        const pitp_model_real x = pitp_model_predict_step(&s, any(-4000, 4000));
        const int way = rand() % 4;
        pitp_model_real u = way == 0 ? pitp_model_inverse_step(&s, y, &flags)
            : way == 1 ? pitp_model_inverse_target_step(&s, &y[0], &flags)
            : way == 2 ? pitp_model_pi_step(&s, y, x, &flags) : pitp_model_inverse_step(&s, NULL, &flags);
        if (!isfinite(x) || !isfinite(u) || u > PITP_MODEL_MAX_VOLTAGE || u < PITP_MODEL_MIN_VOLTAGE) { return 1; }
    }
    return 0;
}
"""

# MISRA C:2012 deviations, with their reasons; everything else is refused
MISRA = {
    "2.5": "a header offers macros that its own source does not use",
    "8.7": "the functions of the interface are called from other files",
    "15.5": "an early return says what a missing target leads to",
}


@pytest.mark.skipif(not shutil.which("cppcheck"), reason="no cppcheck")
@pytest.mark.parametrize("kind", ["trained", "effects", "looped"])
def test_misra(models, tmp_path, kind):  # noqa: F811
    export(models(kind), tmp_path)
    (tmp_path / "c" / "harness.c").unlink()
    command = ["cppcheck", "--addon=misra", "--std=c99", "--enable=style", "pitp_model.c"]
    said = subprocess.run(command, cwd=tmp_path / "c", capture_output=True, text=True).stderr
    assert set(re.findall(r"misra-c2012-([0-9.]+)", said)) <= set(MISRA), said


@pytest.mark.parametrize("way", ["predict", "inverse"])
@pytest.mark.skipif(not shutil.which("valgrind"), reason="no valgrind")
def test_the_worst_input_takes_little_longer(models, tmp_path, way):  # noqa: F811
    """Instructions of the most expensive of 500 random steps, limits and stops included, over the median."""
    export(models("effects"), tmp_path)
    (tmp_path / "c" / "count.c").write_text(BLOCKS.replace("WAY", "0" if way == "predict" else "1"))
    subprocess.run(["gcc", "-std=gnu99", "-O2", "-o", "count", "count.c", "-lm"], cwd=tmp_path / "c", check=True)
    tool = [
        "valgrind",
        "--tool=callgrind",
        "--dump-instr=no",
        "--callgrind-out-file=out",
        "--dump-before=mark",
        "./count",
    ]
    done = subprocess.run(tool, cwd=tmp_path / "c", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    counts = [int(re.findall(r"^summary: (\d+)", p.read_text(), re.M)[0]) for p in (tmp_path / "c").glob("out.*")]
    alone = sorted(c for c in counts if c > 2 * min(counts))[:-1]  # what made the numbers is less, the start more
    assert len(alone) > 400
    assert max(alone) < 1.5 * np.median(alone)


BLOCKS = """
#include "pitp_model.c"
#include <stdlib.h>
static double any(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }
__attribute__((noinline)) void mark(void) { __asm__ volatile(""); }
int main(void)
{
    static pitp_model_state s;
    static double in[1][3];
    pitp_model_init(&s, 0, 0);
    for (int block = 0; block < 500; block++) {
        double size = any(0, 2e-3), volts = any(0, 4000);
        for (int k = 0; k < 1; k++) {
            in[k][0] = WAY ? any(-size, size) : any(0, volts);
            in[k][1] = any(-30 * size, 30 * size);
            in[k][2] = any(-1000 * size, 1000 * size);
        }
        mark();
        uint32_t flags;
        for (int k = 0; k < 1; k++) {
            if (WAY) { (void)pitp_model_inverse_step(&s, in[k], &flags); }
            else { (void)pitp_model_predict_step(&s, in[k][0]); }
        }
        mark();
    }
    return 0;
}
"""


@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_step_takes_microseconds(models, tmp_path, precision):  # noqa: F811
    """Predict at most 1 us, inverse at most 2 us: the best of ten thousand, on whatever machine this is."""
    export(models("trained"), tmp_path, precision)
    (tmp_path / "c" / "time.c").write_text(CLOCK)
    subprocess.run(["gcc", "-std=gnu99", "-O2", "-o", "time", "time.c", "-lm"], cwd=tmp_path / "c", check=True)
    said = subprocess.run(["./time"], cwd=tmp_path / "c", capture_output=True, text=True, check=True).stdout
    predict, inverse = map(float, said.split())
    assert predict < 1e-6 and inverse < 2e-6


CLOCK = """
#include "pitp_model.c"
#include <stdio.h>
#include <time.h>
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}
int main(void)
{
    pitp_model_state s;
    double best[2] = {1, 1};
    volatile real sum = 0;
    pitp_model_init(&s, 0, 0);
    for (int r = 0; r < 20; r++) {
        double start = now();
        for (int k = 0; k < 10000; k++) { sum += pitp_model_predict_step(&s, (real)(k % 97) * 10); }
        double half = now();
        for (int k = 0; k < 10000; k++) {
            const real y[3] = {(real)1e-6 * (real)(k % 89), (real)1e-3, (real)0.1};
            uint32_t flags;
            sum += pitp_model_inverse_step(&s, y, &flags);
        }
        const double took[2] = {(half - start) / 1e4, (now() - half) / 1e4};
        for (int w = 0; w < 2; w++) { best[w] = took[w] < best[w] ? took[w] : best[w]; }
    }
    printf("%g %g", best[0], best[1]);
    return 0;
}
"""


@pytest.mark.skipif(not shutil.which("arm-none-eabi-gcc"), reason="no cross compiler")
def test_a_cortex_m4_takes_it(models, tmp_path):  # noqa: F811
    """It compiles for one, single precision, without warnings, and fits: under 64 KiB of flash."""
    export(models("trained"), tmp_path, "single")
    chip = "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -O2".split()
    subprocess.run(["arm-none-eabi-gcc", *chip, *FLAGS, "-c", "pitp_model.c"], cwd=tmp_path / "c", check=True)
    said = subprocess.run(["arm-none-eabi-size", "pitp_model.o"], cwd=tmp_path / "c", capture_output=True, text=True)
    assert int(said.stdout.splitlines()[1].split()[0]) < 65536
    called = subprocess.run(
        ["arm-none-eabi-nm", "-u", "pitp_model.o"], cwd=tmp_path / "c", capture_output=True, text=True
    )
    assert "__aeabi_d" not in called.stdout  # nothing in double precision


ARDUINO = """
#include <stddef.h>
#include <stdint.h>
struct IntervalTimer { template <typename F, typename T> void begin(F, T) {} };
struct Line { void begin(long) {} int available() { return 0; } size_t readBytes(char *, size_t) { return 0; } };
static Line Serial;
enum { A14 = 14 };
static inline void analogWrite(int, int) {}
static inline void analogWriteResolution(int) {}
"""


@pytest.mark.skipif(not shutil.which("arm-none-eabi-g++"), reason="no cross compiler")
def test_the_sketch_compiles(models, tmp_path):  # noqa: F811
    """Beside the few names of Arduino that it uses."""
    pitp.export_c(models("linear"), tmp_path / "out", precision="single")
    (tmp_path / "out" / "Arduino.h").write_text(ARDUINO)
    chip = "-mcpu=cortex-m4 -mthumb -ffreestanding -fno-exceptions -I. -x c++ -Wall -Wextra -Werror".split()
    command = ["arm-none-eabi-g++", *chip, "-c", "teensy.ino", "-o", "sketch.o"]
    subprocess.run(command, cwd=tmp_path / "out", check=True)
