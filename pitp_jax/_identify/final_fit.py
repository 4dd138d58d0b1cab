"""The last word on an identified model: optimistix's Levenberg-Marquardt on the output error, to its own tolerance.

    r(p), dr/dp     exact, from the host (`output_error.terms`): no pole is ever compiled

The search over orders, starts and holds runs on normal equations (`levenberg_marquardt`), 10 times faster here because
nothing is compiled for shapes met once; they square the condition number, a QR of the Jacobian does not. So the chosen
order is refined by it, and a search that stopped short would show as a step. Compiling takes longer than running: the
program is handed a problem's number, so the next one of its size runs at once.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from .output_error import OutputError, residual, terms


def polish(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[np.ndarray, " parameters"]:
    """Parameters of least output error from a nearby start."""
    with jax.enable_x64(True), _at_hand(problem) as number:
        return np.asarray(_solve(jnp.asarray(params), number, problem.weight.size, order, hold))


_PROBLEMS: dict[int, OutputError] = {}
_NUMBERS = count()


@contextmanager
def _at_hand(problem: OutputError) -> Iterator[int]:
    """The number under which callbacks find the problem meanwhile.

    Not its records: JAX copies what a callback is given, from 100 kB on by a task of the threads that run it, so that
    on one core the callback waited for ever for its own argument.
    """
    number = next(_NUMBERS)
    _PROBLEMS[number] = problem
    try:
        yield number
    finally:
        del _PROBLEMS[number]


@partial(jax.jit, static_argnames=("samples", "order", "hold"))
def _solve(start, number, samples: int, order: int, hold: str):
    def left(bits, number):
        p, problem = _from_bits(bits), _PROBLEMS[int(number)]
        return _to_bits(residual(p, problem, order=order, hold=hold).reshape(-1))

    def slopes(bits, number):
        p, problem = _from_bits(bits), _PROBLEMS[int(number)]
        found = np.zeros((*problem.weight.shape, len(p)))
        for k, (_, jacobian, columns) in enumerate(terms(p, problem, order=order, hold=hold)):
            found[k][:, columns] = jacobian
        return _to_bits(found.reshape(-1, len(p)))

    def read(callback, p, *shape):
        bits = jax.lax.bitcast_convert_type(p, jnp.uint32)
        found = jax.pure_callback(callback, jax.ShapeDtypeStruct((*shape, 2), jnp.uint32), bits, number)
        return jax.lax.bitcast_convert_type(found, jnp.float64)

    @jax.custom_jvp
    def fn(p):
        return read(left, p, samples)

    @fn.defjvp
    def _(primals, tangents):
        return fn(*primals), read(slopes, primals[0], samples, len(start)) @ tangents[0]

    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-9)
    return optx.least_squares(lambda p, _: fn(p), solver, start, max_steps=20, throw=False).value


def _to_bits(values: np.ndarray) -> np.ndarray:
    """Float64 as pairs of uint32: a callback runs on a thread of its own, where float64 is off and would be rounded."""
    return np.ascontiguousarray(values, np.float64)[..., None].view(np.uint32)


def _from_bits(bits) -> np.ndarray:
    return np.ascontiguousarray(bits).view(np.float64)[..., 0]
