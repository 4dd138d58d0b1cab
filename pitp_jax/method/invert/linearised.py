"""Linearise a simulation: the effect of a small change of the voltage on the reading, stage by stage.

    s_{t+1} = f(s_t, V_t, V_{t+1}),   A_t = df/ds,  B_t = df/d(V_t, V_{t+1}),   y_t = reading(s_t)
    V_{t+1} = q V_t + a u_t + b u_{t+1}                                          the electrode's lag

A stage is `length` samples, over which the change of the voltage is linear, c + j d after j of them. With z = (ds, dV,
c, d) at its beginning, all values within the stage are linear in z, and so is the next z except for its new slope d.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.model import Model
from ..model.programs import jit
from ..numerics.intersample import between
from ..simulate import ports
from ..simulate.decoder import stage_fractions, step


class Stages(NamedTuple):
    """Matrices of each stretch of samples: the change of state at its end, and of the scaled reading at each sample."""

    onward: Float[Array, "stages n n"]
    reading: Float[Array, "stages length n"]


@jit
def linearise(
    model: Model,
    states: Float[Array, "stages length state"],
    film: Float[Array, "stages length 2"],
    dt: float,
    unit: Float[Array, ""],
) -> Stages:
    """Linearise the simulation of a voltage; return the matrices of every stretch of samples.

    Args:
        model: any; the caller applies its delays.
        states: of the rollout, scaled.
        film: the voltage behind the electrode at each sample and the next, V.
        dt: sampling interval, s.
        unit: of dV, c and d, V.
    """
    if model.hold == "bandlimited":  # its taps reach over 16 samples; for a slope, linear is sufficient
        model = replace(model, hold="foh")
    fractions = stage_fractions(model)
    size = states.shape[-1]
    n, zero = size + 3, jnp.zeros((), states.dtype)
    # the electrode's lag is linear, so its three coefficients are its slopes at any voltage
    q, a, b = jax.grad(lambda v, old, new: model.drive.after(v, old, new, dt), argnums=(0, 1, 2))(zero, zero, zero)
    V = jnp.zeros(n, states.dtype).at[size:].set(jnp.stack([q, a + b, b]))
    ramp = jnp.zeros((2, n), states.dtype).at[0, size + 1 :].set(1.0).at[1, -1].set(1.0)

    def onward(s, pair):
        return step(model, s, between(pair, model.hold, fractions, jnp)[0], dt)

    def sample(s, pair):
        """Compute the matrix that advances z by one sample, and the gradient of the reading in the state."""
        A, B = jax.jacfwd(onward, argnums=(0, 1))(s, pair)
        moved = unit * B[:, 1:] * V
        moved = moved.at[:, :size].add(A).at[:, size].add(unit * B[:, 0])
        return jnp.concatenate([moved, V[None], ramp]), jax.grad(lambda s: ports.reading(model, s))(s)

    def across(product, now):  # all stages side by side, one sample of each at a time
        matrix, gradient = jax.vmap(sample)(*now)
        return matrix @ product, jnp.einsum("ks,ksm->km", gradient, product[:, :size])

    begin = jnp.broadcast_to(jnp.eye(n, dtype=states.dtype), (states.shape[0], n, n))
    along = jnp.moveaxis(states, 1, 0), jnp.moveaxis(film, 1, 0)
    after, reading = jax.lax.scan(across, begin, along)
    return Stages(after, jnp.moveaxis(reading, 0, 1))
