"""Shapes and types of pitp_jax are checked while its tests run; models and data that several files use."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import install_import_hook

with install_import_hook("pitp_jax", "beartype.beartype"):
    import equinox as eqx

    from pitp_jax import cli  # noqa: F401  (imports every verb)
    from pitp_jax._model.encoder import CompactEncoder
    from pitp_jax._model.input_map import SquareInput
    from pitp_jax._model.memory import FadingMemory
    from pitp_jax._model.model import Output, Provenance, linear_model


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
        return jax.tree.map(lambda a: a.astype(jnp.float64) if eqx.is_inexact_array(a) else a, tree)

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
    """fn(order, hz, damping, ...): the linear model with those poles; scaled coefficients of order one."""

    def make(order=2, hz=5.0, damping=0.1, *, dt=1e-3, hold="foh", substeps=1, input_map=None, **output):
        a = coefficients(order, hz, damping)
        return linear_model(
            a, input_map=input_map or SquareInput(), state_scale=1e-3 * (2 * np.pi * hz) ** np.arange(order + 1),
            force_scale=1e6, output=Output(**output), hold=hold, substeps=substeps, provenance=Provenance(dt),
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def nonlinear(linear):
    """fn(order, key, size, ...): `linear` with a random CompactEncoder (logits of about `size`) and fading memories."""

    def make(order=2, key=0, size=0.15, tau=(0.02, 0.3), **options):
        encoder = CompactEncoder(order, len(tau), width=6, depth=2, key=jax.random.key(key))
        rng = np.random.default_rng(key)
        shaken = jax.tree.map(
            lambda a: a + jnp.asarray(size * rng.standard_normal(a.shape) / np.sqrt(a.shape[-1]), a.dtype), encoder
        )
        model = linear(order, **options)
        parts = (shaken, FadingMemory(jnp.log(jnp.asarray(tau, jnp.float32))))
        return eqx.tree_at(lambda m: (m.encoder, m.memory), model, parts)

    return make
