"""Convert a JAX program to scalar expressions, with one rule for each primitive operation.

    make_jaxpr(step)(state, input)  ->  one `Program`: numbers of the model folded in, no arrays left

Primitives that only move elements are applied to an array of indices; those that compute work element by element; large
products with known weights and long loops stay loops.
"""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from ....common.errors import BadInput
from .scalars import FOLDED, Builder, Loop, Node, Program, Still

_WRITTEN_OUT = 1500  # products of one matrix, above which it is a loop
_UNROLLED = 4000  # nodes of a loop written out
_CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint")
_SAME = ("stop_gradient", "copy", "copy_p", "reduce_precision", "optimization_barrier")


def program(function: Callable, *examples, still: int = 0) -> Program:
    """Convert fn(*examples) to a scalar program; its inputs and outputs are all array elements in sequence.

    `still`: number of first inputs in memory that does not change; a large product with them becomes a loop.
    """
    closed = jax.make_jaxpr(function)(*examples)
    make, shapes = Builder(still=still), [v.aval.shape for v in closed.jaxpr.invars]
    inputs = sum(int(np.prod(s)) for s in shapes)
    outputs = _run(make, closed.jaxpr, closed.consts, _cut(make.inputs(inputs), shapes))
    return Program(inputs, tuple(v for output in outputs for v in output.ravel()))


def _cut(values: Sequence, shapes) -> list[np.ndarray]:
    """Cut a sequence of scalars into arrays of these shapes."""
    ends = np.cumsum([0, *(int(np.prod(s)) for s in shapes)])
    return [_array(values[a:b], s) for a, b, s in zip(ends, ends[1:], shapes, strict=False)]


def _array(values: Sequence, shape) -> np.ndarray:
    array = np.empty(len(values), object)  # filled afterwards, because np.array would look into the values
    array[:] = values
    return array.reshape(shape)


def _known(value) -> np.ndarray:
    """Convert an array to Python numbers, which are folded into the program."""
    value = np.asarray(value)
    return _array(value.ravel().tolist(), value.shape)


