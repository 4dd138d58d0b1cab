"""Float32 products of the package's programs have full precision, whatever the user's default."""

import re
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import pitp_jax
from pitp_jax.method.invert.equation import invert_path
from pitp_jax.method.model.programs import jit
from pitp_jax.method.simulate.decoder import rest_state, rollout_batch

PRODUCTS = ("dot_general", "conv_general_dilated")


def products(jaxpr):
    """Yield every product of a jaxpr and of those inside it."""
    for equation in jaxpr.eqns:
        if equation.primitive.name in PRODUCTS:
            yield equation
        for inner in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda p: hasattr(p, "eqns")):
            inner = getattr(inner, "jaxpr", inner)
            if hasattr(inner, "eqns"):
                yield from products(inner)


@pytest.mark.parametrize("default", [None, "tensorfloat32"])
def test_products_of_rollout_and_inverse_are_full(nonlinear, default):
    model = nonlinear(2)
    volts, states = jnp.ones((2, 8)), jnp.ones((8, 3))
    calls = [
        lambda: eqx.filter_make_jaxpr(rollout_batch)(model, volts, 1e-3, jnp.stack([rest_state(model)] * 2)),
        lambda: eqx.filter_make_jaxpr(invert_path)(model, states, 1e-3),
        lambda: eqx.filter_make_jaxpr(jit(lambda a: a @ a))(jnp.ones((3, 3))),
    ]
    with jax.default_matmul_precision(default):
        found = [e for call in calls for e in products(call()[0].jaxpr)]
    assert found
    for equation in found:
        assert set(equation.params["precision"]) == {jax.lax.Precision.HIGHEST}


def test_programs_are_compiled_in_one_place():
    """No `filter_jit` beside the one that sets the precision."""
    package = Path(pitp_jax.__file__).parent
    found = {str(p.relative_to(package)) for p in package.rglob("*.py") if re.search(r"filter_jit\b", p.read_text())}
    assert found == {"method/model/programs.py"}
