"""Integrate a virtual actuator's equations between the samples of its voltage.

    y' = f(y, u(t)),    u(t_i + s) = u_i + s (u_{i+1} - u_i) / dt  (foh)    or    u_i  (zoh),    0 <= s < dt

Fixed classical Runge-Kutta steps end on every sample, so none crosses a kink of u and the fourth order holds; at 0.03
rad of the natural frequency per step they stay within 1e-7 of the range on the paper's records. The adaptive steps are
diffrax's, and end there too: a step controller that searches for the kinks takes five times as long.
"""

import math
from functools import partial

import diffrax
import jax
import jax.numpy as jnp

from .physics import Plant


def substeps(plant: Plant, dt: float) -> int:
    """Return the number of Runge-Kutta steps per sample of `dt` s: at most 0.03 rad of the natural frequency each."""
    return max(1, math.ceil(2.0 * math.pi * plant.resonance_hz * dt / 0.03))


def rest(plant):
    """Return the scaled state of a virtual actuator at rest, shape (2 + branches,)."""
    return jnp.zeros(2 + len(plant.branches))  # displacement, velocity, one stretch per branch


def advance(plant: Plant, state, u0, u1, *, dt, count: int, hold: str):
    """Integrate a virtual actuator over one sample by `count` classical Runge-Kutta steps.

    Args:
        plant: the virtual actuator.
        state: scaled state at the sample, shape (2 + branches,).
        u0: voltage at the sample in V.
        u1: voltage at the next sample in V; not used by "zoh".
        dt: sampling interval in s.
        count: steps per sample.
        hold: "foh" or "zoh".

    Returns:
        The scaled state and the displacement in m at the next sample.
    """
    h = dt / count
    rise = (u1 - u0) / count if hold == "foh" else jnp.zeros_like(u0)

    def step(_, carry):
        y, u = carry
        k1 = plant.derivative(y, u)
        k2 = plant.derivative(y + 0.5 * h * k1, u + 0.5 * rise)
        k3 = plant.derivative(y + 0.5 * h * k2, u + 0.5 * rise)
        k4 = plant.derivative(y + h * k3, u + rise)
        return y + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4), u + rise

    state, _ = jax.lax.fori_loop(0, count, step, (state, jnp.asarray(u0, dtype=state.dtype)))
    return state, state[0] * plant.scale


@partial(jax.jit, static_argnums=(0, 3, 4))
def fixed(plant, voltage, dt, count, hold):
    """Simulate with a fixed time step: voltage (R, T) in V to displacement (R, T) in m."""

    def one(row):
        def body(state, pair):
            return advance(plant, state, pair[0], pair[1], dt=dt, count=count, hold=hold)

        return jax.lax.scan(body, rest(plant), (row[:-1], row[1:]))[1]

    moved = jax.vmap(one)(voltage)
    # the scan returns the ends of samples; every record starts at rest, x = 0
    return jnp.pad(moved, ((0, 0), (1, 0)))


@partial(jax.jit, static_argnums=(0, 3))
def adaptive(plant, voltage, dt, hold):
    """Simulate with an adaptive time step: voltage (T,) in V to displacement (T,) in m."""
    last = len(voltage) - 2
    grid = dt * jnp.arange(len(voltage))

    def rate(t, y, _):
        i = jnp.floor(t / dt).astype(int)
        i = jnp.clip(i - (t < grid[i]) + (t >= grid[i + 1]), 0, last)  # t / dt may round across a sample
        # a held voltage jumps only at samples, where the controller stops (`jump_ts`)
        part = t / dt - i if hold == "foh" else 0.0
        return plant.derivative(y, voltage[i] + part * (voltage[i + 1] - voltage[i]))

    control = diffrax.PIDController(rtol=1e-10, atol=1e-10)  # atol in units of the plant's scale
    control = diffrax.ClipStepSizeController(control, jump_ts=grid[1:-1])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        diffrax.Dopri8(),
        t0=0.0,
        t1=grid[-1],
        dt0=None,  # the controller's own first step, because a roll and a cone differ by a factor 20 in time
        y0=rest(plant),
        saveat=diffrax.SaveAt(ts=grid, fn=lambda t, y, args: y[0]),
        stepsize_controller=control,
        max_steps=None,  # at least one step a sample, of records of any length
    )
    return solution.ys * plant.scale
