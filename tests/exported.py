"""Exported C at hand: compiled into a library, stepped along arrays, beside the same steps by JAX in float64."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

FLAGS = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wvla -Werror".split()
COMPILERS = [c for c in ("gcc", "clang") if shutil.which(c)]

HARNESS = """
#include "{id}.c"
unsigned states(int which) {{ return which ? PLAN : MODEL; }}
void follow(int which, unsigned count, const real *from, const real *in, real *next, real *out)
{{
    for (unsigned k = 0u; k < count; k++) {{
        if (which) {{ inverse_core(from + k * PLAN, in + k * TOKENS, next + k * PLAN, out + 2u * k); }}
        else {{ predict_core(from + k * MODEL, in + k, next + k * MODEL, out + k); }}
    }}
}}
void predicted(real y0, real u0, unsigned count, const real *u, real *y)
{{
    {id}_state s;
    {id}_init(&s, y0, u0);
    for (unsigned k = 0u; k < count; k++) {{ y[k] = {id}_predict_step(&s, u[k]); }}
}}
void planned_(real y0, real u0, unsigned count, const real *y, real *u)
{{
    {id}_state s;
    real next[PLAN], out[2];
    {id}_init(&s, y0, u0);
    for (unsigned k = 0u; k < count; k++) {{
        inverse_core(s.plan, y + k * TOKENS, next, out);
        (void)memcpy(s.plan, next, sizeof next);
        u[k] = out[0];
    }}
}}
void commanded(int how, real y0, real u0, unsigned count, const real *y, const real *measured, real *u, uint32_t *flags)
{{
    {id}_state s;
    {id}_init(&s, y0, u0);
    for (unsigned k = 0u; k < count; k++) {{
        if (how == 0) {{ u[k] = {id}_inverse_step(&s, y + k * TOKENS, flags + k); }}
        if (how == 1) {{ u[k] = {id}_inverse_target_step(&s, y + k, flags + k); }}
        if (how == 2) {{ u[k] = {id}_pi_step(&s, y + k * TOKENS, measured[k], flags + k); }}
        if (how == 3) {{ u[k] = {id}_inverse_step(&s, isnan(y[k * TOKENS]) ? NULL : y + k * TOKENS, flags + k); }}
        if (how == 4) {{ u[k] = {id}_inverse_target_step(&s, isnan(y[k]) ? NULL : y + k, flags + k); }}
        if (how == 5) {{ u[k] = {id}_pi_target_step(&s, y + k, measured[k], flags + k); }}
    }}
}}
static {id}_state loop;
void begin(real y0, real u0, int bounded) {{ {id}_init(&loop, y0, u0); if (!bounded) {{ loop.track = ZERO; }} }}
real closed(int alive, const real *y, real measured, uint32_t *flags)
{{
    return alive ? {id}_pi_target_step(&loop, y, measured, flags) : {id}_pi_step(&loop, y, measured, flags);
}}
"""


class Exported:
    """A folder that `export_c` wrote, compiled with all warnings as errors."""

    def __init__(self, folder: Path, order: int, *, single=False, compiler="gcc", options=("-O1",)):
        self.kind = np.float32 if single else np.float64
        self.tokens = order + 1
        name = next(folder.glob("pitp_*.h")).stem
        (folder / "harness.c").write_text(HARNESS.format(id=name))
        library = folder / "harness.so"
        command = [compiler, *options, "-std=c99", "-shared", "-fPIC", "-o", library, "harness.c", "-lm"]
        subprocess.run([compiler, "-c", *FLAGS, "-o", "/dev/null", f"{name}.c"], cwd=folder, check=True)
        subprocess.run(command, cwd=folder, check=True)
        self.call = ctypes.CDLL(str(library))
        self.call.closed.restype = type(self._real(0.0))

    def _array(self, values):
        return np.ascontiguousarray(values, self.kind)

    def _real(self, value):
        return (ctypes.c_float if self.kind == np.float32 else ctypes.c_double)(value)

    @staticmethod
    def _at(array):
        return array.ctypes.data_as(ctypes.c_void_p)

    def follow(self, inverse: bool, states, inputs):
        """One step from each of these states."""
        states, inputs = self._array(states), self._array(inputs)
        after, out = np.empty_like(states), np.empty((len(states), 2 if inverse else 1), self.kind)
        assert states.shape[1] == self.call.states(int(inverse))
        self.call.follow(int(inverse), len(states), *map(self._at, (states, inputs, after, out)))
        return after, out

    def predict(self, u, y0=0.0, u0=0.0):
        """A free run."""
        u = self._array(u)
        y = np.empty_like(u)
        self.call.predicted(self._real(y0), self._real(u0), len(u), self._at(u), self._at(y))
        return y

    def plan(self, motion, y0=0.0, u0=0.0):
        """The inverse before any limit."""
        motion = self._array(motion)
        u = np.empty(len(motion), self.kind)
        self.call.planned_(self._real(y0), self._real(u0), len(motion), self._at(motion), self._at(u))
        return u

    def command(self, how: int, target, measured=None, y0=0.0, u0=0.0):
        """Voltage and flags of inverse_step (0), inverse_target_step (1), pi_step (2), pi_target_step (5).

        3 and 4 are 0 and 1 where nan means that none came.
        """
        target = self._array(target)
        measured = self._array(np.zeros(len(target)) if measured is None else measured)
        u, flags = np.empty(len(target), self.kind), np.zeros(len(target), np.uint32)
        pointers = map(self._at, (target, measured, u, flags))
        self.call.commanded(how, self._real(y0), self._real(u0), len(target), *pointers)
        return u, flags

    def loop(self, plant, target, y0=0.0, u0=0.0, *, alive=False, bounded=True, seen=None):
        """Readings, voltages and flags of a closed loop; plant(k, u) gives the reading after sample k.

        `alive`: the target is given without derivatives; `seen`: what the controller reads of the reading.
        """
        target = self._array(target)
        y, u, flags = np.full(len(target) + 1, y0), np.empty(len(target)), np.zeros(len(target), np.uint32)
        self.call.begin(self._real(y0), self._real(u0), int(bounded))
        one = ctypes.c_uint32()
        for k, row in enumerate(target.reshape(len(target), -1)):
            reading = y[k] if seen is None else seen(k, y[k])
            u[k] = self.call.closed(int(alive), self._at(row), self._real(reading), ctypes.byref(one))
            flags[k] = one.value
            y[k + 1] = plant(k, u[k])
        return y[:-1], u, flags


def truth(step, inputs, y0=0.0, u0=0.0):
    """States before every step, flattened, and outputs, by JAX in float64."""

    def flat(carry):
        return jnp.concatenate([jnp.ravel(leaf).astype(jnp.float64) for leaf in jax.tree.leaves(carry)])

    def run(carry, row):
        after, out = step.run(carry, row)
        return after, (flat(carry), flat(after), jnp.stack([o.astype(jnp.float64) for o in out]))

    with jax.enable_x64(True):
        rows = jnp.asarray(inputs, jnp.float64).reshape(len(inputs), -1)
        start = step.start(jnp.asarray(y0, jnp.float64), jnp.asarray(u0, jnp.float64))
        return tuple(np.asarray(a) for a in jax.jit(lambda s, r: jax.lax.scan(run, s, r)[1])(start, rows))
