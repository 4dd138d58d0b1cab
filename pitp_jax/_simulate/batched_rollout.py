"""The decoder's rollout at the speed of its arithmetic: the RK4 step of `decoder` over rows of records.

    s_{t+1} = s_t + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4),   tokens frozen at the drifted midpoint

The states of `decoder.rollout` to rounding. One record is a chain of scalars, one kernel a step: 0.3 us instead of 1.1.
Many records are rows, with walls behind clipping, hidden layers and tokens so that nothing is computed twice: 32
records 4 us a step instead of 7-15. Time is one scan; for parallel in time see `parallel_in_time`.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._model.encoder import CompactEncoder, ConstantEncoder
from .._model.model import Model
from .._model.programs import jit
from .decoder import UNROLLED, rollout_batch, scaled_force, stage_voltages
from .rows import encoder_rows, memory_rates, tokens_rows


def row_step(model: Model, h: float, many: bool = False) -> Callable[[list, list], list]:
    """fn(state rows, three stage forces): the state rows one RK4 step of h (s) later, as `decoder.frozen_increment`.

    `many`: one matrix product per layer, and the tokens computed once and kept. XLA would fuse them into every row of
    the new state and compute them again for each.
    """
    n, pace = model.order, list(jnp.asarray(model.scales.rates, model.coefficients.dtype))
    half = [h / 2 * rate for rate in pace]
    memory_rate, logits = memory_rates(model.memory), encoder_rows(model.encoder, many)

    def moved(rows, by, slopes):
        return [a + by * b for a, b in zip(rows, slopes, strict=True)]

    def step(state: list, forces: list) -> list:
        # not as k2 has it, x + h/2 (rate x'): what both read would become a kernel of its own, 3 to 10 ms per 10,000
        seen = [state[i] + half[i] * state[i + 1] for i in range(n - 1)] + [state[n - 1]]
        seen += moved(state[n:], h / 2, memory_rate(state[n:], state[0]))
        tokens, offset = tokens_rows(model, logits(seen))
        kept = [*tokens[:n], 1 / tokens[n], offset]
        *tokens, share, offset = jax.lax.optimization_barrier(jnp.stack(kept)) if many else kept

        def slope(s, force):
            highest = force - offset
            for token, row in zip(tokens, s, strict=False):
                highest = highest - token * row
            upper = [*s[1:n], highest * share]  # a division in every stage would end up in a kernel of its own
            return [r * row for r, row in zip(pace, upper, strict=True)] + memory_rate(s[n:], s[0])

        k1 = slope(state, forces[0])
        k2 = slope(moved(state, h / 2, k1), forces[1])
        k3 = slope(moved(state, h / 2, k2), forces[1])
        k4 = slope(moved(state, h, k3), forces[2])
        return [s + h / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)]

    return step


@jit
def fast_rollout(
    model: Model, voltage: Float[Array, "records time"], dt: float, start: Float[Array, "records state"]
) -> Float[Array, "records time state"]:
    """Scaled states at every sample of every record, as `decoder.rollout_batch`.

    Models with effects, or with an encoder too large to write out, take the plain way.
    """
    if model.effects or not isinstance(model.encoder, CompactEncoder | ConstantEncoder):
        return rollout_batch(model, voltage, dt, start)
    rest = ~jnp.any(start[:, : model.order], axis=1)
    film = jax.vmap(lambda u, r: model.drive.film(u, dt, r))(voltage, rest)
    forces = jnp.moveaxis(scaled_force(model, jax.vmap(lambda v: stage_voltages(model, v))(film)), 0, -1)
    step, count = row_step(model, dt / model.substeps, voltage.shape[0] > 1), model.substeps

    def advance(state, force):
        rows = list(state)
        if count > UNROLLED:
            threes = force[2 * np.arange(count)[:, None] + np.arange(3)]
            rows = jax.lax.scan(lambda s, three: (step(s, list(three)), None), rows, threes)[0]
        else:
            for k in range(count):
                rows = step(rows, list(force[2 * k : 2 * k + 3]))
        return jnp.stack(rows), state

    return jnp.moveaxis(jax.lax.scan(advance, start.T, forces)[1], -1, 0)
