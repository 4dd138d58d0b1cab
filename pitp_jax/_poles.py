"""Stable linear ODEs by construction, and their exact response to a sampled voltage.

    prod (s^2 + e^p s + e^q) [(s + e^r)]:  every p, q, r is stable, and every stable polynomial is reached

The response is exact for a voltage linear (foh) or constant (zoh) between samples, squared or not: inside a step
the force is a polynomial in time, so one matrix exponential of the chained system gives the step.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._recurrence import linear_recurrence


def polynomial(logs: Float[Array, " n"]) -> Float[Array, " n+1"]:
    """Ascending coefficients c_0 ... c_{n-1}, 1 of the factors whose coefficients have the logarithms `logs`."""
    poly = jnp.ones((1,), logs.dtype)
    one = jnp.ones((), logs.dtype)
    for k in range(0, len(logs) - 1, 2):
        poly = jnp.convolve(poly, jnp.stack([jnp.exp(logs[k + 1]), jnp.exp(logs[k]), one]))
    if len(logs) % 2:
        poly = jnp.convolve(poly, jnp.stack([jnp.exp(logs[-1]), one]))
    return poly


def logs_from_roots(roots: np.ndarray) -> np.ndarray:
    """Inverse of `polynomial`, after reflecting the roots into the stable half plane."""
    roots = np.asarray(roots, complex)
    size = np.maximum(np.abs(roots), 1e-4)
    roots = np.asarray(-np.maximum(np.abs(np.real(roots)), 1e-3 * size) + 1j * np.imag(roots))
    real_root = np.abs(np.imag(roots)) <= 1e-9 * size
    pairs = roots[~real_root & (np.imag(roots) > 0)]
    real = sorted(-np.real(roots[real_root]))
    logs = [v for r in pairs for v in (np.log(-2 * r.real), np.log(abs(r) ** 2))]
    while len(real) > 1:
        a, b = real.pop(0), real.pop(0)
        logs += [np.log(a + b), np.log(a * b)]
    return np.array(logs + [np.log(r) for r in real])


def respond(
    logs: Float[Array, " n"],
    drive: Float[Array, " time"],
    start: Float[Array, " n"],
    *,
    step: float | Float[Array, ""],
    square: bool,
    hold: str,
) -> Float[Array, " time"]:
    """Response with unit static gain to the force drive^2 (or drive), time in units where one sample lasts `step`."""
    poly = polynomial(logs)
    n = poly.shape[0] - 1
    block = jnp.zeros((n + 3, n + 3), poly.dtype)
    block = block.at[jnp.arange(n - 1), jnp.arange(1, n)].set(step)
    block = block.at[n - 1, :n].set(-step * poly[:n]).at[n - 1, n].set(step * poly[0])
    block = block.at[n, n + 1].set(1.0).at[n + 1, n + 2].set(1.0)  # F, F', F'' with time in samples
    exact = jax.scipy.linalg.expm(block)
    now = drive[:-1]
    change = jnp.diff(drive) if hold == "foh" else jnp.zeros_like(now)
    force = [now**2, 2 * now * change, 2 * change**2] if square else [now, change, jnp.zeros_like(now)]
    forced = jnp.concatenate([jnp.stack(force, -1) @ exact[:n, n:].T, jnp.zeros((1, n), poly.dtype)])
    return linear_recurrence(exact[:n, :n], forced, start)[:, 0]
