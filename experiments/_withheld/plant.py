"""The plants of the withheld check: healthy in closed form, with effects by fixed Runge-Kutta steps in float64.

    x'' = F - x - 2 zeta x',  F = u^2,  u linear between samples,  x(0) = x'(0) = 0         (time in 1/w0, x in X)
    x   = Im z / wd,  z' = lambda z + F,  lambda = -zeta + i wd,  wd = sqrt(1 - zeta^2)     (F quadratic in a sample)

The steps of classical RK4 end on every sample, so none crosses a kink of u; their number follows the stiffest form.
Nonsmooth effects are regularised steeply in their forms. Against diffrax (Dopri8, rtol 1e-9, jumps at the samples) all
forms of a roll stay within 1e-7 of the range, contact, stops and slew limits within 5e-6, Stribeck's within 3e-5.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter


def healthy(u: np.ndarray, step: float, zeta: float) -> np.ndarray:
    """Exact displacement of the healthy plant.

    Args:
        u: voltage in U, shape (..., T).
        step: sampling interval in 1/w0.
        zeta: damping ratio, below 1.

    Returns:
        (x, x') in X and X w0, shape (2, ..., T).
    """
    wd = math.sqrt(1.0 - zeta**2)
    lam = complex(-zeta, wd)
    u0, rise = u[..., :-1], np.diff(u, axis=-1)
    grown = np.exp(lam * step)
    # integral over the sample of exp(lam (h - s)) (s/h)^k ds for k = 0, 1, 2, by parts
    i0 = (grown - 1.0) / lam
    i1 = (i0 / step - 1.0) / lam
    i2 = (2.0 * i1 / step - 1.0) / lam
    gain = i0 * u0**2 + i1 * 2.0 * u0 * rise + i2 * rise**2
    z = lfilter([1.0], [1.0, -grown], np.concatenate([np.zeros((*u.shape[:-1], 1)), gain], axis=-1), axis=-1)
    return np.stack([z.imag / wd, (lam * z).imag / wd])


def substeps(forms, step: float) -> int:
    """Runge-Kutta steps per sample of `step` (1/w0)."""
    return max(1, math.ceil(step * max([30.0] + [f.stiff for f in forms])))


def rate(forms, ps, cs, zeta, y, u, push, t):
    """Rate of one state (x, x', s...) in 1/w0 under the voltage u and a disturbing force, at the session time t (s)."""
    x, v, parts, extra, k = y[0], y[1], [], [], 2
    for f, p, c in zip(forms, ps, cs, strict=True):
        parts.append((f, p, c, tuple(y[k + j] for j in range(f.states))))
        k += f.states
    film = u
    for f, p, c, s in parts:
        extra += [jnp.asarray(r, y.dtype) for r in f.rates(p, c, film, x, v, s)]
        film = f.drive(p, c, film, s)
    force, mass = film**2, 1.0
    for f, p, c, _ in parts:
        force = f.coupling(p, c, force, x)
    force = force + push - x - 2.0 * zeta * v
    for f, p, c, s in parts:
        force, mass = force - f.force(p, c, x, v, s, t), mass * f.inertia(p, c)
    a = force / mass
    for f, p, c, _ in parts:
        a = f.limit(p, c, a)
    return jnp.stack([v, a, *extra])


def _ends(u, forms, ps, cs, step, count):
    """Drive at both ends of every step, shape (T - 1, count, 2), delayed by whole steps; zero before the record."""
    part = jnp.arange(count + 1) / count
    nodes = u[:-1, None] + jnp.diff(u)[:, None] * part
    flat = jnp.stack([nodes[:, :-1], nodes[:, 1:]], axis=-1).reshape(-1, 2)
    lag = sum(f.delay(p, c) for f, p, c in zip(forms, ps, cs, strict=True) if f.delay)
    index = jnp.arange(len(flat)) - jnp.round(lag * count / step).astype(int)
    return jnp.where(index[:, None] >= 0, flat[jnp.maximum(index, 0)], 0.0).reshape(-1, count, 2)


def _advance(f, y, h, first, last):
    """One classical Runge-Kutta step; `first` and `last` are (u, push, t) at its ends."""
    middle = tuple((a + b) / 2 for a, b in zip(first, last, strict=True))
    k1 = f(y, *first)
    k2 = f(y + h / 2 * k1, *middle)
    k3 = f(y + h / 2 * k2, *middle)
    k4 = f(y + h * k3, *last)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _march(forms, count, ps, cs, plant, inputs, start):
    """States of one record from `start`, shape (T, 2 + states)."""
    zeta, step, seconds = plant["zeta"], plant["step"], plant["seconds"]
    f, u = partial(rate, forms, ps, cs, zeta), inputs["u"]
    for p, gate in zip(ps, inputs["gate"], strict=True):
        u = u if gate is None else (1.0 - p * gate) * u
    push = sum(p * d for p, d in zip(ps, inputs["push"], strict=True) if d is not None) + jnp.zeros_like(u)
    delayed = any(f.delay for f in forms)
    pieces = _ends(u, forms, ps, cs, step, count) if delayed else (u[:-1], u[1:])

    def sample(y, now):
        drive, d0, d1, t = now

        def body(k, y):
            a, b = k / count, (k + 1) / count
            u0, u1 = drive[k] if delayed else (drive[0] + part * (drive[1] - drive[0]) for part in (a, b))
            first, last = (u0, d0 + a * (d1 - d0), t + a * seconds), (u1, d0 + b * (d1 - d0), t + b * seconds)
            return _advance(f, y, step / count, first, last)

        y = jax.lax.fori_loop(0, count, body, y, unroll=count <= 2)
        return y, y

    times = inputs["clock"] + seconds * jnp.arange(len(u) - 1)
    path = jax.lax.scan(sample, start, (pieces, push[:-1], push[1:], times))[1]
    return jnp.concatenate([start[None], path])


def _session(forms, count, ps, cs, plant, inputs):
    """States of every record, shape (R, T, 2 + states): all from rest, but for states that last through the session."""
    lasts = jnp.array([0.0, 0.0, *(float(f.lasts) for f in forms for _ in range(f.states))])
    march = partial(_march, forms, count, ps, cs, plant)
    if not any(f.lasts for f in forms):
        return jax.vmap(march, (0, None))(inputs, jnp.zeros_like(lasts))

    def record(start, one):
        path = march(one, start)
        return lasts * path[-1], path

    return jax.lax.scan(record, jnp.zeros_like(lasts), inputs)[1]


def _observe(forms, ps, cs, path, add):
    """Output of one record from its states (T, 2 + states)."""
    y, k = path[:, 0], 2
    for f, p, c, d in zip(forms, ps, cs, add, strict=True):
        y = f.sensor(p, c, y, tuple(path[:, k + j] for j in range(f.states)))
        y = y if d is None else y + p * d
        k += f.states
    return y


@partial(jax.jit, static_argnames=("forms", "count"))
def _outputs(forms, count, ps, cs, plant, inputs):
    def one(ps):
        paths = _session(forms, count, ps, cs, plant, inputs)
        return jax.vmap(partial(_observe, forms, ps, cs))(paths, inputs["add"])

    return jax.vmap(one)(ps)


@partial(jax.jit, static_argnames=("forms", "count"))
def _missing(forms, count, ps, cs, plant, inputs):
    def one(path, inputs):
        u = inputs["u"]
        t = inputs["clock"] + plant["seconds"] * jnp.arange(len(u))
        rates = jax.vmap(partial(rate, forms, ps, cs, plant["zeta"]))(path, u, jnp.zeros_like(u), t)
        x, v = path[:, 0], path[:, 1]
        return rates[:, 1] + 2.0 * plant["zeta"] * v + x - u**2

    return jax.vmap(one)(_session(forms, count, ps, cs, plant, inputs), inputs)


def outputs(forms, ps, cs, plant, inputs) -> np.ndarray:
    """Noise-free outputs in X of every record under every strength.

    Args:
        forms: the effects present (`form.Form`), () for the healthy plant.
        ps: strengths, shape (S, effects).
        cs: other constants of each form.
        plant: `zeta`, `step` (sampling interval in 1/w0) and `seconds` (the same in s).
        inputs: `u` (R, T) in U, `clock` (R,) in s, and `push`, `gate`, `add`: per form None or (R, T).

    Returns:
        y, shape (S, R, T); nan or huge where the motion ran away.
    """
    with jax.enable_x64(True):
        y = _outputs(tuple(forms), substeps(forms, plant["step"]), *_floats((jnp.asarray(ps), cs, plant, inputs)))
        return np.asarray(y)


def missing(forms, ps, cs, plant, inputs) -> np.ndarray:
    """What the healthy equation lacks, x'' + 2 zeta x' + x - u^2 along the motion with effects, shape (R, T)."""
    with jax.enable_x64(True):
        out = _missing(tuple(forms), substeps(forms, plant["step"]), *_floats((jnp.asarray(ps), cs, plant, inputs)))
        return np.asarray(out)


def _floats(tree):
    """Numbers as float64 arrays, so that another seed is no other compilation."""
    return jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), tree)
