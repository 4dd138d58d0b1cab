"""Identification of order 2 on a 30 s sweep of a virtual cone, beside SciPy least squares on the same output error.

minimise over log a and the rest position:  sum_t (x(t; a) - x_measured(t))^2,   a_0 x + a_1 x' + a_2 x'' = u^2
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

import pitp_jax as pitp
from pitp_jax._demo import protocol

from ..clock import row, take_turns


def sweep():
    """The quick protocol's sweep, measured on the virtual cone."""
    return protocol.measure(pitp.plant("cone100"), protocol.excitations("cone100", "sweep", True))[0]


def by_scipy(record, near: np.ndarray) -> np.ndarray:
    """Displacement of the fit, started 10 % from the answer: from 30 % it ends in a local minimum (12 %)."""
    force, x = record.voltage**2, record.displacement
    size = np.ptp(x)

    def respond(p):
        a = np.exp(p[:3])
        b, c, _ = cont2discrete(([1.0], a[::-1]), record.dt, method="foh")
        return lfilter(b.ravel(), c, force) / size + p[3]

    start = np.append(np.log(near * 1.1), 0.0)
    return size * respond(least_squares(lambda p: respond(p) - x / size, start).x)


def measure(seconds: float) -> dict:
    """Times, and what either fit left of the record."""
    record, fits = sweep(), {}
    near = pitp.identify([record], order=2).model.physical_coefficients

    def ours():
        fits["pitp_jax"] = pitp.identify([record], order=2).model

    def scipy():
        fits["SciPy least_squares"] = by_scipy(record, near)

    found = take_turns({"pitp_jax": ours, "SciPy least_squares": scipy}, seconds)
    free_run = pitp.predict(fits["pitp_jax"], [record])[0].displacement
    errors = {"pitp_jax": pitp.e_rms_percent(free_run, record.displacement),
              "SciPy least_squares": pitp.e_rms_percent(fits["SciPy least_squares"], record.displacement)}  # fmt: skip
    return row(found, "pitp_jax", "SciPy least_squares", samples=record.samples, e_rms_percent=errors)
