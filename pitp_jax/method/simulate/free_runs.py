"""Simulate many free runs of one step at once, from NumPy to NumPy, in float64 on the CPU.

    s_{t+1}, y_t = step(p, s_t, u_t)      for every run: its own parameters p and start s_0, one of several inputs u

The step is any JAX function of one run. This is the way for runs that need no gradient; to trace, differentiate or
shard a simulation, use `jax.lax.scan` and `jax.vmap` on the same step.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..model.programs import double_on_cpu
from .compiled.kernel import kernel

BLOCK, CHUNK = 256, 512  # runs at once, time steps of a call: few programs, and the working memory

Step = Callable[[Float[Array, " p"], Float[Array, " s"], Float[Array, "..."]], tuple[Float[Array, " s"], Array]]


def free_runs(
    step: Step,
    parameters: Float[np.ndarray, "runs p"],
    start: Float[np.ndarray, "runs s"],
    inputs: Float[np.ndarray, "columns n *k"],
    column: Int[np.ndarray, " runs"],
) -> Float[np.ndarray, "runs n o"]:
    """Compute the outputs of all runs, shape (runs, n, o), float64.

    The working memory beyond the result is 256 x 512 x o numbers and the states of 256 runs.

    Args:
        step: fn(parameters (p,), state (s,), input) -> (state (s,), outputs (o,) or a scalar) of one run. It is
            compiled once and found again by its hash: use a function or a frozen object, not a new lambda each time.
        parameters: of every run, shape (runs, p).
        start: initial states, shape (runs, s).
        inputs: shape (columns, n), a scalar for every step; or (columns, n, k), k numbers for every step.
        column: the input of each run, shape (runs,).

    Returns:
        outputs, shape (runs, n, o); a run that diverges contains inf or nan, the others are not affected.

    Examples:
        >>> def lag(p, s, u):
        ...     return s + p * (u - s), s
        >>> y = free_runs(lag, np.array([[0.1], [0.2]]), np.zeros((2, 1)), np.ones((1, 50)), np.zeros(2, int))
        >>> y.shape
        (2, 50, 1)
    """
    parameters, start, inputs = (np.asarray(a, np.float64) for a in (parameters, start, inputs))
    column = np.asarray(column, np.int64)
    compiled = kernel(step, parameters, start, inputs)
    return (compiled or partial(scanned_runs, step))(parameters, start, inputs, column)


def scanned_runs(step: Step, parameters, start, inputs, column) -> Float[np.ndarray, "runs n o"]:
    """Compute `free_runs` by `jax.lax.scan`, in blocks of runs."""
    with double_on_cpu():
        one = jax.eval_shape(step, *(jnp.asarray(a) for a in (parameters[0], start[0], inputs[0, 0])))[1]
        outputs = np.empty((len(column), inputs.shape[1], int(np.prod(one.shape))))
        for first in range(0, len(column), BLOCK):
            runs = np.arange(first, min(first + BLOCK, len(column)))
            # copies of the last run fill the block, so that few widths are compiled
            width = min(BLOCK, 1 << int(len(runs) - 1).bit_length())
            some = runs[np.minimum(np.arange(width), len(runs) - 1)]
            state = start[some]
            for t in range(0, inputs.shape[1], CHUNK):
                piece = inputs[:, t : t + CHUNK]
                fill = [(0, 0), (0, CHUNK - piece.shape[1])] + [(0, 0)] * (inputs.ndim - 2)
                piece = np.moveaxis(np.pad(piece, fill, mode="edge"), 1, 0)
                state, y = _advance(step, parameters[some], state, piece, column[some])
                outputs[runs, t : t + CHUNK] = np.asarray(y)[: inputs.shape[1] - t, : len(runs)].swapaxes(0, 1)
    return outputs


@partial(jax.jit, static_argnums=0)
def _advance(step: Step, parameters, state, inputs, column):
    def along(state, now):
        state, y = jax.vmap(step)(parameters, state, now[column])
        return state, y.reshape(len(column), -1)

    return jax.lax.scan(along, state, inputs)
