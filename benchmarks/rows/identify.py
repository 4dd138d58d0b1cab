"""One fit of order 2 on a 30 s sweep of a virtual cone, beside SciPy and optimistix on the same output error.

minimise over log a and the rest position:  sum_t (x(t; a) - x_measured(t))^2,   a_0 x + a_1 x' + a_2 x'' = u^2

One order, hold and delay, all from the same start; what `identify` searches beside that is the row `identify_search`.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from scipy import optimize
from scipy.signal import cont2discrete, lfilter

import pitp_jax as pitp
from pitp_jax.application.demo import protocol
from pitp_jax.method.identify.linear_ode import logs_from_roots
from pitp_jax.method.identify.output_error import OutputError, Structure, build_problem, least_squares
from pitp_jax.method.signal.initial_state import Beginning

from ..clock import row, take_turns
from ..sizes import size

START = np.array([1.1, 1.1, 1.0])  # of a_0, a_1, a_2: from 1.3 SciPy ends in a local minimum (12 %)


def sweep():
    """The quick protocol's sweep, measured on the virtual cone."""
    whole = protocol.measure(pitp.plant("cone100"), protocol.excitations("cone100", "sweep", True))[0]
    kept = slice(0, size(None, 20_000))
    return replace(whole, time=whole.time[kept], voltage=whole.voltage[kept], displacement=whole.displacement[kept])


def by_projection(record, near: np.ndarray) -> np.ndarray:
    """The package's fit from the same start: gain and rest position are solved for at every pair of poles."""
    problem = build_problem([record], "square", [Beginning("rest", 1.0, 0.0, np.inf, free=True)])
    structure = Structure(2)
    params = least_squares(logs_from_roots(np.roots((near * START)[::-1])), structure, problem).params
    residual = OutputError(params, structure, problem).solved.residuals[0]
    return record.displacement - problem.scale * residual


def by_scipy(record, near: np.ndarray) -> np.ndarray:
    """Displacement of the fit."""
    force, x = record.voltage**2, record.displacement
    size = np.ptp(x)

    def respond(p):
        a = np.exp(p[:3])
        w = np.sqrt(a[0] / a[2])  # time in 1 / w and a static gain of one: else rounding stops the fit early
        poly = [1.0, a[1] * w / a[0], 1.0]
        b, c, _ = cont2discrete(([1.0], poly), w * record.dt, method="foh")
        return lfilter(b.ravel(), c, force) / (a[0] * size) + p[3]

    start = np.append(np.log(near * START), 0.0)
    return size * respond(optimize.least_squares(lambda p: respond(p) - x / size, start, x_scale="jac", method="lm").x)


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
        start = np.append(np.log(near * START * size / force), 0.0)
        run = _by_levenberg_marquardt(float(record.dt))
        return size * np.asarray(run(record.voltage**2 / force, record.displacement / size, start))


def measure(seconds: float) -> dict:
    """Times, and what every fit left of the record."""
    record, fits = sweep(), {}
    near = pitp.identify([record], order=2).model.physical_coefficients

    def way(name, fit):
        def run():
            fits[name] = fit(record, near)

        return name, run

    ways = dict([way("pitp_jax", by_projection), way("SciPy least_squares", by_scipy),
                 way("optimistix, compiled", by_optimistix)])  # fmt: skip
    found = take_turns(ways, seconds)
    errors = {name: pitp.e_rms_percent(run, record.displacement) for name, run in fits.items()}
    return row(found, "pitp_jax", "SciPy least_squares", samples=record.samples, e_rms_percent=errors)
