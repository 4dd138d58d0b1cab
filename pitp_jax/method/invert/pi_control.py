"""Correct a feedforward voltage by a PI controller (paper, Fig. 14), in a simulated closed loop.

    v_t = h(u_ff,t) + P e_t + I z_t,   u_t = h^-1(v_t) within range and slew,   e = direction (x_target - x)
    z_{t+1} = z_t + e_t dt + (h(u_t) - v_t) dt / (I T)            back-calculation: z loses the clipped part within T

h is the identity (P and I in V/m and V/(m s), as in the paper) or the input map (in V^2/m, gains of `pi_gains`). The
paper gives P = 0.1, I = 0.3 without units; here they are kV per mm and kV per mm and second, that is V/um and
V/(um s): 1e5 V/m and 3e5 V/(m s) below (docs/readings.md).

Astrom and Hagglund (2006), Advanced PID Control, section 3.5.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, PyTree

from ...common.errors import BadInput
from ..model.input_map import AbstractInputMap, LinearInput
from ..numerics.where import where
from .loop import linearised, margins

KV_PER_MM = 1e6  # V/m
_LEVELS = (0.05, 0.25, 0.5, 0.75, 1.0)  # quantiles of the feedforward


def pi_trim(
    step: Callable,
    state: PyTree,
    voltage: Float[Array, " time"],
    target: Float[Array, " time"],
    dt: float,
    *,
    p: float | Float[Array, ""] = 0.1 * KV_PER_MM,
    i: float | Float[Array, ""] = 0.3 * KV_PER_MM,
    limits: tuple[float, float] = (0.0, float("inf")),
    max_slew: float = float("inf"),
    input_map: AbstractInputMap | None = None,
    tracking: float | None = None,
    direction: float = 1.0,
) -> tuple[Float[Array, " time"], Float[Array, " time"]]:
    """Simulate a plant that starts at rest, with a feedforward voltage and a PI controller.

    Over a sample the feedforward runs linearly to its next value and the correction is held. Outside a JAX
    transformation the loop is linearised about five states of the plant under the feedforward alone (`loop`).

    Args:
        step: (state, u_now, u_next) -> (state, x at the end), one sample of the plant; see `stepper`.
        state: the plant's state at rest.
        voltage: feedforward, V.
        target: wanted displacement, m.
        dt: sampling interval, s.
        p, i: gains in V/m and V/(m s), with an input map those of its force; p = i = 0 uses the feedforward alone.
        limits: voltage range.
        max_slew: V/s; the voltage starts from its first feedforward.
        input_map: a model's: P and I act on the force, so the loop is equally fast at every voltage. None: on the
            voltage, as in the paper.
        tracking: time constant T of the back-calculation, s; None: p / i, at least dt. Take the closed loop's.
        direction: -1 if the sensor is reversed (`model.output.polarity`).

    Returns:
        Displacement (m) and the voltage at each sample (V), both of shape (T,).

    Raises:
        BadInput: the loop with these gains is unstable about one of these states, or has no derivatives there. Under
            `jit` nothing is checked.

    Examples:
        >>> lag = lambda x, u, u_next: (0.9 * x + 1e-7 * u, 0.9 * x + 1e-7 * u)  # or `stepper`
        >>> x, u = pitp.pi_trim(lag, jnp.zeros(()), jnp.zeros(20), jnp.zeros(20), 1e-3)
        >>> x.shape, u.shape
        ((20,), (20,))
    """
    low, high = limits
    h = input_map or LinearInput()
    integrates = jnp.asarray(i) > 0
    # faster than a sample, the back-calculation would overshoot
    within = jnp.maximum(p / jnp.where(integrates, i, 1.0) if tracking is None else tracking, dt)

    def kept(wanted, feed, before):
        """Convert a force to a voltage within range and slew; without a correction it is exactly the feedforward."""
        # h^-1(h(u)) rounds, so that gains of zero would not reproduce the file exactly
        u = where(wanted == h.force(feed), feed, h.voltage(wanted))
        return jnp.clip(jnp.clip(u, low, high), before - max_slew * dt, before + max_slew * dt)

    def advance(carry, now):
        state, x, total, before = carry
        u, u_next, wanted = now
        error = direction * (wanted - x)
        total = total + error * dt
        correction = p * error + i * total
        asked = h.force(u) + correction
        first = kept(asked, u, before)
        last = kept(h.force(u_next) + correction, u_next, first)
        # the part cut by limits is removed from the integral; otherwise it would wind up
        total = total + where(integrates, (h.force(first) - asked) / jnp.where(integrates, i, 1.0), 0.0) * dt / within
        state, following = step(state, first, last)
        return (state, following, total, first), (x, first)

    u_next = jnp.append(voltage[1:], voltage[-1])
    if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((state, voltage, target, p, i))):
        _refuse_unstable(step, state, voltage, u_next, dt, (float(p), float(i)), (h, limits, direction))
    zero = jnp.zeros((), voltage.dtype)
    return jax.lax.scan(advance, (state, zero, zero, voltage[0]), (voltage, u_next, target))[1]


def _refuse_unstable(step: Callable, state: PyTree, voltage, u_next, dt: float, gains: tuple, loop: tuple) -> None:
    """Refuse PI gains whose loop is unstable about a state that the feedforward alone reaches.

    Raises:
        BadInput: with the factor by which the gains would have to be multiplied.
    """
    (p, i), (h, (low, high), direction) = gains, loop
    if p == 0 and i == 0:
        return
    levels = jnp.quantile(voltage, jnp.asarray(_LEVELS))
    at = jnp.argmin(jnp.abs(voltage[None] - levels[:, None]), 1)

    def advance(carry, now):
        return step(carry, *now)[0], carry

    states = jax.lax.scan(advance, state, (voltage, u_next))[1]
    points = []
    for k in map(int, at):
        u = float(jnp.clip(voltage[k], low, high))
        # the controller's force is converted with the gain 1 / h'(u); where h' = 0 the voltage has no effect
        slope = 2 * u if h.one_sided else 1.0
        if slope > 0:
            points.append((jax.tree.map(lambda leaf, k=k: leaf[k], states), u, direction / slope))
    if not points:
        return
    run = 2 * jnp.pi / (len(voltage) * dt)
    # the lowest frequency is 1e-5 of this one, so a hundredth of a period over the whole run
    plants = linearised(lambda s, u: step(s, u, u), points, dt, float(1e3 * run))
    margin, sensitivity = margins(plants, p, i, dt)
    if not jnp.isfinite(sensitivity):
        raise BadInput(
            f"the loop with p = {p:.3g} and i = {i:.3g} is unstable on this plant (gain margin {margin:.3g}); use "
            "smaller gains (`pi_gains` computes them from a model)"
        )
