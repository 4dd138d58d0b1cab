"""The machine code of a step beside the JAX scan of the same step: operations, functions, loops, widths, the cache."""

import ctypes
import mmap
import os
import sys
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pitp_jax.method.model.own_encoder import OwnEncoder
from pitp_jax.method.simulate.compiled import kernel as kernels
from pitp_jax.method.simulate.compiled import objects
from pitp_jax.method.simulate.compiled.kernel import Kernel, kernel
from pitp_jax.method.simulate.compiled.split import split
from pitp_jax.method.simulate.compiled.vectors import text_of
from pitp_jax.method.simulate.decoder import rest_state
from pitp_jax.method.simulate.free_runs import free_runs, scanned_runs
from pitp_jax.method.simulate.model_runs import model_runs

pytestmark = pytest.mark.usefixtures("code_of_users")

RNG = np.random.default_rng(5)
RUNS, STEPS = 11, 40
P, S, U = RNG.uniform(0.2, 0.9, (RUNS, 6)), RNG.normal(0, 0.6, (RUNS, 3)), RNG.normal(0, 1.5, (2, STEPS))
COLUMN = np.arange(RUNS) % 2


def both(step, parameters=P, start=S, inputs=U):
    """Outputs by machine code and by the scan."""
    made = kernel(step, parameters, start, inputs)
    assert made is not None
    return made(parameters, start, inputs, COLUMN), scanned_runs(step, parameters, start, inputs, COLUMN)


def lagging(function):
    """A step whose first state follows a function of parameters, states and input, and whose output is the function."""

    def step(p, s, u):
        y = jnp.asarray(function(p, s, u), float)
        return jnp.append(s[1:], 0.5 * s[0] + 0.1 * jnp.tanh(y.sum())), y

    return step


def scanned(p, s, u):
    """A loop too long to write out, over rows, with a flag that is carried."""
    rows = jnp.arange(60.0)[:, None] * p[:2]

    def body(carry, row):
        x, flag = carry
        return (jnp.where(flag, 0.9 * x + 0.01 * jnp.sin(row[0] + u), 0.8 * x + row[1] * 1e-3), x > 0.1), None

    def much(carry, row):
        carry, _ = body(carry, row)
        x, flag = carry
        for k in range(30):
            x = x + 1e-3 * jnp.cos(x + k)
        return (x, flag), None

    return jax.lax.scan(much, (s[0], s[1] > 0), rows)[0][0]


