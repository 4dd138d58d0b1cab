"""The last word on an identified model: optimistix's Levenberg-Marquardt on the output error, to its own tolerance.

    r(p), dr/dp     exact, from the host (`_output_error.terms`): no pole is ever compiled

The search over orders, starts and holds runs on normal equations (`_levenberg`), 10 times faster here because nothing
is compiled for shapes met once; they square the condition number, a QR of the Jacobian does not. So the chosen order
is refined by it, and a search that stopped short would show as a step. Compiling takes longer than running: records
are arguments of the program, so one of the same size runs at once.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from ._output_error import OutputError, residual, terms


def polish(
    params: Float[np.ndarray, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[np.ndarray, " parameters"]:
    """Parameters of least output error from a nearby start."""
    signals = (problem.drive, problem.output, problem.weight, np.array([problem.dt, problem.omega]))
    with jax.enable_x64(True):
        found = _solve(
            jnp.asarray(params), tuple(_to_bits(v) for v in signals), order, hold, problem.rest, problem.square
        )
        return np.asarray(found)


@partial(jax.jit, static_argnames=("order", "hold", "rest", "square"))
def _solve(start, signals, order: int, hold: str, rest: tuple[bool, ...], square: bool):
    def on_host(bits, signals):
        drive, output, weight, (dt, omega) = (_from_bits(v) for v in signals)
        problem = OutputError(drive, output, weight, rest, square, float(dt), float(omega), 1.0, 1.0, 0.0, 0.0)
        return _from_bits(bits), problem

    def left(bits, signals):
        p, problem = on_host(bits, signals)
        return _to_bits(residual(p, problem, order=order, hold=hold).reshape(-1))

    def slopes(bits, signals):
        p, problem = on_host(bits, signals)
        found = np.zeros((*problem.weight.shape, len(p)))
        for k, (_, jacobian, columns) in enumerate(terms(p, problem, order=order, hold=hold)):
            found[k][:, columns] = jacobian
        return _to_bits(found.reshape(-1, len(p)))

    samples = signals[0].size // 2

    def read(callback, p, *shape):
        bits = jax.lax.bitcast_convert_type(p, jnp.uint32)
        found = jax.pure_callback(callback, jax.ShapeDtypeStruct((*shape, 2), jnp.uint32), bits, signals)
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
