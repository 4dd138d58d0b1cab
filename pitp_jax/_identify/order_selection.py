"""One identified order in physical units, and the choice among orders.

    a_i = |unit / gain| c_i / (c_0 omega^i)

Standard errors follow from the Jacobian of that and the covariance of `output_error`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._errors import ComputationFailed
from .._model.model import Hold
from .._record.initial_state import noise_std
from .._record.record import Record
from .._shown import Shown
from .linear_ode import polynomial, polynomial_slopes
from .output_error import OutputError, covariance, residual

# auto takes the smallest order >= 2 (a moving mass is second order, even where the nonlinearity hides it: on the
# Peano-HASEL orders 1 and 2 are within 2 %) whose mean absolute error is within 10 % of the best.
AUTO_TOLERANCE = 1.1


@dataclass(frozen=True, repr=False)
class OrderFit(Shown):
    """One identified order.

    Attributes:
        order: n.
        hold: how the voltage was taken between samples.
        coefficients, stderr: a_0 ... a_n in V^2 s^i / m (V s^i / m for a linear input) and their standard errors,
            robust to correlated residuals (block sandwich), the error of an offset taken from rest included.
        correlation: of those errors, shape (n + 1, n + 1).
        mae, rms: mean absolute and root mean square error of the free run over observed samples, m (paper, III-D).
        bic: T log(rms^2) + p log T, with T observed samples and p parameters; lower is better.
        natural_hz, damping: of every real pole and pole pair, ascending in frequency.
        offset, polarity: the sensor's zero (m) and direction (+1 or -1).
        converged: the least squares met its tolerance, and no lower order leaves less.
        delay, delay_stderr: of the drive in s, where one was fitted.
        identifiable: converged, every pole lies below the Nyquist frequency, and the logarithm of every pole
            coefficient is known to better than +-3 (a strong nonlinearity inflates the errors of a perfectly good
            linear fit; poles that no data see are open by hundreds).
    """

    order: int
    hold: Hold
    coefficients: np.ndarray
    stderr: np.ndarray
    correlation: np.ndarray
    mae: float
    rms: float
    bic: float
    natural_hz: np.ndarray
    damping: np.ndarray
    offset: float
    polarity: float
    converged: bool
    identifiable: bool
    delay: float = 0.0
    delay_stderr: float = 0.0


@dataclass(frozen=True)
class Fit:
    """Parameters of one order in normalised units; `cost` is the mean squared normalised error."""

    params: np.ndarray
    order: int
    hold: Hold
    cost: float
    converged: bool


def describe(fit: Fit, problem: OutputError) -> OrderFit:
    """Physical coefficients, their errors, and the figures orders are compared by."""
    n = fit.order
    left = residual(fit.params, problem, order=n, hold=fit.hold) * problem.output_scale
    samples = float(problem.weight.sum())
    spread = covariance(fit.params, problem, order=n, hold=fit.hold)
    coefficients, jacobian = _physical(fit.params[: n + 1], problem)
    roots = np.roots(polynomial(fit.params[:n])[::-1]) * problem.omega
    upper = sorted(roots[roots.imag >= 0], key=abs)
    of_coefficients = jacobian @ spread[: n + 1, : n + 1] @ jacobian.T
    stderr = np.sqrt(np.clip(np.diag(of_coefficients), 0, None))
    known = np.sqrt(np.clip(np.diag(spread)[: n + 1], 0, None))
    known[n] /= abs(fit.params[n])
    rms = float(np.sqrt((left**2).sum() / samples))
    delay = float(np.exp(fit.params[-1])) * problem.dt if problem.delayed else 0.0
    return OrderFit(
        order=n,
        hold=fit.hold,
        coefficients=coefficients,
        stderr=stderr,
        correlation=of_coefficients / np.maximum(np.outer(stderr, stderr), 1e-300),
        mae=float(np.abs(left).sum() / samples),
        rms=rms,
        bic=float(samples * np.log(rms**2) + len(fit.params) * np.log(samples)),
        natural_hz=np.array([abs(r) / (2 * np.pi) for r in upper]),
        damping=np.array([-r.real / abs(r) for r in upper]),
        offset=float(problem.zero(problem.main, fit.params, n)),
        polarity=float(np.sign(fit.params[n]) or 1.0),
        converged=bool(fit.converged),
        identifiable=bool(fit.converged and (known < 3.0).all() and np.abs(roots).max() * problem.dt < np.pi),
        delay=delay,
        delay_stderr=delay * float(np.sqrt(max(spread[-1, -1], 0.0))) if problem.delayed else 0.0,
    )


def _physical(params: np.ndarray, problem: OutputError) -> tuple[np.ndarray, np.ndarray]:
    """a_i = |unit / gain| c_i / (c_0 omega^i) from the logarithms and the gain, and the Jacobian."""
    logs, gain = params[:-1], params[-1]
    unit = problem.voltage_scale ** (2 if problem.square else 1) / problem.output_scale
    poly, slopes = polynomial(logs), polynomial_slopes(logs)
    a = abs(unit / gain) * poly / poly[0] / problem.omega ** np.arange(len(poly))
    relative = np.concatenate([slopes / poly[:, None] - slopes[0] / poly[0], np.full((len(poly), 1), -1 / gain)], 1)
    return a, a[:, None] * relative


def choose(described: list[OrderFit], order) -> OrderFit:
    """The asked order, or the smallest that is about as good as the best.

    Raises:
        ComputationFailed: it is not among them, or none can be identified.
    """
    if order != "auto":
        found = [d for d in described if d.order == int(order)]
        if not found:
            raise ComputationFailed(f"order {order} could not be simulated on these records; try --order auto")
        return found[0]
    usable = [d for d in described if d.identifiable]
    if not usable:
        raise ComputationFailed(
            "no order from 1 to 6 can be identified from these records: record a sweep through the resonance, "
            "or check that the voltage and displacement columns belong together"
        )
    inertial = [d for d in usable if d.order >= 2]
    best = min(d.mae for d in inertial or usable)
    return next(d for d in inertial or usable if d.mae <= AUTO_TOLERANCE * best)


def advice(chosen: OrderFit, described: list[OrderFit]) -> str:
    """Why the asked order was refused, and what to do."""
    good = [str(d.order) for d in described if d.identifiable]
    why = "its poles are not determined by the data" if chosen.converged else "the least squares ran away"
    hint = f"orders that are: {', '.join(good)}" if good else "no lower order is either"
    where = f"order {chosen.order} cannot be identified from these records ({why})"
    return f"{where}; {hint}; record a sweep or use --order auto"


def summary(chosen: OrderFit, orders: Sequence[OrderFit], records: Sequence[Record]) -> dict:
    """The identification as plain numbers, for model files and `pitp info`."""
    noise = float(np.median([noise_std(r.displacement) for r in records]))
    rows = [{k: (v.tolist() if isinstance(v, np.ndarray) else v) for k, v in vars(f).items()} for f in orders]
    return {
        "order": chosen.order,
        "hold": chosen.hold,
        "noise_std": noise,
        "records": [r.name for r in records],
        "orders": rows,
    }
