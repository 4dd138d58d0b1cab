"""Identification (the paper's tfest step): a continuous-time ODE of order n, no zeros, fitted by output error.

    F = map(u),    sum_{i=0}^{n} a_i x^(i) = F,    y = polarity x + offset + noise

    minimise  sum over observed samples of (y - y_model)^2     (Levenberg-Marquardt, whole records, float64)

Starts come from the equation error, from the spectrum's peak and from the next lower order plus a fast pole: order 3
by plain output error diverges from a bad start. Poles are stable by construction (`linear_ode`).
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._errors import BadInput, ComputationFailed
from .._model.input_map import INPUT_MAPS
from .._model.model import Hold, Model, Output, Provenance, linear_model
from .._numerics.levenberg_marquardt import minimise
from .._record.long_record import thinned
from .._record.record import Record
from .._record.sets import check_set
from .final_fit import polish
from .initial_guess import equation_error_roots, linear_start, peak_roots
from .linear_ode import polynomial
from .order_selection import Fit, OrderFit, advice, choose, describe, summary
from .output_error import OutputError, build_problem, fastest_logs, normal_equations, residual

ORDERS = tuple(range(1, 7))
# Other holds than foh, and the share of its error each has to beat: a wrong one costs little, a right one more later
_HOLDS: dict[Hold, float] = {"zoh": 0.98, "bandlimited": 0.997}
_NO_WORSE = 1.001  # an order holds every lower one, so its cost is no higher unless the search stopped short


@dataclass(frozen=True)
class Identification:
    """The model of the chosen order, every order compared, and which records were found to start at rest."""

    model: Model
    chosen: OrderFit
    orders: tuple[OrderFit, ...]
    rest: dict[str, bool]


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
    if hold is not None and hold not in ("foh", *_HOLDS):
        raise BadInput(f"unknown hold {hold!r}: use one of foh, {', '.join(_HOLDS)}, or None")
    check_set(records)
    problem = build_problem(records, input_map)
    fits = _fit_orders(records, problem, ORDERS if order == "auto" else range(1, int(order) + 1), progress)
    described = [describe(f, problem) for f in fits]
    chosen = choose(described, order)
    fit = fits[described.index(chosen)]
    rivals: list[tuple[Hold, float]] = list(_HOLDS.items()) if hold is None else [(hold, np.inf)]
    for other, margin in rivals:
        tried = _least_squares(fit.params, fit.order, other, problem)
        if tried is not None and tried.cost < margin**2 * fit.cost:
            fit = tried
    chosen = describe(_polished(fit, problem), problem)
    if order != "auto" and not chosen.identifiable:
        raise ComputationFailed(advice(chosen, described))
    orders = tuple(chosen if d.order == chosen.order else d for d in described)
    orders = orders if order == "auto" else (chosen,)
    model = _to_model(chosen, records, input_map, orders, problem.rest)
    return Identification(model, chosen, orders, dict(zip([r.name for r in records], problem.rest, strict=True)))


def _fit_orders(records, problem: OutputError, orders: Iterable[int], progress) -> list[Fit]:
    """Every order from the best of its starts, refined to convergence."""
    fits: list[Fit] = []
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


def _polished(fit: Fit, problem: OutputError) -> Fit:
    """The fit refined by optimistix; as it was where that leads nowhere."""
    params = polish(fit.params, problem, order=fit.order, hold=fit.hold)
    cost = _cost(params, fit.order, fit.hold, problem)
    return replace(fit, params=params, cost=cost) if cost < fit.cost else fit


def _cost(params: np.ndarray, order: int, hold: Hold, problem: OutputError) -> float:
    """Mean squared normalised output error."""
    return float(np.sum(residual(params, problem, order=order, hold=hold) ** 2) / problem.weight.sum())


def _least_squares(params: np.ndarray, order: int, hold: Hold, problem: OutputError) -> Fit | None:
    """Levenberg-Marquardt on the output error; None where it is not finite."""
    upper = np.append(fastest_logs(order, problem), np.full(len(params) - order, np.inf))
    found, converged = minimise(lambda p: normal_equations(p, problem, order=order, hold=hold), params, upper)
    cost = _cost(found, order, hold, problem)
    return Fit(found, order, hold, cost, converged) if np.isfinite(cost) else None


def _to_model(chosen: OrderFit, records, input_map: str, orders, rest) -> Model:
    """Scaled model: state scales are the rms of the identified model's own derivatives over the records."""
    n = chosen.order
    a, told = chosen.coefficients, summary(chosen, orders, records)
    share = chosen.stderr / a
    forces = [np.asarray(INPUT_MAPS[input_map]().force(r.voltage)) for r in records]
    force_scale = max(float(np.abs(f).max()) for f in forces)
    longest = int(np.argmax([r.samples for r in records]))
    x_rms = float(np.sqrt(np.mean(np.concatenate([r.displacement[r.observed] - chosen.offset for r in records]) ** 2)))
    omega = (a[0] / a[n]) ** (1 / n)
    dt = records[0].dt
    fastest = max(float(np.abs(np.roots(a[::-1])).max()), 1e-12)
    provenance = Provenance(
        dt=dt,
        displacement_unit=records[0].displacement_unit,
        voltage_unit=records[0].voltage_unit,
        voltage_range=(np.inf, -np.inf),
        slew=0.0,
        notes=json.dumps({"identification": told}),
        covariance=tuple(map(tuple, (chosen.correlation * np.outer(share, share)).tolist())),
        misfit=max(chosen.rms / told["noise_std"], 1.0) if told["noise_std"] else float("inf"),
        long_record=thinned(records[longest], forces[longest], rest[longest]),
    ).driven_by(records)
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
