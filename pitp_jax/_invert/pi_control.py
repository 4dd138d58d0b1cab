"""PI trim on top of a feedforward (paper, Fig. 14), as a simulated closed loop.

    u_t = u_ff,t + P e_t + I sum_{s <= t} e_s dt,      e = x_target - x

The paper gives P = 0.1, I = 0.3 without units; here they are kV per mm and kV per mm and second, that is V/um and
V/(um s): 1e5 V/m and 3e5 V/(m s) below (docs/readings.md).
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

KV_PER_MM = 1e6  # V/m


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
) -> tuple[Float[Array, " time"], Float[Array, " time"]]:
    """Run a plant, at rest at the first sample, under feedforward plus PI.

    Over a sample the feedforward runs linearly to its next value and the correction is held.

    Args:
        step: (state, u_now, u_next) -> (state, x at the end), one sample of the plant; see `stepper`.
        state: the plant's state at rest.
        voltage: feedforward, V.
        target: wanted displacement, m.
        dt: sampling interval, s.
        p, i: gains in V/m and V/(m s); p = i = 0 plays the feedforward alone.
        limits: voltage range; the integral stops while the voltage is cut (conditional anti-windup).

    Returns:
        Displacement (m) and the voltage at each sample (V), both of shape (T,).

    Examples:
        >>> lag = lambda x, u, u_next: (0.9 * x + 1e-7 * u, 0.9 * x + 1e-7 * u)  # or `stepper`
        >>> x, u = pitp.pi_trim(lag, jnp.zeros(()), jnp.zeros(20), jnp.zeros(20), 1e-3)
        >>> x.shape, u.shape
        ((20,), (20,))
    """
    low, high = limits

    def advance(carry, now):
        state, x, total = carry
        u, u_next, wanted = now
        error = wanted - x
        correction = p * error + i * (total + error * dt)
        free = (u + correction >= low) & (u + correction <= high)
        first, last = jnp.clip(u + correction, low, high), jnp.clip(u_next + correction, low, high)
        total = jnp.where(free, total + error * dt, total)
        state, following = step(state, first, last)
        return (state, following, total), (x, first)

    u_next = jnp.append(voltage[1:], voltage[-1])
    zero = jnp.zeros((), voltage.dtype)
    return jax.lax.scan(advance, (state, zero, zero), (voltage, u_next, target))[1]
