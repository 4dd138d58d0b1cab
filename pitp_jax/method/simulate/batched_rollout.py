"""Simulate many records at once, faster than `decoder`, by the same Runge-Kutta step over arrays of records.

    s_{t+1} = s_t + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4),   tokens frozen at the drifted midpoint

The states equal those of `decoder.rollout` to rounding. Records are rows, nets are written out, and optimisation
barriers follow the tokens, so nothing is computed twice. This is the fastest way for one record, for many and under
`vmap` (docs/decisions/decoder.md).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.encoder import CompactEncoder, ConstantEncoder, plain
from ..model.model import Model
from ..model.programs import jit
from .decoder import (
    along,
    at_rest,
    held,
    midpoint,
    motion_of,
    moved,
    rollout_batch,
    runge_kutta,
    scaled_force,
    stage_voltages,
)


@jit
def fast_rollout(
    model: Model, voltage: Float[Array, "records time"], dt: float, start: Float[Array, "records state"]
) -> Float[Array, "records time state"]:
    """Simulate all records; return the scaled states at every sample, equal to `decoder.rollout_batch`.

    Models with effects, or with an encoder too large to write out, use `rollout_batch` itself.
    """
    if not in_rows(model):
        return rollout_batch(model, voltage, dt, start)
    # the film's voltage depends on u alone, so it is known for the whole record before the scan
    film = jax.vmap(lambda u, r: model.drive.film(u, dt, r))(voltage, at_rest(model, start))
    return rows_rollout(model, film, dt, start)


def in_rows(model: Model) -> bool:
    """Return whether a model can be simulated for many records in one array: no effects, a small encoder."""
    return not model.effects and isinstance(plain(model.encoder), CompactEncoder | ConstantEncoder)


def steps_at_once() -> int:
    """Return the number of samples per iteration of a simulation's loop; on a GPU 1 costs 10 us a sample, 16 cost 4."""
    return 1 if jax.default_backend() == "cpu" else 16


def rows_rollout(
    model: Model,
    film: Float[Array, "records time"],
    dt: float,
    start: Float[Array, "records state"],
    unroll: int | None = None,
) -> Float[Array, "records time state"]:
    """Simulate all records from film voltages; `unroll`: samples per iteration, by default `steps_at_once`."""
    # a CPU computes eight records at once if there are at least 16, and others one by one: copies fill up the last
    extra = max(16 - len(start), -len(start) % 8) if len(start) > 5 else 0
    film, filled = (jnp.pad(a, [(0, extra), (0, 0)], "edge") for a in (film, start))
    # records last, because a scan steps over the first axis, and a row of records is contiguous
    forces = jnp.moveaxis(scaled_force(model, jax.vmap(lambda v: stage_voltages(model, v))(film)), 0, -1)
    h, constant, logits = dt / model.substeps, motion_of(model), model.encoder.over()

    def one(state, three):
        # tokens at the midpoint, then frozen: one evaluation of the encoder per step instead of four
        frozen = held(*model.tokens_from(logits(midpoint(constant, state, h))))
        return moved(state, 1.0, runge_kutta(constant, state, frozen, three, h))

    def advance(state, stages):
        return jnp.stack(along(one, list(state), stages)), state

    states = jax.lax.scan(advance, filled.T, forces, unroll=unroll or steps_at_once())[1]
    return jnp.moveaxis(states, -1, 0)[: len(start)]
