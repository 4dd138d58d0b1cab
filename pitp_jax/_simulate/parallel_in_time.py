"""A rollout parallel in time: Newton's method for all states at once (DEER; Lim et al. 2024, Danieli et al. 2023).

    find s:  r_t = f_t(s_t) - s_{t+1} = 0,  t = 0 ... T - 2,    f_t: `decoder.step` along the stage voltages of sample t
    s_{t+1} <- A_t s_t + (f_t(s'_t) - A_t s'_t),                A_t = (1 - d) df_t/ds at the last iterate s'

Every iteration is one parallel pass for f and A and one associative scan over affine maps; the state has 2 to 4
numbers and the memories. The start is the linear model's own rollout, affine, hence exact after one scan. d = 0 is
Newton. Where that runs away it begins again with d = 0.01, then 0.04 and so on, halved every iteration (scale-ELK;
Gonzalez et al. 2024): the scan forgets the far past, as a contracting actuator does. The answer counts only if every
residual is at rounding; else the sequential rollout runs.

T steps take about log2 T dependent ones per iteration, at (n + K) times the work. On two cores the sequential rollout
wins at any length; `suits` knows.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._model.encoder import ConstantEncoder
from .._model.model import Model
from .._model.programs import jit
from .batched_rollout import fast_rollout
from .decoder import stage_voltages, step

_ITERATIONS = 60
_DAMPING, _HARDER = 0.01, 4.0  # first damping, factor to the next
_GROWTH = 100.0  # of the residual, which ends a try
_ROUNDING = 32.0  # largest residual, in units of eps times the largest state
_LONG = 4096  # steps from which a parallel machine gains


def suits(records: int, steps: int, backend: str) -> bool:
    """Whether parallel in time is the faster way: few long records where thousands of lanes would stand idle."""
    return backend != "cpu" and steps >= _LONG and records * 64 <= steps


class Parallel(eqx.Module):
    """States (scaled, row 0 = start), how many iterations they took and whether they met the residual."""

    states: Float[Array, "time state"]
    iterations: Array
    converged: Bool[Array, ""]


def affine_scan(
    matrix: Float[Array, "steps n n"], offset: Float[Array, "steps n"], start: Float[Array, " n"]
) -> Float[Array, "steps+1 n"]:
    """All s_{t+1} = A_t s_t + b_t, row 0 = `start`, in about log2(steps) dependent products."""

    def compose(first, second):
        (a, b), (c, d) = first, second
        return c @ a, jnp.einsum("...ij,...j->...i", c, b) + d

    products, sums = jax.lax.associative_scan(compose, (matrix, offset))
    return jnp.concatenate([start[None], products @ start + sums])


@jit
def parallel_rollout(
    model: Model, voltage: Float[Array, " time"], dt: float, start: Float[Array, " state"]
) -> Parallel:
    """States under a drive voltage u (V) at every sample, as `decoder.rollout`, by damped Newton; may not converge.

    The model has no effects.
    """
    film = model.drive.film(voltage, dt, ~jnp.any(start[: model.order]))
    stages = stage_voltages(model, film)[:-1]
    linear = replace(model, encoder=ConstantEncoder(model.order + 2))
    tiny = jnp.finfo(start.dtype).tiny

    def maps(m, states):
        """F_t(s_t) and df_t/ds at every step."""

        def one(s, v):
            return step(m, s, v, dt)

        return jax.vmap(one)(states, stages), jax.vmap(jax.jacfwd(one))(states, stages)

    def residual(moved, states):
        """The largest miss in units of rounding, nan counted as infinite."""
        missed = jnp.max(jnp.abs(moved - states[1:]))
        size = jnp.finfo(states.dtype).eps * jnp.maximum(jnp.max(jnp.abs(states)), tiny)
        return jnp.where(jnp.isfinite(missed), missed / size, jnp.inf)

    def solve(moved, slope, states):
        offset = moved - jnp.einsum("tij,tj->ti", slope, states[:-1])
        return affine_scan(slope, offset, start)

    def evaluated(states):
        moved, slope = maps(model, states[:-1])
        return states, moved, slope, residual(moved, states)

    def improve(carry):
        (states, moved, slope, miss), damping, first, count, _ = carry
        met = miss <= _ROUNDING  # once more, undamped: Newton is quadratic, and what rounding lets through adds up
        tried = evaluated(solve(moved, jnp.where(met, 1.0, 1 - damping) * slope, states))
        lost = ~(tried[3] < jnp.where(met, _ROUNDING, _GROWTH * miss))
        instead = jax.tree.map(lambda a, b: jnp.where(met, a, b), (states, moved, slope, miss), begin)
        kept = jax.tree.map(lambda a, b: jnp.where(lost, a, b), instead, tried)
        more = jnp.maximum(_HARDER * first, _DAMPING)
        return kept, jnp.where(lost, more, damping / 2), jnp.where(lost, more, first), count + 1, met

    def going(carry):
        _, _, first, count, finished = carry
        return ~finished & (first < 1) & (count < _ITERATIONS)

    still = jnp.broadcast_to(start, (voltage.shape[0], *start.shape))
    states = solve(*maps(linear, still[:-1]), still)
    begin = evaluated(jnp.where(jnp.isfinite(states).all(), states, still))
    zero, none = jnp.zeros((), start.dtype), jnp.zeros((), jnp.int32)
    found, _, _, count, _ = jax.lax.while_loop(going, improve, (begin, zero, zero, none, jnp.array(False)))
    return Parallel(found[0], count, found[3] <= _ROUNDING)


def rollout_by_size(
    model: Model, voltage: Float[Array, "records time"], dt: float, start: Float[Array, "records state"]
) -> Float[Array, "records time state"]:
    """States of records under their voltages by whichever way is faster here; the sequential one where Newton fails."""
    records, steps = voltage.shape
    if model.effects or not suits(records, steps, jax.default_backend()):
        return fast_rollout(model, voltage, dt, start)
    found = [parallel_rollout(model, u, dt, s) for u, s in zip(voltage, start, strict=True)]
    if all(bool(f.converged) for f in found):
        return jnp.stack([f.states for f in found])
    return fast_rollout(model, voltage, dt, start)
