"""Identification (the paper's tfest step): a continuous-time ODE of order n, no zeros, fitted by output error.

    F = map(u),    sum_{i=0}^{n} a_i x^(i) = F,    y = direction_r x + zero_r + noise

    minimise  sum over observed samples of (y - y_model)^2     (Levenberg-Marquardt, whole records, float64)

Starts come from the equation error, from the spectrum's peak and from the next lower order plus a fast pole: order 3
by plain output error diverges from a bad start. Poles are stable by construction (`linear_ode`).
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._effects import effect
from .._errors import BadInput, ComputationFailed
from .._model.input_map import INPUT_MAPS
from .._model.model import Hold, Model, Output, Provenance, linear_model
from .._model.substeps import substeps
from .._model_file.lineage import descended
from .._numerics.levenberg_marquardt import minimise
from .._record.initial_state import Beginning, aligned
from .._record.long_record import thinned
from .._record.record import Record
from .._record.sets import check_set
from .._shown import Shown
from .beginnings import find_beginnings
from .final_fit import refine
from .initial_guess import equation_error_roots, linear_start, peak_roots
from .linear_ode import polynomial
from .order_selection import Fit, OrderFit, advice, choose, describe, summary
from .output_error import (
    OutputError,
    build_problem,
    check_motion,
    covariance,
    normal_equations,
    residual,
    upper_bounds,
)

ORDERS = tuple(range(1, 7))
# Other holds than foh, and the share of its error each has to beat: a wrong one costs little, a right one more later
_HOLDS: dict[Hold, float] = {"zoh": 0.98, "bandlimited": 0.997}
_BEGIN = {"rest": "at rest", "held": "settled at a held drive", "moving": "in motion"}
_DELAYS = (0.5, 1.5, 4.0)  # samples, from which a delay is sought
_NO_WORSE = 1.001  # an order holds every lower one, so its cost is no higher unless the search stopped short


@dataclass(frozen=True)
class Identification(Shown):
    """The model of the chosen order, every order compared, and how every record begins.

    Attributes:
        model: its `output` is the zero and the direction of most records.
        chosen, orders: the order taken, and all that were compared.
        beginnings: per record how it begins, and its sensor's zero and direction with the zero's standard error.
    """

    model: Model
    chosen: OrderFit
    orders: tuple[OrderFit, ...]
    beginnings: dict[str, Beginning]

    def _rows(self) -> list[dict]:
        return [vars(fit) for fit in self.orders]

    def __repr__(self) -> str:
        """Two lines: the order taken and what it leaves; how the records begin."""
        c, kinds = self.chosen, [b.begins for b in self.beginnings.values()]
        begin = ", ".join(f"{kinds.count(kind)} {word}" for kind, word in _BEGIN.items() if kind in kinds)
        natural = ", ".join(f"{f:.4g}" for f in c.natural_hz)
        return (
            f"Identification: order {c.order} of {', '.join(str(o.order) for o in self.orders)}, natural {natural} Hz, "
            f"{c.rms:.3g} left (rms, base unit)\n  {len(kinds)} record(s): {begin}"
        )

    @property
    def rest(self) -> dict[str, bool]:
        """Which records begin at rest."""
        return {name: b.begins == "rest" for name, b in self.beginnings.items()}


def identify(
    records: Sequence[Record],
    *,
    order: int | str = "auto",
    input_map: str = "square",
    hold: Hold | None = None,
    learn: Sequence[str] = (),
    progress: Callable[[str], None] = lambda line: None,
) -> Identification:
    """Fit a linear ODE to records by output error.

    Args:
        records: recordings of one actuator (a sweep, or any set that excites it).
        order: 1 to 6, or "auto": the smallest order whose mean absolute error is within 10 % of the best.
        input_map: "square" (F = u^2) or "linear" (F = u).
        hold: "foh", "zoh", "bandlimited", or None for the one that leaves least error: foh unless zoh wins by 2 %
            or bandlimited by 0.3 %.
        learn: ("delay",) to fit a pure delay between drive and motion as well; the model carries it as an effect.
        progress: called with one line per finished order.

    Returns:
        the model, every order compared, and how every record begins.

    Raises:
        BadInput: unknown order or input map, no variation in voltage or displacement.
        ComputationFailed: the asked order cannot be identified from these records.

    Examples:
        >>> found = pitp.identify(records, order=2)
        >>> found.model.order, found.beginnings["sweep"].begins
        (2, 'rest')
    """
    if input_map not in INPUT_MAPS:
        raise BadInput(f"unknown input map {input_map!r}: use one of {', '.join(INPUT_MAPS)}")
    if order != "auto" and order not in ORDERS:
        raise BadInput(f"order {order!r} is not supported: use 1 to 6, or auto")
    if hold is not None and hold not in ("foh", *_HOLDS):
        raise BadInput(f"unknown hold {hold!r}: use one of foh, {', '.join(_HOLDS)}, or None")
    if unknown := sorted(set(learn) - {"delay"}):
        raise BadInput(f"{unknown[0]!r} cannot be learned by an identification: use delay")
    check_set(records)
    check_motion(records)
    begun, roots = find_beginnings(records, input_map)
    problem = build_problem(records, input_map, begun, delayed="delay" in learn)
    fits = _fit_orders(records, problem, roots, ORDERS if order == "auto" else range(1, int(order) + 1), progress)
    described = [describe(f, problem) for f in fits]
    chosen = choose(described, order)
    fit = fits[described.index(chosen)]
    rivals: list[tuple[Hold, float]] = list(_HOLDS.items()) if hold is None else [(hold, np.inf)]
    for other, margin in rivals:
        tried = _least_squares(fit.params, fit.order, other, problem) if _within(fit, other, margin, problem) else None
        if tried is not None and tried.cost < margin**2 * fit.cost:
            fit = tried
    fit = _polished(fit, problem)
    chosen = describe(fit, problem)
    if order != "auto" and not chosen.identifiable:
        raise ComputationFailed(advice(chosen, described))
    orders = tuple(chosen if d.order == chosen.order else d for d in described)
    orders = orders if order == "auto" else (chosen,)
    begun = _fitted(begun, fit, problem)
    model = descended(_to_model(chosen, records, begun, input_map, orders), "identify", records)
    return Identification(model, chosen, orders, dict(zip([r.name for r in records], begun, strict=True)))


def _fitted(begun: Sequence[Beginning], fit: Fit, problem: OutputError) -> list[Beginning]:
    """Beginnings with fitted zeros and directions as the rig has them."""
    polarity, first = float(np.sign(fit.params[fit.order]) or 1.0), fit.order + 1
    errors = np.zeros(problem.free_zeros)
    if problem.free_zeros:
        variance = np.diag(covariance(fit.params, problem, order=fit.order, hold=fit.hold))
        errors = problem.output_scale * np.sqrt(np.clip(variance[first : first + problem.free_zeros], 0, None))
    found = []
    for k, b in enumerate(begun):
        stderr = float(errors[problem.zeros[k]]) if b.free else b.stderr
        zero = float(problem.zero(k, fit.params, fit.order))
        found.append(replace(b, direction=polarity * b.direction, zero=zero, stderr=stderr, free=False))
    return found


def _fit_orders(records, problem: OutputError, roots, orders: Iterable[int], progress) -> list[Fit]:
    """Every order from the best of its starts, refined to convergence."""
    fits: list[Fit] = []
    for order in orders:
        if roots is not None and order == len(roots):
            starts = [roots / problem.omega]
        else:
            starts = [equation_error_roots(records, order, problem), peak_roots(problem, order)]
        if fits and fits[-1].order == order - 1:
            lower = np.roots(polynomial(fits[-1].params[: order - 1])[::-1])
            starts += [np.append(lower, -factor * max(np.abs(lower).max(), 1.0)) for factor in (3.0, 12.0)]
        params = [linear_start(r, order, problem, d) for r in starts for d in (_DELAYS if problem.delayed else (1.0,))]
        params = [p for p in params if p is not None]
        if len(params) > 1:
            params = sorted(params, key=lambda p: _cost(p, order, "foh", problem))[:2]
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
    """The fit refined to the last digit; as it was where that leads nowhere."""
    params = refine(fit.params, problem, order=fit.order, hold=fit.hold)
    cost = _cost(params, fit.order, fit.hold, problem)
    return replace(fit, params=params, cost=cost) if cost < fit.cost else fit


def _within(fit: Fit, hold: Hold, margin: float, problem: OutputError) -> bool:
    """Whether another hold may leave less than its margin, by one Gauss-Newton step: C - g' H^-1 g."""
    with np.errstate(all="ignore"):
        here = normal_equations(fit.params, problem, order=fit.order, hold=hold)
    if not (np.isfinite(here.cost) and np.isfinite(here.hessian).all()):
        return False
    root = np.sqrt(np.maximum(np.diag(here.hessian), 1e-300))
    scaled = here.gradient / root
    won = scaled @ np.linalg.lstsq(here.hessian / np.outer(root, root), scaled, rcond=1e-12)[0]
    return bool((here.cost - won) / problem.weight.sum() < margin**2 * fit.cost)