TABLE = RNG.normal(size=(50, 40)) / 7
OPERATIONS = {
    "arithmetic": lambda p, s, u: (p[0] * u - s[0]) / (p[1] + s[1] ** 2) + -s[2],
    "powers": lambda p, s, u: s[0] ** 3 + p[0] ** -2 + jnp.abs(u) ** p[1] + jnp.square(s[1]),
    "roots": lambda p, s, u: jnp.sqrt(jnp.abs(u)) + jax.lax.rsqrt(p[0] + s[0] ** 2),
    "exponentials": lambda p, s, u: jnp.exp(-3 * u) + jnp.expm1(s[0] * 1e-3) + jax.nn.sigmoid(u) + jnp.log(p[0]),
    "logarithms": lambda p, s, u: jnp.log1p(jnp.abs(s[0])) + jnp.arctanh(0.9 * jnp.tanh(u)),
    "circles": lambda p, s, u: jnp.sin(40 * u) + jnp.cos(2 * s[0]) + jnp.tanh(u),
    "steps": lambda p, s, u: jnp.floor(3 * u) + jnp.ceil(2 * s[0]) + jnp.sign(u) + jnp.fmod(3 * u, p[0]),
    "limits": lambda p, s, u: jnp.clip(u, -p[0], p[1]) + jnp.maximum(s[0], u) + jnp.minimum(s[1], 0.1),
    "choices": lambda p, s, u: jnp.where((u > 0) & ~(s[0] < 0.1) | (s[1] >= p[0]) ^ (u <= -1), s[2], u),
    "equalities": lambda p, s, u: jnp.where((u == s[0]) | ((u > 0) != (s[0] > 0)), 1.0, jnp.isfinite(u) * 2.0),
    "branches": lambda p, s, u: jax.lax.cond(u > 0, lambda a: a**2, lambda a: -a, s[0]),
    "cases": lambda p, s, u: jax.lax.select_n((u > 0).astype(int) + (s[0] > 0), s[0], s[1], s[2]),
    "sums": lambda p, s, u: p.sum() * s.max() - s.min() + (p[:3] @ s) * jnp.any(s > u) + jnp.all(s > -1),
    "moved": lambda p, s, u: jnp.flip(jnp.roll(s, 1))[1:] @ p.reshape(2, 3).T[:2, 1] + jnp.pad(s, 2)[3],
    "placed": lambda p, s, u: s.at[1].set(u).at[0].add(p[0])[jnp.array([1, 0])] @ jnp.triu(p[:4].reshape(2, 2))[0],
    "derivatives": lambda p, s, u: jax.jvp(lambda x: jnp.tanh(p[0] * x) * jnp.exp(x * u), (s[0],), (p[1],))[1],
    "two outputs": lambda p, s, u: jnp.stack([s[0] * u, p[5]]),
    "a counter": lambda p, s, u: jax.lax.fori_loop(0, 3, lambda k, x: 0.5 * x + u, s[0]),
    "a known table": lambda p, s, u: jnp.tanh(TABLE @ (s[0] * jnp.arange(40.0) / 40 + u))[:47].sum() / 10,
    "a long loop": scanned,
    "nothing": lambda p, s, u: 2.0,
}  # fmt: skip


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_equals_the_scan(name):
    compiled, scan = both(lagging(OPERATIONS[name]))
    np.testing.assert_allclose(compiled, scan, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("equal", [False, True])
def test_a_large_layer_of_parameters_is_a_loop(equal):
    """Weights that belong to each run, or to all runs: never copied into the text."""

    def step(p, s, u):
        hidden = jnp.tanh(p[:1800].reshape(45, 40) @ jnp.concatenate([s, jnp.full(37, u)]))
        after = 0.9 * s + 0.1 * jnp.stack([hidden[0], hidden[44], p[1801]])
        return after, p[:1800].reshape(40, 45)[3] @ hidden

    parameters = np.broadcast_to(RNG.normal(0, 0.2, (1 if equal else RUNS, 1802)), (RUNS, 1802))
    compiled, scan = both(step, parameters)
    np.testing.assert_allclose(compiled, scan, rtol=1e-12, atol=1e-12)
    with jax.enable_x64(True):
        assert text_of(split(step, 1802, 3, ()), 8, equal=equal).count("load") < 400


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("exp", -700, 700), ("expm1", -20, 300), ("expm1", -1e-3, 1e-3), ("tanh", -22, 22), ("tanh", -0.1, 0.1)],
)
def test_a_function_is_exact_to_three_units_in_the_last_place(name, low, high):
    x = np.concatenate([RNG.uniform(low, high, 20_000), [0.0]])
    with np.errstate(over="ignore"):
        truth = getattr(np, name)(x.astype(np.longdouble))
    y = free_runs(STEPPED[name], np.zeros((1, 1)), np.zeros((1, 1)), x[None], np.zeros(1, int))[0, :, 0]
    unit = np.spacing(np.abs(truth.astype(float)))
    assert np.abs((y - truth) / unit).max() <= 3


@pytest.mark.parametrize("name", ["sin", "cos"])
@pytest.mark.parametrize("reach", [3.0, 1e3, 1e6])
def test_an_angle_is_reduced_properly(name, reach):
    x = RNG.uniform(-reach, reach, 20_000)
    y = free_runs(STEPPED[name], np.zeros((1, 1)), np.zeros((1, 1)), x[None], np.zeros(1, int))[0, :, 0]
    assert np.abs(y - getattr(np, name)(x.astype(np.longdouble))).max() < 5e-16


STEPPED = {
    name: partial(lambda f, p, s, u: (s, f(u)), getattr(jnp, name)) for name in ("exp", "expm1", "tanh", "sin", "cos")
}


def test_functions_keep_infinities_and_nan():
    x = np.array([[np.inf, -np.inf, np.nan, 800.0, -800.0, 0.0, -0.0]])
    for name, truth in {
        "exp": [np.inf, 0, np.nan, np.inf, 0, 1, 1], "expm1": [np.inf, -1, np.nan, np.inf, -1, 0, 0],
        "tanh": [1, -1, np.nan, 1, -1, 0, 0],
    }.items():  # fmt: skip
        y = free_runs(STEPPED[name], np.zeros((1, 1)), np.zeros((1, 1)), x, np.zeros(1, int))[0, :, 0]
        np.testing.assert_array_equal(y, np.array(truth, float))


