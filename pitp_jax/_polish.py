"""The last word on an identified model: optimistix's Levenberg-Marquardt on the output error, to its own tolerance.

    r(p), dr/dp     exact, from the host (`_output_error.terms`): no pole is ever compiled

The search over orders, starts and holds runs on normal equations (`_levenberg`), 10 times faster here because nothing
is compiled for shapes met once; they square the condition number, a QR of the Jacobian does not. So the chosen order
is refined by it, and a search that stopped short would show as a step.
"""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from ._output_error import OutputError, residual, terms


def polish(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> tuple[Float[np.ndarray, " parameters"], bool]:
    """Parameters of least output error from a nearby start, and whether optimistix calls it converged."""

    def left(bits):
        return residual(_float64(bits), problem, order=order, hold=hold).reshape(-1, 1).view(np.uint32)

    def slopes(bits):
        found = np.zeros((*problem.weight.shape, len(params)))
        for k, (_, jacobian, columns) in enumerate(terms(_float64(bits), problem, order=order, hold=hold)):
            found[k][:, columns] = jacobian
        return found.reshape(-1, len(params), 1).view(np.uint32)

    with jax.enable_x64(True):
        rows = jax.ShapeDtypeStruct((problem.weight.size, 2), jnp.uint32)
        table = jax.ShapeDtypeStruct((problem.weight.size, len(params), 2), jnp.uint32)

        @jax.custom_jvp
        def fn(p):
            return _values(jax.pure_callback(left, rows, _bits(p)))

        @fn.defjvp
        def _(primals, tangents):
            return fn(*primals), _values(jax.pure_callback(slopes, table, _bits(primals[0]))) @ tangents[0]

        found = optx.least_squares(
            lambda p, _: fn(p), optx.LevenbergMarquardt(rtol=1e-6, atol=1e-9), jnp.asarray(params), max_steps=20,
            throw=False,
        )  # fmt: skip
        return np.asarray(found.value), bool(found.result == optx.RESULTS.successful)


def _bits(p):
    """A callback runs on a thread of its own, where float64 is off: values would be rounded to float32 both ways."""
    return jax.lax.bitcast_convert_type(p, jnp.uint32)


def _values(bits):
    return jax.lax.bitcast_convert_type(bits, jnp.float64)


def _float64(bits) -> np.ndarray:
    return np.ascontiguousarray(bits).view(np.float64)[:, 0]