def _cost(params: np.ndarray, order: int, hold: Hold, problem: OutputError) -> float:
    """Mean squared normalised output error."""
    return float(np.sum(residual(params, problem, order=order, hold=hold) ** 2) / problem.weight.sum())


def _least_squares(params: np.ndarray, order: int, hold: Hold, problem: OutputError) -> Fit | None:
    """Levenberg-Marquardt on the output error; None where it is not finite."""
    upper = upper_bounds(order, problem)
    found, converged = minimise(lambda p: normal_equations(p, problem, order=order, hold=hold), params, upper)
    cost = _cost(found, order, hold, problem)
    return Fit(found, order, hold, cost, converged) if np.isfinite(cost) else None


def _to_model(chosen: OrderFit, records, begun: Sequence[Beginning], input_map: str, orders) -> Model:
    """Scaled model: state scales are the rms of the identified model's own derivatives over the records."""
    n = chosen.order
    a, told = chosen.coefficients, summary(chosen, orders, records)
    share = chosen.stderr / a
    output = Output(chosen.offset, chosen.polarity)
    moved = [output.to_model(aligned(r, b, output).displacement) for r, b in zip(records, begun, strict=True)]
    forces = [np.asarray(INPUT_MAPS[input_map]().force(r.voltage)) for r in records]
    force_scale = max(float(np.abs(f).max()) for f in forces)
    longest = int(np.argmax([r.samples for r in records]))
    x_rms = float(np.sqrt(np.nanmean(np.concatenate(moved) ** 2)))
    omega = (a[0] / a[n]) ** (1 / n)
    dt = records[0].dt
    provenance = Provenance(
        dt=dt,
        displacement_unit=records[0].displacement_unit,
        voltage_unit=records[0].voltage_unit,
        voltage_range=(np.inf, -np.inf),
        slew=0.0,
        notes=json.dumps({"identification": told}),
        covariance=tuple(map(tuple, (chosen.correlation * np.outer(share, share)).tolist())),
        misfit=max(chosen.rms / told["noise_std"], 1.0) if told["noise_std"] else float("inf"),
        long_record=thinned(
            aligned(records[longest], begun[longest], output), forces[longest], begun[longest].begins == "rest"
        ),
    ).driven_by(records)
    model = linear_model(
        a,
        input_map=INPUT_MAPS[input_map](),
        state_scale=x_rms * omega ** np.arange(n + 1),
        force_scale=force_scale,
        output=output,
        hold=chosen.hold,
        substeps=substeps(a, dt),
        provenance=provenance,
    )
    return replace(model, effects=(effect("delay", time=chosen.delay),)) if chosen.delay > 0 else model