MIXED = lagging(lambda p, s, u: jnp.sin(p[0] * u) + jnp.asarray(jnp.where(s[0] > 0, jnp.exp(s[1]), s[2] / p[1])))


def parts():
    with jax.enable_x64(True):
        return split(MIXED, 6, 3, ())


def test_slopes_are_those_of_jax():
    """`jax.jvp` of the step, printed, one direction a run: the columns of `jax.jacfwd` of the whole simulation."""

    def sloped(parameters, state, u):
        (p, dp), (s, ds) = jnp.split(parameters, 2), jnp.split(state, 2)
        (after, _), (moved, slope) = jax.jvp(lambda a, b: MIXED(a, b, u), (p, s), (dp, ds))
        return jnp.concatenate([after, moved]), slope

    def simulated(p):
        return jax.lax.scan(lambda s, u: MIXED(p, s, u), jnp.asarray(S[0]), jnp.asarray(U[0]))[1]

    with jax.enable_x64(True):
        truth = jax.jacfwd(simulated)(jnp.asarray(P[0]))
    parameters = np.concatenate([np.tile(P[0], (6, 1)), np.eye(6)], 1)
    start = np.concatenate([np.tile(S[0], (6, 1)), np.zeros((6, 3))], 1)
    assert kernel(sloped, parameters, start, U) is not None
    slopes = free_runs(sloped, parameters, start, U, np.zeros(6, int))[..., 0]
    np.testing.assert_allclose(slopes.T, truth, rtol=0, atol=1e-9 * np.abs(truth).max())


def test_a_diverging_run_diverges_in_both():
    compiled, scan = both(lambda p, s, u: (s + 3 * p[:3] * (0.5 + s * s), s))
    assert not np.isfinite(scan).all(1).any()
    np.testing.assert_array_equal(np.isfinite(compiled), np.isfinite(scan))


@pytest.mark.parametrize("width", [2, 4, 8, 16])
def test_every_width_gives_the_same_answer(width):
    address = objects.address_of(text_of(parts(), width, equal=False))
    run = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 6)(address)
    y = Kernel(run, width, 1, False)(P, S, U, COLUMN)
    np.testing.assert_allclose(y, scanned_runs(MIXED, P, S, U, COLUMN), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    ("triple", "cpu"),
    [
        ("x86_64-unknown-linux-gnu", "skylake-avx512"), ("x86_64-unknown-linux-gnu", "haswell"),
        ("x86_64-unknown-linux-gnu", "x86-64"), ("aarch64-unknown-linux-gnu", "generic"),
        ("arm64-apple-darwin", "apple-m1"), ("x86_64-pc-windows-msvc", "haswell"),
    ],
)  # fmt: skip
def test_the_text_compiles_for_other_processors(triple, cpu):
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, opt=3, reloc="pic", codemodel="default")
    assert len(target.emit_object(objects.optimised(llvm, target, text_of(parts(), 8, equal=False)))) > 1000


def test_threads_do_not_change_an_answer():
    inputs = RNG.normal(size=(2, 9000))
    y = both(MIXED, inputs=inputs)[0]
    alone = [free_runs(MIXED, P[k : k + 1], S[k : k + 1], inputs, COLUMN[k : k + 1])[0] for k in range(RUNS)]
    np.testing.assert_allclose(y, alone, rtol=1e-9, atol=1e-12)


def test_a_step_without_a_scalar_form_runs_by_the_scan(capsys):
    def step(p, s, u):
        return jnp.sort(s) + 0.1 * u, jnp.sort(s)[0]

    y = free_runs(step, P, S, U, COLUMN)
    np.testing.assert_array_equal(y, scanned_runs(step, P, S, U, COLUMN))
    free_runs(step, P, S, U, COLUMN)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and "sort" in said[0]


@pytest.mark.parametrize("missing", ["variable", "llvmlite"])
def test_without_machine_code_the_scan_runs(missing, monkeypatch):
    if missing == "variable":
        monkeypatch.setenv("PITP_COMPILED", "0")
    else:
        monkeypatch.setattr(objects, "machine", lambda: (_ for _ in ()).throw(ImportError("no llvmlite")))
    kernels._say.cache_clear()
    assert kernel(MIXED, P, S, U) is None
    np.testing.assert_array_equal(free_runs(MIXED, P, S, U, COLUMN), scanned_runs(MIXED, P, S, U, COLUMN))


