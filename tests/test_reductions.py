"""Jitted reductions over a small fixed axis against NumPy: five releases of jaxlib return wrong sums of many rows.

`python tests/test_reductions.py` prints every reduction of the package and the form under which it is tested.
"""

import ast
import tomllib
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import pitp_jax

NAMES = ("sum", "mean", "prod", "max", "min", "median", "any", "all", "argmin")
PRODUCTS = ("matrix @ vector", "vector @ matrix", "vector @ vector", "matrix @ matrix")
OTHERS = ("tensordot",)  # the fixed matrix of every case
# the default suite compiles without most optimisations (conftest.py)
AS_USERS = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}
if Version(version("jaxlib")) < Version("0.10"):
    AS_USERS["xla_cpu_use_fusion_emitters"] = True


def search():
    """Yield (file:line, form) of every reduction in modules that compute with JAX."""
    package = Path(pitp_jax.__file__).parent
    for path in sorted(package.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "jnp." not in text:
            continue
        file = path.relative_to(package)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
                yield f"{file}:{node.lineno}", "@"
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            name = node.func.attr
            if name not in (*NAMES, *OTHERS, "einsum"):
                continue
            owner = ast.unparse(node.func.value)
            if name != "einsum" and not owner.startswith("np"):
                yield f"{file}:{node.lineno}", name
            elif owner == "jnp":
                yield f"{file}:{node.lineno}", f"einsum {ast.literal_eval(node.args[0])}"


FORMS = sorted({form for _, form in search()} - {"@", *OTHERS} | set(PRODUCTS) | set(NAMES))


def shapes_of(form, size):
    """List the shapes of one row's operands: the reduced axes and the first operand's last have this size, others 2."""
    if form.startswith("einsum"):
        inside, outside = form.split()[1].split("->")
        parts = inside.split(",")
        return [tuple(2 if k in outside and k != parts[0][-1] else size for k in part) for part in parts]
    if form in PRODUCTS:
        return [{"matrix": (size, size), "vector": (size,)}[part] for part in form.split(" @ ")]
    return [(size,)]


def reduced(form, rows):
    """Reduce one row."""
    if form.startswith("einsum"):
        return jnp.einsum(form.split()[1], *rows)
    if form in PRODUCTS:
        return rows[0] @ rows[1]
    return getattr(jnp, form)(rows[0] > 0.5 if form in ("any", "all") else rows[0], axis=0)


def in_numpy(form, rows):
    """Compute the same in NumPy for all rows at once."""
    if form.startswith("einsum"):
        inside, outside = form.split()[1].split("->")
        spec = ",".join("R" + part for part in inside.split(",")) + "->R" + outside
    elif form in PRODUCTS:
        letters = {"matrix @ vector": "Rij,Rj->Ri", "vector @ matrix": "Rj,Rji->Ri", "vector @ vector": "Rj,Rj->R"}
        spec = letters.get(form, "Rij,Rjk->Rik")
    else:
        values = rows[0] > 0.5 if form in ("any", "all") else rows[0]
        return getattr(np, form)(values, axis=1)
    return np.einsum(spec, *(r.astype(np.float64) for r in rows))


@pytest.fixture
def supported():
    """Skip where pyproject.toml excludes the release of jaxlib that is installed."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (jaxlib,) = (r for r in map(Requirement, project["dependencies"]) if r.name == "jaxlib")
    if not jaxlib.specifier.contains(version("jaxlib")):
        pytest.skip(f"pyproject.toml excludes jaxlib {version('jaxlib')}")


@pytest.mark.usefixtures("supported")
@pytest.mark.parametrize("rows", [pytest.param(20_000, marks=pytest.mark.slow), 40_000])
@pytest.mark.parametrize("form", FORMS)
def test_a_reduction_of_many_rows_is_numpys(form, rows):
    """3 and 5 elements, both precisions: alone, behind a product with a fixed matrix, and squared and summed."""
    random = np.random.default_rng(0)
    fixed = {size: random.uniform(0.5, 1.5, (size, size)) for size in (3, 5)}
    given = {size: [random.uniform(0.2, 1.2, (rows, *s)) for s in shapes_of(form, size)] for size in fixed}

    def of_row(size, row):
        turn = jnp.asarray(fixed[size], row[0].dtype)
        first = turn @ row[0] if row[0].ndim == 1 else jnp.tensordot(row[0], turn, (-1, -1))
        through = reduced(form, [first, *row[1:]])
        return reduced(form, row), through, jnp.sum(jnp.square(through), axis=None)

    with jax.enable_x64(True):
        cases = {(s, kind): [o.astype(kind) for o in given[s]] for s in fixed for kind in ("float64", "float32")}
        rows_of = jax.vmap(lambda row: {case: of_row(case[0], row[case]) for case in row})
        found = jax.jit(rows_of, compiler_options=AS_USERS)(cases)
    for (size, kind), values in found.items():
        first = given[size][0] @ fixed[size].T
        truth = [in_numpy(form, given[size]), in_numpy(form, [first, *given[size][1:]])]
        truth.append(np.square(truth[1].astype(float)).reshape(rows, -1).sum(1))
        for value, true in zip(values, truth, strict=True):
            np.testing.assert_allclose(value, true, rtol=1e-12 if kind == "float64" else 1e-5)


def test_the_search_finds_the_reductions():
    """At least the residual's own product, a matrix product of the inverse and the slopes' sum."""
    found = set(search())
    assert {form for _, form in found} >= {"@", "sum", "einsum ks,ksm->km", "tensordot"}
    assert any(place.startswith("method/effects/effect.py") for place, _ in found)


if __name__ == "__main__":
    for where, form in search():
        print(f"{where:40} {form}")
