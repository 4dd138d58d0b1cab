"""Identification of order 2 on a 30 s sweep of a virtual cone, beside SciPy and optimistix on the same output error.

minimise over log a and the rest position:  sum_t (x(t; a) - x_measured(t))^2,   a_0 x + a_1 x' + a_2 x'' = u^2
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

import pitp_jax as pitp
from pitp_jax._demo import protocol

from ..clock import row, take_turns
from ..sizes import size


def sweep():
    """The quick protocol's sweep, measured on the virtual cone."""
    whole = protocol.measure(pitp.plant("cone100"), protocol.excitations("cone100", "sweep", True))[0]
    kept = slice(0, size(None, 20_000))
    return replace(whole, time=whole.time[kept], voltage=whole.voltage[kept], displacement=whole.displacement[kept])


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


@cache
def _by_levenberg_marquardt(dt: float):
    """One program: the exact first-order-hold response as a scan, its slopes by forward mode, optimistix around it."""

    def respond(p, force):
        a = jnp.exp(p[:3])
        ode = jnp.array([[0.0, 1.0, 0.0, 0.0], [-a[0], -a[1], 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0] * 4])
        ode = ode.at[1].divide(a[2])
        held = jax.scipy.linalg.expm(jnp.diag(jnp.array([1, 1, 1, 1 / dt])) @ ode @ jnp.diag(jnp.array([dt] * 4)))
        step, at, slope = held[:2, :2], held[:2, 2], held[:2, 3] / dt

        def one(x, pair):
            x = step @ x + at * pair[0] + slope * (pair[1] - pair[0])
            return x, x[0]

        pairs = jnp.stack([force[:-1], force[1:]], 1)
        return jnp.concatenate([jnp.zeros(1), jax.lax.scan(one, jnp.zeros(2), pairs)[1]]) + p[3]

    def solve(force, x, start):
        solver = optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
        found = optx.least_squares(
            lambda p, _: respond(p, force) - x, solver, start, options={"jac": "fwd"}, max_steps=200, throw=False
        )
        return respond(found.value, force)

    return jax.jit(solve)


def by_optimistix(record, near: np.ndarray) -> np.ndarray:
    """The same fit from the same start, everything in one compiled program in float64."""
    with jax.enable_x64(True):
        size, force = np.ptp(record.displacement), float(np.max(record.voltage) ** 2)
        start = np.append(np.log(near * 1.1 * size / force), 0.0)
        run = _by_levenberg_marquardt(float(record.dt))
        return size * np.asarray(run(record.voltage**2 / force, record.displacement / size, start))


def measure(seconds: float) -> dict:
    """Times, and what every fit left of the record."""
    record, fits = sweep(), {}
    near = pitp.identify([record], order=2).model.physical_coefficients

    def ours():
        fits["pitp_jax"] = pitp.identify([record], order=2).model

    def scipy():
        fits["SciPy least_squares"] = by_scipy(record, near)

    def optimistix():
        fits["optimistix"] = by_optimistix(record, near)

    ways = {"pitp_jax": ours, "SciPy least_squares": scipy, "optimistix, compiled": optimistix}
    found = take_turns(ways, seconds)
    fits["pitp_jax"] = pitp.predict(fits["pitp_jax"], [record])[0].displacement
    errors = {name: pitp.e_rms_percent(run, record.displacement) for name, run in fits.items()}
    return row(found, "pitp_jax", "SciPy least_squares", samples=record.samples, e_rms_percent=errors)