@pytest.fixture
def folder(tmp_path):
    before = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "steps"
    jax.config.update("jax_compilation_cache_dir", before)


def test_object_files_are_kept_by_their_text(folder):
    """A step of the same name with another body has another text; a damaged file is written anew."""

    def of(factor):
        def step(p, s, u):
            return factor * s + u, s[0]

        return step

    def answer(factor):
        return free_runs(of(factor), P, S, U, COLUMN)[0, 2, 0]

    first, second = answer(0.5), answer(0.25)
    assert first != second
    (one, two) = sorted(folder.iterdir())
    assert answer(0.5) == first and sorted(folder.iterdir()) == [one, two]
    one.write_bytes(one.read_bytes()[:-50])
    two.write_bytes(b"")
    assert (answer(0.5), answer(0.25)) == (first, second)
    assert min(f.stat().st_size for f in folder.iterdir()) > 500


def test_the_folder_stays_bounded_and_may_be_read_only(folder, monkeypatch):
    monkeypatch.setattr(objects, "_LARGEST", 3000)
    texts = [text_of(parts(), width, equal=False) for width in (2, 4, 8)]
    assert all(objects.address_of(t) for t in texts)
    assert sum(f.stat().st_size for f in folder.iterdir()) <= 3000
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(PermissionError()))
    assert objects.address_of(texts[0])


def traces(monkeypatch):
    """The steps that are traced from now on, in a process that remembers none."""
    kernels._built.cache_clear()
    kernels._split.cache_clear()
    found = []
    monkeypatch.setattr(kernels, "split", lambda step, *sizes: found.append(step) or split(step, *sizes))
    return found


def test_the_package_s_own_step_is_found_without_tracing(folder, nonlinear, monkeypatch):
    """A model of another structure and a step of another function are traced."""
    other = replace(nonlinear(2), substeps=2)
    volts, start = U * 100, S[:2, :1] * np.zeros((1, len(rest_state(nonlinear(2)))))

    def answers():
        seen = traces(monkeypatch)
        return [model_runs(m, volts, 1e-3, start)[0] for m in (nonlinear(2), other)], len(seen)

    (first, traced), (again, anew) = answers(), answers()
    assert (traced, anew) == (2, 0)
    np.testing.assert_array_equal(first, again)
    (name, *_) = folder.glob("*.name")
    name.write_bytes(name.read_bytes()[:-4])
    (again, anew) = answers()
    assert anew == 1
    np.testing.assert_array_equal(first, again)


def test_a_user_s_encoder_of_the_same_name_is_traced(folder, linear, monkeypatch):
    def model(factor):
        class Mine(eqx.Module):
            weights: jax.Array

            def __call__(self, features):
                return factor * self.weights @ features

        Mine.__qualname__ = "Mine"
        return replace(linear(2), encoder=OwnEncoder(Mine(jnp.full((4, 2), 0.1))))

    def answer(factor):
        here = model(factor)
        return model_runs(here, U * 300, 1e-3, np.zeros((2, 2)))[0]

    seen = traces(monkeypatch)
    first, second = answer(0.5), answer(4.0)
    assert len(seen) == 2 and np.abs(first - second).max() > 1e-3 * np.abs(first).max()
    assert not list(folder.glob("*.name"))


@pytest.mark.skipif(sys.platform != "linux", reason="maps memory as Linux does")
def test_a_step_reaches_its_constants_wherever_they_lie():
    """Free pages, gigabytes apart: LLVM ended a process after a training, because a constant was out of reach."""
    llvm, target, _ = objects.machine()
    constant = "@c = private constant [2 x double] [double 1.5, double 2.5]"
    body = "%p = getelementptr [2 x double], ptr @c, i64 0, i64 %i\n%v = load double, ptr %p\nret double %v"
    code = target.emit_object(llvm.parse_assembly(f"{constant}\ndefine double @run(i64 %i) {{\n{body}\n}}"))
    kept = []
    for _ in range(50):
        assert ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64)(objects._loaded(code))(1) == 2.5
        hole = [mmap.mmap(-1, mmap.PAGESIZE) for _ in range(3)]
        unreserved = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | 0x4000
        kept.append((mmap.mmap(-1, 1 << 33, flags=unreserved), hole))
        hole[1].close()
