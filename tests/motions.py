"""Targets with forces in closed form, and what an independent integration makes of a voltage."""

import numpy as np
from scipy.linalg import expm

from pitp_jax import Target

DT, SAMPLES = 1e-3, 1000
TIME = np.arange(SAMPLES) * DT
HIGH, SLEW = 2000.0, 5e4


def swing(mid, amplitude, hz, phase=0.0, time=TIME):
    return mid + amplitude * np.sin(2 * np.pi * hz * time + phase)


def swing_force(model, mid, amplitude, hz, phase=0.0):
    """Force of `swing` in V^2, in closed form: a_0 mid + Im(amplitude sum_i a_i (j w)^i e^(j(w t + phase)))."""
    a, w = model.physical_coefficients, 2 * np.pi * hz
    return a[0] * mid + amplitude * np.imag(np.polyval(a[::-1], 1j * w) * np.exp(1j * (w * TIME + phase)))


def hump(dt=DT, top=1e-3, hz=2.0, seconds=1.0):
    """Humps of sin^4: three derivatives start at zero."""
    time = np.arange(round(seconds / dt) + 1) * dt
    return Target(time, top * np.sin(np.pi * hz * time) ** 4)


def respond(model, voltage, dt=DT, finer=8):
    """States [x, x'] of the linear ODE of order 2 from rest: exact steps of dt / 8 under the linear voltage."""
    a0, a1, a2 = model.physical_coefficients
    chained = np.array([[0, 1, 0, 0], [-a0 / a2, -a1 / a2, 1 / a2, 0], [0, 0, 0, finer / dt], [0, 0, 0, 0]])
    exact = expm(chained * dt / finer)
    fine = np.interp(np.arange((len(voltage) - 1) * finer + 1) / finer, np.arange(len(voltage)), voltage)
    force = np.asarray(model.input_map.force(fine))
    states = np.zeros((len(force), 2))
    for k in range(len(force) - 1):
        now = np.array([*states[k], force[k], force[k + 1] - force[k]])
        states[k + 1] = exact[:2] @ now
    return states[::finer]
