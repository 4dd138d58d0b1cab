"""Identification (the paper's tfest step): a continuous-time ODE of order n, no zeros, fitted by output error.

    F = map(u),    sum_{i=0}^{n} a_i x^(i) = F,    y = polarity x + offset + noise

    minimise  sum over observed samples of (y - y_model)^2     (Levenberg-Marquardt, whole records, float64)

Starts come from the equation error, from the spectrum's peak and from the next lower order plus a fast pole: order 3
by plain output error diverges from a bad start. Poles are stable by construction (`_poles`).
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ._errors import BadInput, ComputationFailed
from ._levenberg import minimise
from ._model.input_map import INPUT_MAPS
from ._model.model import Hold, Model, Output, Provenance, linear_model
from ._output_error import OutputError, build_problem, covariance, fastest_logs, normal_equations, residual
from ._poles import polynomial, polynomial_slopes
from ._polish import polish
from ._record.record import Record
from ._record.sweeps import is_sweep as is_sweep
from ._rest import noise_std
from ._starts import equation_error_roots, linear_start, peak_roots

ORDERS = tuple(range(1, 7))
# auto takes the smallest order >= 2 (a moving mass is second order, even where the nonlinearity hides it: on the
# Peano-HASEL orders 1 and 2 are within 2 %) whose mean absolute error is within 10 % of the best.
AUTO_TOLERANCE = 1.1
# Other holds than foh, and the share of its error each has to beat: a wrong one costs little, a right one more later
_HOLDS: dict[Hold, float] = {"zoh": 0.98, "bandlimited": 0.997}
_NO_WORSE = 1.001  # an order holds every lower one, so its cost is no higher unless the search stopped short


@dataclass(frozen=True)
class OrderFit:
    """One identified order.

    Attributes:
        order: n.
        hold: how the voltage was taken between samples.
        coefficients, stderr: a_0 ... a_n in V^2 s^i / m (V s^i / m for a linear input) and their standard errors,
            robust to correlated residuals (block sandwich), the error of an offset taken from rest included.
        mae, rms: mean absolute and root mean square error of the free run over observed samples, m (paper, III-D).
        bic: T log(rms^2) + p log T, with T observed samples and p parameters; lower is better.
        natural_hz, damping: of every real pole and pole pair, ascending in frequency.
        offset, polarity: the sensor's zero (m) and direction (+1 or -1).
        converged: the least squares met its tolerance, and no lower order leaves less.
        identifiable: converged, every pole lies below the Nyquist frequency, and the logarithm of every pole
            coefficient is known to better than +-3 (a strong nonlinearity inflates the errors of a perfectly good
            linear fit; poles that no data see are open by hundreds).
    """

    order: int
    hold: Hold
    coefficients: np.ndarray
    stderr: np.ndarray
    mae: float
    rms: float
    bic: float
    natural_hz: np.ndarray
    damping: np.ndarray
    offset: float
    polarity: float
    converged: bool
    identifiable: bool


@dataclass(frozen=True)
class Identification:
    """The model of the chosen order, every order compared, and which records were found to start at rest."""

    model: Model
    chosen: OrderFit
    orders: tuple[OrderFit, ...]
    rest: dict[str, bool]


@dataclass(frozen=True)
class _Fit:
    """Parameters of one order in normalised units; `cost` is the mean squared normalised error."""

    params: np.ndarray
    order: int
    hold: Hold
    cost: float
    converged: bool


def identify(
    records: Sequence[Record],
    *,
    order: int | str = "auto",
    input_map: str = "square",
    hold: Hold | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> Identification:
    """Fit a linear ODE to records by output error.

    Args:
        records: recordings of one actuator (a sweep, or any set that excites it).
        order: 1 to 6, or "auto": the smallest order whose mean absolute error is within 10 % of the best.
        input_map: "square" (F = u^2) or "linear" (F = u).
        hold: "foh", "zoh", "bandlimited", or None for the one that leaves least error: foh unless zoh wins by 2 %
            or bandlimited by 0.3 %.
        progress: called with one line per finished order.

    Raises:
        BadInput: unknown order or input map, no variation in voltage or displacement.
        ComputationFailed: the asked order cannot be identified from these records.
    """
    if input_map not in INPUT_MAPS:
        raise BadInput(f"unknown input map {input_map!r}: use one of {', '.join(INPUT_MAPS)}")
    if order != "auto" and order not in ORDERS:
        raise BadInput(f"order {order!r} is not supported: use 1 to 6, or auto")
    problem = build_problem(records, input_map)
    fits = _fit_orders(records, problem, ORDERS if order == "auto" else range(1, int(order) + 1), progress)
    described = [_describe(f, problem) for f in fits]
    chosen = _choose(described, order)
    fit = fits[described.index(chosen)]
    rivals: list[tuple[Hold, float]] = list(_HOLDS.items()) if hold is None else [(hold, np.inf)]
    for other, margin in rivals:
        tried = _least_squares(fit.params, fit.order, other, problem)
        if tried is not None and tried.cost < margin**2 * fit.cost:
            fit = tried
    chosen = _describe(_polished(fit, problem), problem)
    if order != "auto" and not chosen.identifiable:
        raise ComputationFailed(_advice(chosen, described))
    orders = tuple(chosen if d.order == chosen.order else d for d in described)
    orders = orders if order == "auto" else (chosen,)
    model = _to_model(chosen, records, input_map, orders)
    return Identification(model, chosen, orders, dict(zip([r.name for r in records], problem.rest, strict=True)))


def _fit_orders(records, problem: OutputError, orders: Iterable[int], progress) -> list[_Fit]:
    """Every order from the best of its starts, refined to convergence."""
    fits: list[_Fit] = []
    for order in orders:
        starts = [equation_error_roots(records, order, problem), peak_roots(problem, order)]
        if fits and fits[-1].order == order - 1:
            roots = np.roots(polynomial(fits[-1].params[: order - 1])[::-1])
            starts += [np.append(roots, -factor * max(np.abs(roots).max(), 1.0)) for factor in (3.0, 12.0)]
        params = [linear_start(r, order, problem) for r in starts]
        params = sorted((p for p in params if p is not None), key=lambda p: _cost(p, order, "foh", problem))[:2]
        found = []
        for start in params:  # the next start only where the last one failed or lost to the lower order
            found += [f for f in [_least_squares(start, order, "foh", problem)] if f is not None]
            if found and found[-1].converged and (not fits or found[-1].cost <= _NO_WORSE * fits[-1].cost):
                break
        if not found:
            continue
        best = min(found, key=lambda f: f.cost)
        at_its_best = best.cost <= _NO_WORSE * min((f.cost for f in fits), default=np.inf)
        fits.append(replace(best, converged=best.converged and at_its_best))
        progress(f"order {order}: rms {100 * np.sqrt(best.cost):.2f} % of the output's")
    if not fits:
        raise ComputationFailed("no order could be simulated on these records: check units and sampling of the columns")
    return fits


def _polished(fit: _Fit, problem: OutputError) -> _Fit:
    """The fit refined by optimistix; as it was where that leads nowhere."""
    params, _ = polish(fit.params, problem, order=fit.order, hold=fit.hold)
    cost = _cost(params, fit.order, fit.hold, problem)
    return replace(fit, params=params, cost=cost) if cost < fit.cost else fit


def _cost(params: np.ndarray, order: int, hold: Hold, problem: OutputError) -> float:
    """Mean squared normalised output error."""
    return float(np.sum(residual(params, problem, order=order, hold=hold) ** 2) / problem.weight.sum())


def _least_squares(params: np.ndarray, order: int, hold: Hold, problem: OutputError) -> _Fit | None:
    """Levenberg-Marquardt on the output error; None where it is not finite."""
    upper = np.append(fastest_logs(order, problem), np.full(len(params) - order, np.inf))
    found, converged = minimise(lambda p: normal_equations(p, problem, order=order, hold=hold), params, upper)
    cost = _cost(found, order, hold, problem)
    return _Fit(found, order, hold, cost, converged) if np.isfinite(cost) else None


def _describe(fit: _Fit, problem: OutputError) -> OrderFit:
    """Physical coefficients, their errors, and the figures orders are compared by."""
    n = fit.order
    left = residual(fit.params, problem, order=n, hold=fit.hold) * problem.output_scale
    samples = float(problem.weight.sum())
    spread = covariance(fit.params, problem, order=n, hold=fit.hold)
    coefficients, jacobian = _physical(fit.params[: n + 1], problem)
    roots = np.roots(polynomial(fit.params[:n])[::-1]) * problem.omega
    upper = sorted(roots[roots.imag >= 0], key=abs)
    known = np.sqrt(np.clip(np.diag(spread)[: n + 1], 0, None))
    known[n] /= abs(fit.params[n])
    rms = float(np.sqrt((left**2).sum() / samples))
    return OrderFit(
        order=n,
        hold=fit.hold,
        coefficients=coefficients,
        stderr=np.sqrt(np.clip(np.einsum("ij,jk,ik->i", jacobian, spread[: n + 1, : n + 1], jacobian), 0, None)),
        mae=float(np.abs(left).sum() / samples),
        rms=rms,
        bic=float(samples * np.log(rms**2) + len(fit.params) * np.log(samples)),
        natural_hz=np.array([abs(r) / (2 * np.pi) for r in upper]),
        damping=np.array([-r.real / abs(r) for r in upper]),
        offset=problem.offset + (float(fit.params[n + 1]) * problem.output_scale if problem.free_offset else 0.0),
        polarity=float(np.sign(fit.params[n]) or 1.0),
        converged=bool(fit.converged),
        identifiable=bool(fit.converged and (known < 3.0).all() and np.abs(roots).max() * problem.dt < np.pi),
    )


def _physical(params: np.ndarray, problem: OutputError) -> tuple[np.ndarray, np.ndarray]:
    """a_i = |unit / gain| c_i / (c_0 omega^i) from the logarithms and the gain, and the Jacobian."""
    logs, gain = params[:-1], params[-1]
    unit = problem.voltage_scale ** (2 if problem.square else 1) / problem.output_scale
    poly, slopes = polynomial(logs), polynomial_slopes(logs)
    a = abs(unit / gain) * poly / poly[0] / problem.omega ** np.arange(len(poly))
    relative = np.concatenate([slopes / poly[:, None] - slopes[0] / poly[0], np.full((len(poly), 1), -1 / gain)], 1)
    return a, a[:, None] * relative


def _choose(described: list[OrderFit], order) -> OrderFit:
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


def _advice(chosen: OrderFit, described: list[OrderFit]) -> str:
    good = [str(d.order) for d in described if d.identifiable]
    why = "its poles are not determined by the data" if chosen.converged else "the least squares ran away"
    hint = f"orders that are: {', '.join(good)}" if good else "no lower order is either"
    where = f"order {chosen.order} cannot be identified from these records ({why})"
    return f"{where}; {hint}; record a sweep or use --order auto"


def _to_model(chosen: OrderFit, records, input_map: str, orders) -> Model:
    """Scaled model: state scales are the rms of the identified model's own derivatives over the records."""
    n = chosen.order
    a = chosen.coefficients
    force_scale = max(float(np.abs(INPUT_MAPS[input_map]().force(r.voltage)).max()) for r in records)
    x_rms = float(np.sqrt(np.mean(np.concatenate([r.displacement[r.observed] - chosen.offset for r in records]) ** 2)))
    omega = (a[0] / a[n]) ** (1 / n)
    dt = records[0].dt
    fastest = max(float(np.abs(np.roots(a[::-1])).max()), 1e-12)
    provenance = Provenance(
        dt=dt,
        displacement_unit=records[0].displacement_unit,
        voltage_unit=records[0].voltage_unit,
        voltage_range=(
            min(float(r.voltage.min()) for r in records),
            max(float(r.voltage.max()) for r in records),
        ),
        slew=max(float(np.abs(np.diff(r.voltage)).max()) / dt for r in records),
        notes=json.dumps({"identification": summary(chosen, orders, records)}),
    )
    return linear_model(
        a,
        input_map=INPUT_MAPS[input_map](),
        state_scale=x_rms * omega ** np.arange(n + 1),
        force_scale=force_scale,
        output=Output(chosen.offset, chosen.polarity),
        hold=chosen.hold,
        substeps=int(np.clip(np.ceil(fastest * dt / 0.25), 1, 16)),
        provenance=provenance,
    )


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
