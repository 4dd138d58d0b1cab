"""Advance memories and the film voltage by one sample, for each kind of memory and electrode.

V_{k+1} = q V_k + a u_k + b u_{k+1}  with q = exp(-dt / tau)           the electrode's lag of a voltage that is linear
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..model.drive import AbstractDrive, ElectrodeLag
from ..model.memory import AbstractMemory, FadingMemory
from ..numerics.linear_recurrence import lag_after


def memory_after(memory: AbstractMemory, state: Array, before: Array, now: Array, dt: float) -> Array:
    """Return the memory states one sample later, for x linear from `before` to `now` (scaled)."""
    if isinstance(memory, FadingMemory):
        return lag_after(state, before, now, jnp.exp(memory.log_tau), dt)
    return memory.trajectory(jnp.stack([before, now]), dt, state)[1]


def film_held(drive: AbstractDrive, film: Array, now: Array, dt: float, stages: np.ndarray) -> tuple[Array, Array]:
    """Return the film voltages at the stages and at the end of one sample with a constant voltage u."""
    if not isinstance(drive, ElectrodeLag):
        return jnp.full(len(stages), now), now
    tau, first = jnp.exp(drive.log_tau), float(stages[2]) * dt
    decay = (film - now) * jnp.exp(-stages * dt / tau)
    # the first stage makes Simpson's rule exact for the mean, because a short lag ends between two stages
    mean = -(film - now) * jnp.expm1(-first / tau) * tau / first
    return now + decay.at[0].set(6 * mean - 4 * decay[1] - decay[2]), now + decay[-1]