def _run(make: Builder, jaxpr: Jaxpr, consts: Sequence, args: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Evaluate a JAX program (jaxpr) on arrays of scalar expressions."""
    values: dict[Any, np.ndarray] = dict(zip(jaxpr.constvars, map(_as_array, consts), strict=True))
    values.update(zip(jaxpr.invars, args, strict=True))

    def read(v) -> np.ndarray:
        return _known(v.val) if isinstance(v, Literal) else values[v]

    for equation in jaxpr.eqns:
        outputs = _apply(make, equation, [read(v) for v in equation.invars])
        values.update(zip(equation.outvars, outputs, strict=True))
    return [read(v) for v in jaxpr.outvars]


def _as_array(value) -> np.ndarray:
    return value if isinstance(value, np.ndarray) and value.dtype == object else _known(value)


def _apply(make: Builder, equation, args: list[np.ndarray]) -> list[np.ndarray]:
    name, params = equation.primitive.name, equation.params
    if name in _CALLS:
        inner = next(params[k] for k in ("jaxpr", "call_jaxpr", "fun_jaxpr") if k in params)
        return _run(make, *_opened(inner), args)
    if name in _SPECIAL:
        return _SPECIAL[name](make, params, args, equation)
    if name in FOLDED:
        return [_each(lambda *a: make.make(name, *a), args)]
    if name in _SAME:
        return args
    return _moved(equation, args)


def _opened(jaxpr) -> tuple[Jaxpr, Sequence]:
    return (jaxpr.jaxpr, jaxpr.consts) if isinstance(jaxpr, ClosedJaxpr) else (jaxpr, ())


def _each(function: Callable, args: Sequence[np.ndarray]) -> np.ndarray:
    args = np.broadcast_arrays(*args)
    return _array([function(*a) for a in zip(*(b.ravel() for b in args), strict=True)], args[0].shape)


def _moved(equation, args: list[np.ndarray]) -> list[np.ndarray]:
    """Apply a primitive that only moves elements, by moving their indices."""
    name, params = equation.primitive.name, equation.params
    if name in ("reshape", "squeeze") and params.get("dimensions") is None or name == "squeeze":
        return [args[0].reshape(equation.outvars[0].aval.shape)]
    if name == "slice":
        ends = params["start_indices"], params["limit_indices"], params["strides"] or [1] * args[0].ndim
        return [args[0][tuple(map(slice, *ends))]]
    if name == "concatenate":
        return [np.concatenate(args, params["dimension"])]
    if name == "transpose":
        return [args[0].transpose(params["permutation"])]
    if name == "broadcast_in_dim":
        kept = dict(zip(params["broadcast_dimensions"], args[0].shape, strict=True))
        shape = params["shape"]
        return [np.broadcast_to(args[0].reshape([kept.get(k, 1) for k in range(len(shape))]), shape)]
    if name not in _MOVES:
        raise BadInput(f"a step with the operation {name} cannot be written as C; use other operations in your encoder")
    moving = _MOVES[name]
    firsts = np.cumsum([0, *(a.size for a in args[:moving])])
    # JAX itself moves the places, as numbers, so no rule of padding or gathering is written twice; it compiles a
    # program for each shape, and therefore the most frequent moves above are NumPy's
    pool = np.concatenate([a.ravel() for a in args[:moving]])
    places = [jnp.asarray(f + np.arange(a.size).reshape(a.shape)) for f, a in zip(firsts, args, strict=False)][:moving]
    still = [_number(a, equation) for a in args[moving:]]
    bound = equation.primitive.bind(*places, *still, **params)
    outputs = [np.asarray(output) for output in (bound if equation.primitive.multiple_results else [bound])]
    return [pool[o.ravel()].reshape(o.shape) for o in outputs]  # a bare pool[o] without axes would be its element


# primitives that move elements, and the number of arguments moved; the others state the places
_MOVES = {
    "rev": 1, "reshape": 1, "gather": 1, "dynamic_slice": 1, "stack": 99, "unstack": 1, "pad": 2, "split": 1,
    "expand_dims": 1,
}  # fmt: skip


def _number(array: np.ndarray, equation) -> jax.Array:
    """Convert an array of scalars to integer indices; refuse indices that are computed at run time."""
    # otherwise the step would need an array in memory and a check of its bounds
    if any(isinstance(a, Node) for a in array.ravel()):
        raise BadInput(
            f"a step whose {equation.primitive.name} reads at an index computed at run time cannot be "
            "written as C; use fixed indices in your encoder"
        )
    return jnp.asarray(np.asarray(array.tolist(), int))


def _converted(make, params, args, equation):
    kind = np.dtype(params["new_dtype"]).kind
    number = {"f": float, "b": bool}.get(kind, int)

    def convert(value):
        if isinstance(value, Node):
            if kind == "b":
                return value if value.truth else make.make("ne", value, 0.0)
            return make.make("real", value) if value.truth else value
        return number(value)

    return [_each(convert, args)]


def _power(make, params, args, equation):
    def power(base):  # by squaring, as XLA does, because `pow` is slow on a controller
        result, square, exponent = 1.0, base, abs(params["y"])
        while exponent:
            result = make.make("mul", result, square) if exponent % 2 else result
            exponent //= 2
            square = make.make("mul", square, square) if exponent else square
        return make.make("div", 1.0, result) if params["y"] < 0 else result

    return [_each(power, args)]


def _chosen(make, params, args, equation):
    which, *cases = args
    if len(cases) != 2:
        return [_each(lambda w, *c: _one_of(make, w, c), args)]
    return [_each(make.select, [which, *cases])]


def _one_of(make, which, cases):
    chosen = cases[-1]
    for k in range(len(cases) - 2, -1, -1):
        chosen = make.select(make.make("le", which, k), chosen, cases[k])
    return chosen


def _branches(make, params, args, equation):
    """Evaluate all branches and select one result; this is allowed, because branches have no side effects."""
    branches = [_run(make, *_opened(b), args[1:]) for b in params["branches"]]
    which = args[0].item()
    if not isinstance(which, Node):
        return branches[min(max(int(which), 0), len(branches) - 1)]
    if which.truth:
        return [_each(lambda n, y: make.select(which, n, y), pair) for pair in zip(*branches, strict=True)]
    return [_each(lambda *c: _one_of(make, which, c), case) for case in zip(*branches, strict=True)]


def _reduced(op: str):
    def reduced(make, params, args, equation):
        axes = tuple(params["axes"])
        kept = [k for k in range(args[0].ndim) if k not in axes]
        rows = args[0].transpose(*kept, *axes).reshape(*(args[0].shape[k] for k in kept), -1)
        flat = rows.reshape(-1, rows.shape[-1])
        return [_array([reduce(partial(make.make, op), row) for row in flat], rows.shape[:-1])]

    return reduced


def _product(make, params, args, equation):
    (lhs_sum, rhs_sum), (lhs_batch, rhs_batch) = params["dimension_numbers"]

    def sorted_out(array, batch, summed):
        free = [k for k in range(array.ndim) if k not in batch and k not in summed]
        shape = [array.shape[k] for k in (*batch, *free)]
        rows = array.transpose(*batch, *free, *summed)
        size = [int(np.prod([array.shape[k] for k in part])) for part in (batch, free, summed)]
        return rows.reshape(size), shape[len(batch) :], shape[: len(batch)]

    # every product of JAX is a batch of plain ones: (batch, free, summed) on either side
    lhs, lhs_free, batch = sorted_out(args[0], lhs_batch, lhs_sum)
    rhs, rhs_free, _ = sorted_out(args[1], rhs_batch, rhs_sum)
    products = np.empty((len(lhs), lhs.shape[1], rhs.shape[1]), object)
    for k, (a, b) in enumerate(zip(lhs, rhs, strict=True)):
        products[k] = _matrix(make, a, b.T)
    return [products.reshape((*batch, *lhs_free, *rhs_free))]


def _matrix(make: Builder, lhs: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Multiply matrices; a large product of weights and a vector becomes a loop over a table."""
    if lhs.size * rhs.shape[1] > _WRITTEN_OUT:
        if rhs.shape[1] == 1 and (table := _weights(make, lhs)) is not None:
            return _array(_table(make, table, rhs[:, 0]), (len(lhs), 1))
        if len(lhs) == 1 and (table := _weights(make, rhs.T)) is not None:
            return _array(_table(make, table, lhs[0]), (1, rhs.shape[1]))
    product = np.empty((len(lhs), rhs.shape[1]), object)
    for i, j in np.ndindex(product.shape):
        product[i, j] = make.total([make.make("mul", a, b) for a, b in zip(lhs[i], rhs[:, j], strict=True)])
    return product


def _unknown(array: np.ndarray) -> bool:
    return any(isinstance(a, Node) for a in array.ravel())


def _weights(make: Builder, matrix: np.ndarray) -> np.ndarray | Still | None:
    """Return known weights as numbers, weights among the still inputs by their places, and None for others."""
    if not _unknown(matrix):
        return np.asarray(matrix.tolist(), np.float64)
    if not all(isinstance(a, Node) and a.op == "input" and a.args[0] < make.still for a in matrix.ravel()):
        return None
    places = np.array([a.args[0] for a in matrix.ravel()]).reshape(matrix.shape)
    rows, columns = (int(np.diff(places, axis=k).ravel()[:1].sum()) for k in (0, 1))
    here = Still(int(places[0, 0]), matrix.shape, (rows, columns))
    return here if np.array_equal(places, here.places()) else None


def _table(make: Builder, weights: np.ndarray | Still, vector: np.ndarray) -> list[Node]:
    return make.block(make.node("matrix", tuple(vector), block=weights), weights.shape[0])


def _scattered(make, params, args, equation):
    """Scatter elements to known indices; refuse several elements at one index."""
    target, where, update = args
    kind, indices = equation.outvars[0].aval.dtype, _number(where, equation)

    def spread(values):
        updates = jnp.asarray(values.reshape(update.shape), kind)
        return np.asarray(equation.primitive.bind(jnp.zeros(target.shape, kind), indices, updates, **params)).ravel()

    if np.max(spread(np.ones(update.size)), initial=0) > 1:
        raise BadInput("a step that adds twice to one element cannot be written as C; report it with the model")
    scattered, added = target.ravel().copy(), equation.primitive.name != "scatter"
    # numbered from 1, so that 0 is a place without an element
    for k, source in enumerate(spread(np.arange(1, update.size + 1)).astype(int)):
        if source:
            new = update.ravel()[source - 1]
            scattered[k] = make.make("add", scattered[k], new) if added else new
    return [scattered.reshape(target.shape)]


def _count(make, params, args, equation):
    return [_known(np.asarray(jax.lax.iota_p.bind(**params)))]


def _scanned(make, params, args, equation):
    """Write a scan out step by step, or as a loop if it is long and returns only its last carry."""
    jaxpr, consts = _opened(params["jaxpr"])
    length = params["length"]
    fixed, carried = _scan_sizes(jaxpr, equation)
    known, carry, rows = args[:fixed], args[fixed : fixed + carried], args[fixed + carried :]
    if len(jaxpr.outvars) == carried and length > 4:
        loop = _loop(make, (jaxpr, consts), known, carry, rows, length)
        if loop is not None:
            return loop
    order = range(length - 1, -1, -1) if params["reverse"] else range(length)
    gathered: list = [None] * length
    for t in order:
        outputs = _run(make, jaxpr, consts, [*known, *carry, *(r[t] for r in rows)])
        carry, gathered[t] = outputs[:carried], outputs[carried:]
    return [*carry, *(np.stack(column) for column in zip(*gathered, strict=True))]


def _scan_sizes(body: Jaxpr, scan) -> tuple[int, int]:
    """Return the number of constant inputs and of carry arrays of a scan.

    JAX stores these numbers under names that change from release to release, but the shapes show them: scanned or
    stacked arrays have one more axis outside the body than inside.
    """

    def same_rank(outside, inside) -> int:
        return sum(a.aval.ndim == b.aval.ndim for a, b in zip(outside, inside, strict=True))

    carried = same_rank(scan.outvars, body.outvars)
    return same_rank(scan.invars, body.invars) - carried, carried


def _loop(make: Builder, opened: tuple[Jaxpr, Sequence], known, carry, rows, length: int):
    """Build a scan as one loop node; return None if that is not shorter than writing it out."""
    # known numbers are folded into the body, the others are passed beside the carry
    inner, loose = Builder(), [k for k in known if _unknown(k)]
    shapes = [a.shape for a in (*loose, *carry)] + [r.shape[1:] for r in rows]
    inputs = sum(int(np.prod(s)) for s in shapes)
    pieces = iter(_cut(inner.inputs(inputs), shapes))
    inside = [next(pieces) if _unknown(k) else k for k in known]
    outputs = _run(inner, *opened, [*inside, *pieces])
    body = Program(inputs, tuple(v for output in outputs for v in output.ravel()))
    if length * len(body.nodes()) < _UNROLLED:
        return None
    flat = [v for a in (*loose, *carry) for v in a.ravel()]
    flat += [v for t in range(length) for r in rows for v in r[t].ravel()]
    moving = sum(c.size for c in carry)
    block = Loop(body, length, sum(k.size for k in loose), moving)
    node = make.node("loop", tuple(flat), block=block)
    return _cut(make.block(node, moving), [c.shape for c in carry])


def _repeated(make, params, args, equation):
    """Write out a while loop with a counter; refuse a loop whose length depends on a computed value."""
    tests, bodies = params["cond_nconsts"], params["body_nconsts"]
    first, second, carry = args[:tests], args[tests : tests + bodies], args[tests + bodies :]
    while True:
        goes = _run(make, *_opened(params["cond_jaxpr"]), [*first, *carry])[0].item()
        if isinstance(goes, Node):
            raise BadInput(
                "a step with a loop of unknown length has no bounded time and cannot be exported; use "
                "loops of fixed length"
            )
        if not goes:
            return carry
        carry = _run(make, *_opened(params["body_jaxpr"]), [*second, *carry])


def _convolved(make, params, args, equation):
    """Convolve two series in one dimension, as in a product of polynomials."""
    (low, high), series, kernel = params["padding"][0], list(args[0].ravel()), args[1].ravel()
    padded = [0.0] * low + series + [0.0] * high
    sums = [
        make.total([make.make("mul", a, b) for a, b in zip(padded[k:], kernel, strict=False)])
        for k in range(len(padded) - len(kernel) + 1)
    ]
    return [_array(sums, equation.outvars[0].aval.shape)]


def _written_as(expression: Callable):
    """Return the rule of an operation that is an expression of others, fn(make, *numbers)."""
    return lambda maker, params, args, equation: [_each(lambda *a: expression(maker.make, *a), args)]


_SPECIAL = {
    "convert_element_type": _converted,
    "conv_general_dilated": _convolved, "integer_pow": _power, "select_n": _chosen, "cond": _branches,
    "reduce_sum": _reduced("add"), "reduce_max": _reduced("max"), "reduce_min": _reduced("min"),
    "reduce_and": _reduced("and"), "reduce_or": _reduced("or"), "dot_general": _product, "scatter": _scattered,
    "scatter-add": _scattered, "iota": _count, "scan": _scanned, "while": _repeated,
    "square": _written_as(lambda make, a: make("mul", a, a)),
    "one_minus_square": _written_as(lambda make, a: make("sub", 1.0, make("mul", a, a))),
    "logistic": _written_as(lambda make, a: make("div", 1.0, make("add", 1.0, make("exp", make("neg", a))))),
    "rsqrt": _written_as(lambda make, a: make("div", 1.0, make("sqrt", a))),
    "add_any": _written_as(lambda make, a, b: make("add", a, b)),
    "clamp": _written_as(lambda make, low, x, high: make("min", make("max", x, low), high)),
}  # fmt: skip
