"""Hammerstein: a static map of u^2, then a linear ODE written as its modes.

    v = w + p_2 w^2 + p_3 w^3 + p_4 w^4,  w = u^2,      z_m' = s_m z_m + v,      x = sum_m g_m z_m

One oscillating pair (both phases) and three real modes, so creep is within reach. The gains are linear and are
solved for inside (variable projection); poles and map by least squares on free runs, the steps exact for a voltage
whose square runs linearly between samples.
"""

import time

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from .grid import filled, make_grid


def start(nominal, duration: float) -> np.ndarray:
    """Map coefficients 0, the nominal pair's log frequency and log damping, three log rates."""
    roots = np.roots(nominal.physical_coefficients[::-1])
    root = roots[np.argmin(np.abs(roots))]
    omega = abs(root)
    rates = np.log(np.geomspace(2 / duration, omega / 2, 3))
    return np.concatenate([np.zeros(3), [np.log(omega), np.log(max(-root.real / omega, 0.01))], rates])


def poles(p: np.ndarray) -> np.ndarray:
    """One pole of the pair, then the real ones, 1/s."""
    omega, damping = np.exp(p[3]), min(np.exp(p[4]), 0.999)
    return np.append(omega * (-damping + 1j * np.sqrt(1 - damping**2)), -np.exp(p[5:8]))


def modes(p: np.ndarray, w: np.ndarray, dt: float) -> np.ndarray:
    """Responses of every mode from rest, shape (5, ..., T), each over its own static size."""
    v = w * (1 + w * (p[0] + w * (p[1] + w * p[2])))
    columns = []
    for s in poles(p):
        x, e = s * dt, np.exp(s * dt)
        now, later = dt * ((e - 1) / x - (e - 1 - x) / x**2), dt * (e - 1 - x) / x**2
        first = -later * v[..., :1]
        z = lfilter([later, now], [1, -e], v, zi=first)[0] * abs(s)
        columns += [z.real, z.imag] if abs(s.imag) > 0 else [z.real]
    return np.stack(columns)


def fit(nominal, records, seconds, key):
    """Least squares over all records at once, every record weighted by its range."""
    grid, dt = make_grid(nominal, records), records[0].dt
    size = min(r.samples for r in records)
    w = np.stack([(r.voltage[:size] / grid.volts) ** 2 for r in records])
    x = np.stack([grid.output.to_model(filled(r))[:size] / grid.metres for r in records])[:, :: grid.stride]
    weight = 1 / np.ptp(x, axis=1, keepdims=True)
    best, began = [np.inf, None, None], time.monotonic()

    def residual(p):
        basis = (modes(p, w, dt)[..., :: grid.stride] * weight).reshape(5, -1).T
        gains = np.linalg.lstsq(basis, (x * weight).ravel(), rcond=None)[0]
        left = basis @ gains - (x * weight).ravel()
        if left @ left < best[0]:
            best[:] = left @ left, p.copy(), gains
        return left

    def stop(intermediate_result):
        if time.monotonic() - began > seconds:
            raise StopIteration

    p0 = start(nominal, size * dt)
    low, high = np.full(8, -5.0), np.full(8, 5.0)
    low[3:], high[3:] = p0[3:] - 4, p0[3:] + 4
    least_squares(residual, p0, bounds=(low, high), x_scale=1.0, max_nfev=200, callback=stop)
    _, p, gains = best

    def predict(record):
        z = modes(p, (record.voltage / grid.volts) ** 2, record.dt)
        return grid.output.to_rig(grid.metres * gains @ z)

    return predict
