"""Lumped nonlinear actuator: one mass, a cubic spring, a state-dependent damper, three relaxation branches.

    m x'' + c(x) x' + k1 x + k2 x^2 + k3 x^3 + sum_j g_j (x - z_j) = v^2 (1 + b x)
    tau_j z_j' = x - z_j,    c = c0 + c1 x + c2 x^2,    v = u, or  tau_e v' = u - v  behind an electrode

Fourteen parameters (fifteen with the electrode) by least squares on free runs: RK4 with at most 0.35 rad of the
resonance a step, voltage linear between samples, the electrode exact, the Jacobian by forward mode. What must be
positive is searched as its logarithm.
"""

import sys
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from .grid import batch, make_grid

BRANCHES = 3
SHARES = (0.03, 0.3)  # of the stiffness, in each branch at the start


def start(nominal, grid, duration: float, share: float) -> np.ndarray:
    """Nominal pair as m, c0, k1; branches of a share of k1, times log-spaced; units of omega0 and the grid's scales."""
    root = pair(nominal)
    omega = abs(root)
    stiff = float(nominal.physical_coefficients[0]) * grid.metres / grid.volts**2
    mass, damping = stiff, max(-2 * root.real / omega, 0.02) * stiff
    taus = np.geomspace(2.0, 0.5 * duration * omega, BRANCHES)
    logs = np.log(np.concatenate([[mass, damping, stiff], np.full(BRANCHES, share * stiff), taus, [0.05]]))
    return np.concatenate([logs, np.zeros(5)])  # ..., log tau_e; c1, c2, k2, k3, b


def film(u, rate, dt: float):
    """Lagged voltage at the beginning, middle and end of every step, exactly, from an uncharged film; (K, 3)."""

    def advance(v, ends):
        first, last = ends
        slope = (last - first) / (rate * dt)
        settled = first - slope - v  # v(s) = u(s) - slope - settled exp(-rate s)
        middle = (first + last) / 2 - slope - settled * jnp.exp(-rate * dt / 2)
        after = last - slope - settled * jnp.exp(-rate * dt)
        return after, jnp.stack([v, middle, after])

    return jax.lax.scan(advance, jnp.zeros((), u.dtype), (u[:-1], u[1:]), unroll=4)[1]


def free_run(p, u, dt: float, electrode: bool):
    """Scaled displacement under a scaled voltage (K + 1,), dt in units of 1 / omega0, from rest."""
    mass, c0, k1 = jnp.exp(p[0]), jnp.exp(p[1]), jnp.exp(p[2])
    gains, rates = jnp.exp(p[3:6]), jnp.exp(-p[6:9])
    c1, c2, k2, k3, b = p[10:]
    direct = jnp.stack([u[:-1], (u[:-1] + u[1:]) / 2, u[1:]], -1)
    pull = (film(u, jnp.exp(-p[9]), dt) if electrode else direct) ** 2

    def slope(s, force):
        x, speed, branch = s[0], s[1], s[2:]
        damping = c0 + x * (c1 + x * c2)
        spring = x * (k1 + x * (k2 + x * k3)) + gains @ (x - branch)
        rise = (force * (1 + b * x) - damping * speed - spring) / mass
        return jnp.concatenate([jnp.stack([speed, rise]), rates * (x - branch)])

    def advance(s, force):
        a = slope(s, force[0])
        c = slope(s + dt / 2 * a, force[1])
        d = slope(s + dt / 2 * c, force[1])
        e = slope(s + dt * d, force[2])
        s = s + dt / 6 * (a + 2 * c + 2 * d + e)
        return s, s[0]

    start = jnp.zeros(2 + BRANCHES, u.dtype)
    return jnp.append(start[0], jax.lax.scan(advance, start, pull, unroll=4)[1])


def pair(nominal) -> complex:
    """The nominal pole nearest zero, 1/s: the resonance."""
    roots = np.roots(nominal.physical_coefficients[::-1])
    return roots[np.argmin(np.abs(roots))]


def hop(p, generator) -> np.ndarray:
    """A start near p: logarithms and the scaled polynomial terms alike."""
    return p + 0.3 * generator.standard_normal(len(p))


def search(p0, u, x, run, seconds: float):
    """Trust-region least squares of `run(p, u)` on targets x (R, K), relative to their ranges, within a time."""
    weight, began = 1 / np.ptp(x, axis=1, keepdims=True), time.monotonic()
    value, slopes = jax.jit(run), jax.jit(jax.jacfwd(run))

    def residual(p):
        left = (np.asarray(value(jnp.asarray(p, jnp.float32), u), np.float64) - x) * weight
        return np.where(np.isfinite(left) & (np.abs(left) < 1e3), left, 1e3).ravel()

    def jacobian(p):
        found = np.asarray(slopes(jnp.asarray(p, jnp.float32), u), np.float64) * weight[..., None]
        return np.nan_to_num(found, posinf=0.0, neginf=0.0).reshape(-1, len(p))

    def stop(intermediate_result):
        if time.monotonic() - began > seconds:
            raise StopIteration

    found = least_squares(residual, p0, jac=jacobian, x_scale=1.0, max_nfev=150, ftol=1e-7, callback=stop)
    error = 100 * (2 * found.cost / x.size) ** 0.5
    print(f"  {len(x)} records, {time.monotonic() - began:.0f} s: {error:.3f} %", file=sys.stderr)
    return found


def fit(nominal, records, seconds, key, *, electrode=False):
    """From weak and from strong branches, then from around the best so far, as the time allows: minima are many."""
    began, omega, coarse = time.monotonic(), abs(pair(nominal)), make_grid(nominal, records)
    stride = int(np.clip(0.35 / (omega * records[0].dt), 1, coarse.stride))
    stride = max(s for s in range(1, stride + 1) if coarse.stride % s == 0)
    grid = replace(coarse, stride=stride, dt=stride * records[0].dt)
    every = coarse.stride // stride
    inputs, x, _ = batch(grid, records)
    u, x = jnp.concatenate([inputs[..., 0], inputs[:, -1:, 2]], 1), x[:, ::every].astype(np.float64)
    run = jax.vmap(lambda p, u: free_run(p, u, grid.dt * omega, electrode)[::every], in_axes=(None, 0))
    length = x.shape[1] * every * grid.dt
    best, spent, tries = None, 0.0, 0
    generator = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    while spent < 0.8 * seconds:
        p0 = start(nominal, grid, length, SHARES[tries]) if tries < len(SHARES) else hop(best.x, generator)
        found = search(p0, u, x, run, seconds - spent)
        best = found if best is None or found.cost < best.cost else best
        spent, tries = time.monotonic() - began, tries + 1
    p = jnp.asarray(best.x, jnp.float32)
    single = jax.jit(lambda u: free_run(p, u, grid.dt * omega, electrode))

    def predict(record):
        x = np.asarray(single(jnp.asarray(grid.voltage(record), jnp.float32)), np.float64)
        return grid.restore(record, np.where(np.abs(x) < 1e3, x, np.nan))

    return predict
