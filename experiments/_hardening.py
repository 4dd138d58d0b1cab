"""A simulated actuator with a hardening spring and a delay, shared by the scripts that plant a known difference.

x'' + 2 zeta w x' + w^2 k (x + h x^3) = w^2 g u(t - d)^2,    y = x + noise of 0.1 % of range
"""

from dataclasses import dataclass

import numpy as np

import pitp_jax as pitp

TOP, UNIT, DT, FINER = 2000.0, 1e-3, 4e-3, 8  # V, m, s, steps of the simulation in a sample


@dataclass(frozen=True)
class Plant:
    """Numbers of one actuator: natural frequency (rad/s) and factors of its parts; `delay` in s."""

    omega: float
    zeta: float
    hardening: float = 0.0
    stiffness: float = 1.0
    damping: float = 1.0
    gain: float = 1.0
    delay: float = 0.0


def sweep(seconds: float = 20.0, last: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and voltage (V) of a sweep from 0.3 Hz."""
    t = np.arange(round(seconds / DT)) * DT
    return t, TOP * 0.4 * (1 - np.cos(2 * np.pi * (0.3 * t + (last - 0.3) / 2 / seconds * t**2)))


def sine(hz: float, size: float, seconds: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and voltage (V) of a raised sine."""
    t = np.arange(round(seconds / DT)) * DT
    return t, np.minimum(t / 0.5, 1.0) * TOP * size / 2 * (1 - np.cos(2 * np.pi * hz * t))


def record(plant: Plant, name: str, drive: tuple[np.ndarray, np.ndarray], rng) -> pitp.Record:
    """The recording of an input from rest: RK4, the voltage linear between samples."""
    t, u = drive
    h, w = DT / FINER, plant.omega
    half = np.interp(np.arange(2 * FINER * len(t) + 1) * h / 2 - plant.delay, t, u, left=0.0) / TOP
    force = plant.gain * half**2

    def acceleration(x, v, f):
        spring = plant.stiffness * (x + plant.hardening * x**3)
        return w * w * (f - spring) - 2 * plant.zeta * plant.damping * w * v

    x, v, out = 0.0, 0.0, np.empty(len(t))
    for k in range(len(t)):
        out[k] = x
        for j in range(2 * k * FINER, 2 * (k + 1) * FINER, 2):
            f0, f1, f2 = force[j : j + 3]
            b1 = acceleration(x, v, f0)
            v2 = v + h / 2 * b1
            b2 = acceleration(x + h / 2 * v, v2, f1)
            v3 = v + h / 2 * b2
            b3 = acceleration(x + h / 2 * v2, v3, f1)
            v4 = v + h * b3
            b4 = acceleration(x + h * v3, v4, f2)
            x, v = x + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
    return pitp.Record(name, t, u, UNIT * (out + 1e-3 * np.ptp(out) * rng.standard_normal(len(t))))
