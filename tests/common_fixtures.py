"""Shapes and types of pitp_jax are checked while its tests run; models and data that several files use."""

import pkgutil
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import typecheck
from beartype.claw import beartype_packages
from jaxtyping import install_import_hook

_SHAPED, _PLAIN = typecheck.modules("pitp_jax")
beartype_packages(_PLAIN, conf=typecheck.CONF)
jaxtyping.jaxtyped = typecheck.remembering  # for good: inner functions are decorated whenever the outer one runs
with install_import_hook(_SHAPED, "typecheck.check"):
    import diagnosis_cases
    import equinox as eqx

    import pitp_jax
    from pitp_jax.method.model.domain import Domain
    from pitp_jax.method.model.encoder import CompactEncoder
    from pitp_jax.method.model.input_map import SquareInput
    from pitp_jax.method.model.memory import FadingMemory, RingingMemory
    from pitp_jax.method.model.model import Hold, Output, linear_model
    from pitp_jax.method.simulate.compiled import kernel, objects

    for _module in pkgutil.walk_packages(pitp_jax.__path__, "pitp_jax."):
        if not _module.name.endswith("__main__"):
            import_module(_module.name)


_AS_USERS = {"machine": objects.machine, "optimised": objects.optimised}


def compile_quickly():
    """Compile the machine code of free runs without most of LLVM's optimisations, in a third of the time."""

    @lru_cache(1)
    def machine():
        llvm, _, known = _AS_USERS["machine"]()
        processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        target = llvm.Target.from_default_triple().create_target_machine(
            cpu=processor, features=features, opt=1, reloc="static", codemodel="large", jit=True
        )
        return llvm, target, f"{known}, quickly"  # its object files are others

    def optimised(llvm, target, text):
        module = llvm.parse_assembly(text)
        module.verify()
        return module

    objects.machine, objects.optimised = machine, optimised


@pytest.fixture(scope="module")
def code_of_users():
    """Machine code with all of LLVM's optimisations, in the default suite as well."""
    with pytest.MonkeyPatch.context() as patch:
        for name, function in _AS_USERS.items():
            patch.setattr(objects, name, function)
        kernel._built.cache_clear()
        yield
    kernel._built.cache_clear()


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with the project's data, beside the repository."""
    folder = Path(__file__).resolve().parents[1].parent / "shared"
    if not folder.is_dir():
        pytest.skip("no shared/ beside the repository")
    return folder


@pytest.fixture(scope="session")
def double():
    """fn(pytree): its inexact arrays in float64 (call it under `jax.enable_x64(True)`)."""

    def cast(tree):
        return jax.tree.map(lambda a: jnp.asarray(np.asarray(a, np.float64)) if eqx.is_inexact_array(a) else a, tree)

    return cast


@pytest.fixture(scope="session")
def coefficients():
    """fn(order, hz, damping, stiffness): a_0 ... a_n of pole pairs at hz, 3 hz, ..., the odd real pole at hz / 2."""

    def make(order=2, hz=5.0, damping=0.1, stiffness=1e9):
        omega, poly = 2 * np.pi * hz, np.ones(1)
        for k in range(order // 2):
            w = omega * 3.0**k
            poly = np.convolve(poly, [1.0, 2 * damping / w, 1 / w**2])
        if order % 2:
            poly = np.convolve(poly, [1.0, 2 / omega])
        return stiffness * poly

    return make


@pytest.fixture(scope="session")
def linear(coefficients):
    """fn(order, hz, damping, ...): the linear model with those poles; scaled coefficients of order one.

    They are rounded to float32 first: the model in float64 is the same, and so are its sections.
    """

    def make(order=2, hz=5.0, damping=0.1, *, dt=1e-3, hold: Hold = "foh", substeps=1, input_map=None, **output):
        scale = 1e-3 * (2 * np.pi * hz) ** np.arange(order + 1)
        a = (coefficients(order, hz, damping) * scale / 1e6).astype(np.float32).astype(np.float64) * 1e6 / scale
        return linear_model(
            a, input_map=input_map or SquareInput(), state_scale=scale, force_scale=1e6, output=Output(**output),
            hold=hold, substeps=substeps, domain=Domain(dt),
        )  # fmt: skip

    return make


def _without_drag(encoder):
    """Damping weights and products of an encoder, those of x^(n-1) zero."""
    last, (rows, columns) = encoder.order - 1, np.triu_indices(encoder.order)
    blind = np.concatenate([np.arange(encoder.order) == last, (rows == last) | (columns == last)])
    weight = encoder.damping.hidden.weight.at[:, last].set(0.0)
    return weight, jnp.where(blind, 0.0, encoder.damping_poly)


@pytest.fixture(scope="session")
def shake():
    """fn(encoder, size, seed): its weights moved by about `size`, layer by layer; constants stay."""

    def moved(encoder, size, seed):
        rng = np.random.default_rng(seed)

        def push(a):
            pushed = size * rng.standard_normal(a.shape) / np.sqrt(max(a.shape[-1], 1))
            return jnp.asarray(np.asarray(a) + pushed.astype(a.dtype))  # by NumPy: nothing to compile

        return jax.tree.map(lambda a: push(a) if eqx.is_inexact_array(a) else a, encoder)

    return moved


@pytest.fixture(scope="session")
def nonlinear(linear, shake):
    """fn(order, key, size, ...): `linear` with a random CompactEncoder (logits of about `size`) and fading memories.

    Without `drag` no token depends on the highest derivative in the state, x^(n-1). With `ring` (rad/s, damping ratio)
    a second mass beside the lags; `frugal` as of `CompactEncoder`.
    """

    def make(order=2, key=0, size=0.15, tau=(0.02, 0.3), drag=True, ring=(), frugal=False, **options):
        encoder = CompactEncoder(order, len(ring) + len(tau), width=6, frugal=frugal, key=jax.random.key(key))
        shaken = shake(encoder, size, key)
        if not drag:
            shaken = eqx.tree_at(lambda e: (e.damping.hidden.weight, e.damping_poly), shaken, _without_drag(shaken))
        model = linear(order, **options)
        lags = jnp.log(jnp.asarray(tau, jnp.float32))
        omega, zeta = jnp.log(jnp.asarray(ring or (1.0, 1.0), jnp.float32))
        memory = RingingMemory(omega, zeta, lags) if ring else FadingMemory(lags)
        parts = (shaken, memory)
        return eqx.tree_at(lambda m: (m.encoder, m.memory), model, parts)

    return make


@pytest.fixture(scope="session")
def bounded():
    """fn(model, voltage range, slew, region): the model as if trained within those limits."""

    def make(model, low=0.0, high=2000.0, slew=5e4, region=()):
        return replace(model, domain=replace(model.domain, voltage_range=(low, high), slew=slew, region=region))

    return make


@pytest.fixture(scope="session")
def actuator(linear, bounded):
    """F = u^2, 5 Hz, damping 0.1, 1 mm at 1000 V; trained up to 2000 V and 50 kV/s, sampled at 1 kHz."""
    return bounded(linear(2))


@pytest.fixture
def explained(actuator):
    """A hand-made diagnosis of this verdict; the next three follow from it."""
    return diagnosis_cases.explained(actuator)


@pytest.fixture
def tied(explained):
    return diagnosis_cases.tied(explained)


@pytest.fixture
def no_gap(explained):
    return diagnosis_cases.no_gap(explained)


@pytest.fixture
def unknown(explained):
    return diagnosis_cases.unknown(explained)
