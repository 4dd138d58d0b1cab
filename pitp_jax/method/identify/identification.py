"""Identify a continuous-time ODE of order n without zeros by output error (the paper's tfest step).

    F = map(u(t - delay)),    sum_{i=0}^{n} a_i x^(i) = F,    y = direction_r x + offset_r + noise

    minimise  sum over observed samples of (y - y_model)^2     (variable projection, whole records, float64)

Steps: initial states (`beginnings`), the measured frequency response (`frequency_response`), starts from it by
optimistix (`frequency_fit`) or from ARX models (`starts`), order, delay and hold together by held-out blocks
(`candidates`), and the chosen model in physical units (`order_fit`). Poles are stable by construction (`linear_ode`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import StateSpace
from threadpoolctl import threadpool_limits

from ...common.errors import ComputationFailed, refuse_if
from ...common.shown import Shown
from ..effects import effect
from ..model.coverage import with_excited
from ..model.domain import Domain
from ..model.dominant import dominant_frequency
from ..model.expected_error import error_table
from ..model.fitted import Fitted
from ..model.input_map import INPUT_MAPS, forces_of, usual_input_map
from ..model.lineage import descended
from ..model.model import Hold, Output, linear_model
from ..model.origin import Origin, OutOfFold
from ..model.substeps import substeps
from ..signal.excitation_kind import only_frequency
from ..signal.excited import Table
from ..signal.initial_state import INITIAL_SAMPLES, Beginning, aligned, noise_of, noise_std, rest_level
from ..signal.long_record import thinned
from ..signal.record import Record
from ..signal.reduced import averaged, block_size
from ..signal.sets import check_set
from .beginnings import find_beginnings
from .candidates import HALF, NEAR, ORDERS, choose, search, without_spring
from .explained import explains, is_noise
from .frequency_response import UNKNOWN_RESPONSE, FrequencyResponse, frequency_response
from .heldout import Candidate, out_of_fold
from .numerator import needed_zeros
from .order_fit import OrderFit, covariance, describe, zero_of
from .output_error import Fit, OutputError, Problem, build_problem, check_motion, least_squares
from .remarks import UNSTABLE, refusal, remarks, unstable_line
from .residual_test import ResidualTest, residual_test

_HOLDS: tuple[Hold, ...] = ("foh", "zoh")
_BEGIN = {"rest": "at rest", "held": "settled at a held drive", "moving": "in motion"}
_NONE = (
    "no order from 1 to 6 can be identified from these recordings; record a sweep through the resonance, or check "
    "that the input and output columns belong together"
)
_USELESS, _CLEARLY = 10.0, 0.5  # % of the deviation, held out: the other input map is tried; what it must leave


@dataclass(frozen=True)
class Identification(Shown):
    """The identified model, the best candidate of every compared order, and the initial state of every record.

    Attributes:
        model: its `output` has the offset and direction of most records.
        chosen, orders: the chosen order, and the best candidate of every compared order.
        beginnings: per record its initial state, and its sensor's direction and offset with standard error.
        response: the measured frequency response.
        out_of_fold: errors of these records in fits without them, by band; also in the model's origin.
        residuals: whether the residual is white and uncorrelated with the input.
        remarks: open questions after these records, one sentence each.
        explains: whether any order explains a tenth of the output's rms on held-out blocks.
        warning: a sentence if the model explains little, the input follows from the output or has one frequency, or the
            plant has zeros.
    """

    model: Fitted
    chosen: OrderFit
    orders: tuple[OrderFit, ...]
    beginnings: dict[str, Beginning]
    response: FrequencyResponse
    out_of_fold: OutOfFold
    residuals: ResidualTest
    remarks: tuple[str, ...] = ()
    explains: bool = True
    warning: str | None = None

    def _rows(self) -> list[dict]:
        return [vars(fit) for fit in self.orders]

    def __repr__(self) -> str:
        """Return two lines of text: the chosen order with its residual, and how the records start."""
        c, kinds = self.chosen, [b.begins for b in self.beginnings.values()]
        begin = ", ".join(f"{kinds.count(kind)} {word}" for kind, word in _BEGIN.items() if kind in kinds)
        natural = ", ".join(f"{f:.4g}" for f in c.natural_hz)
        return (
            f"Identification: order {c.order} of {', '.join(str(o.order) for o in self.orders)}, natural {natural} Hz, "
            f"{c.rms:.3g} left (rms, base unit)\n  {len(kinds)} record(s): {begin}"
        )

    @property
    def rest(self) -> dict[str, bool]:
        """Return for every record, by name, whether it starts at rest."""
        return {name: b.begins == "rest" for name, b in self.beginnings.items()}

    def to_scipy(self) -> StateSpace:
        """Return the model in SciPy's state space x, x', ... x^(n-1), from input (V^2 or V) to displacement (m).

            x^(n) = (F - a_0 x - ... - a_{n-1} x^(n-1)) / a_n,    y = polarity x

        It excludes the delay, which has no finite number of states (`chosen.delay`), and the sensor offset.
        """
        c = self.chosen
        a = np.eye(c.order, k=1)
        a[-1] = -c.coefficients[:-1] / c.coefficients[-1]
        b, out = np.zeros((c.order, 1)), np.zeros((1, c.order))
        b[-1, 0], out[0, 0] = 1 / c.coefficients[-1], c.polarity
        return StateSpace(a, b, out, np.zeros((1, 1)))


def trains_from_order_two(found: Identification) -> bool:
    """Return whether a model that will be trained starts at order 2 instead of the identified order 1.

    It does if order 2 predicts held-out blocks as well as order 1 and its poles are known. The encoder changes
    coefficients, but adds none: without a mass it can only imitate one (docs/decisions/structure.md).
    """
    two = [o for o in found.orders if o.order == 2 and o.poles_known]
    return found.chosen.order == 1 and any(o.heldout <= NEAR * found.chosen.heldout for o in two)


@threadpool_limits.wrap(limits=1, user_api="blas")  # products of ten columns: threads cost five times what they save
def identify(
    records: Sequence[Record],
    *,
    order: int | str = "auto",
    input_map: str | None = None,
    hold: Hold | None = None,
    learn: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    progress: Callable[[str], None] = lambda line: None,
) -> Identification:
    """Identify a linear ODE of the lowest sufficient order from records, by output error.

    Args:
        records: recordings of one actuator (a sweep, or any set that excites it).
        order: 1 to 6, or "auto": the fewest poles and delays whose held-out error is within 3 % of the smallest.
        input_map: "square" (F = u^2), "linear" (F = u), or None: square for a voltage with a length, otherwise linear;
            or the other one if it leaves less than half the error on held-out blocks.
        hold: "foh", "zoh", "bandlimited", or None for the one with the smallest error: foh or zoh, or bandlimited if it
            is better by 0.3 %.
        learn: ("delay",) to keep a pure delay between input and motion in any case; it is an effect of the model.
            Delays below a twentieth of a sample are ignored.
        leave_out: ("delay",) to fit none; by default a delay stays if it improves the held-out error.
        progress: called with one line per finished order.

    Returns:
        the model (a `Fitted`), every compared order, and the initial state of every record.

    Raises:
        BadInput: unknown order or input map, no variation in voltage or displacement.
        ComputationFailed: the requested order cannot be identified from these records.

    Examples:
        >>> found = pitp.identify(records, order=2)
        >>> found.model.order, found.beginnings["sweep"].begins
        (2, 'rest')
    """
    _check_options(order, input_map or "square", hold, learn, leave_out)
    check_set(records)
    check_motion(records)
    usual = input_map or usual_input_map(records[0])
    how = {"order": order, "hold": hold, "learn": learn, "leave_out": leave_out, "progress": progress}
    first = _attempted(records, usual, **how)
    left = np.inf
    if isinstance(first, Identification):
        if first.chosen.heldout <= _USELESS:
            return first
        # a plant is called unstable only if it is so with the other map, however good that is
        if UNSTABLE not in str(first.remarks):
            left = first.chosen.heldout
    elif order != "auto":  # another map adds no excitation
        raise first
    name = next(n for n in INPUT_MAPS if n != usual)
    tested = usual == "square" or input_map is None
    how |= {"progress": lambda _: None, "below": _CLEARLY * left}
    other = _attempted(records, name, **how) if tested else first
    return _better(first, other, name, given=input_map is not None)


def _attempted(records: Sequence[Record], input_map: str, **how) -> "Identification | ComputationFailed":
    try:
        return _identified(records, input_map, **how)
    except ComputationFailed as failed:
        return failed


def _better(first, other, name: str, *, given: bool) -> Identification:
    """Return the first identification, or that with the other input map where it leaves clearly less error.

    Where the map was given, it stays. No plant is called unstable that is stable with the other map.
    """
    failed = isinstance(first, ComputationFailed)
    if isinstance(other, Identification):
        said, left = ((str(first),), np.inf) if failed else (first.remarks, first.chosen.heldout)
        unstable = any(UNSTABLE in line for line in said) and not any(UNSTABLE in line for line in other.remarks)
        better = other.explains and other.chosen.heldout < _CLEARLY * left
        line = (
            f"With --input-map {name}, {other.chosen.heldout:.2g} % of the output's deviation remains unexplained on "
        )
        line += "held-out blocks" if failed else f"held-out blocks, and {left:.2g} % with the other map"
        if better and not given:
            return replace(other, remarks=(f"{line}: {name} was chosen.", *other.remarks))
        if better or unstable:
            if failed:
                raise ComputationFailed(f"{_NONE}. {line}")
            return replace(first, remarks=(f"{line}.", *(() if unstable else said)))
    if failed:
        raise first
    return first


def _identified(
    records: Sequence[Record], input_map: str, order: int | str, hold: Hold | None, learn: Sequence[str],
    leave_out: Sequence[str], progress: Callable[[str], None], below: float = np.inf,
) -> Identification:  # fmt: skip
    """Identify under one input map, as `identify` describes it; fail where the held-out error is not `below` (%)."""
    begun, roots, misfit = find_beginnings(records, input_map)
    # samples a period: a cubic through n of them is off by 3 / 128 (2 pi / n)^4, a tenth of a linear model's residual
    finest = 2 * np.pi * (3 / 128 / (0.1 * max(misfit, 1e-6))) ** 0.25
    whole = build_problem(records, input_map, begun)
    small = _averaged(records, input_map, whole, roots, finest)
    response = frequency_response(whole)
    candidates = _candidates(small, response, order, hold, learn, leave_out, progress)
    if input_map == "linear":
        candidates += without_spring(candidates, small, [hold] if hold else _HOLDS)
    chosen, fit = _determined([c for c in candidates if c.known] or candidates, whole, small, hold)
    if not fit.poles_known:
        why = (unstable_line(chosen, small) or _NONE) if order == "auto" else refusal(fit, whole)
        raise ComputationFailed(why)
    if fit.heldout > below:
        raise ComputationFailed("the other input map is as good")
    begun = _coloured(records, begun, fit, chosen.on(whole))
    whole = replace(whole, beginnings=tuple(begun))
    fit, error = describe(chosen, whole), chosen.on(whole)
    # of each order the candidates that the records determine, then the one that predicts best
    best = [min((c for c in candidates if c.structure.order == n), key=lambda c: (not c.known, c.score))
            for n in sorted({c.structure.order for c in candidates})]  # fmt: skip
    orders = tuple(fit if c.structure.order == fit.order else describe(c, whole) for c in best)
    begun = _fitted(begun, error)
    own, tested, errors = out_of_fold(chosen.heldout, small), residual_test(error), _errors(error)
    explained, warning = explains(chosen, candidates, whole)
    wrong = _wrong_structure(records, chosen, small, response)
    said = () if wrong else tuple(remarks(fit, chosen, small, every=order == "auto"))
    if wrong:  # its reason comes first, and its numbers belong to no plant
        warning, fit = wrong, replace(fit, identifiable=False)
        orders = tuple(replace(o, identifiable=False) for o in orders)
    model = descended(_to_model(fit, records, begun, input_map, own, errors, said), "identify", records)
    beginnings = {r.name: b for r, b in zip(records, begun, strict=True)}
    return Identification(model, fit, orders, beginnings, response, own, tested, said, explained, warning)


def _wrong_structure(
    records: Sequence[Record], chosen: Candidate, problem: Problem, response: FrequencyResponse
) -> str | None:
    """Write why the coefficients are not those of the plant: it has zeros, or the input has one frequency only."""
    lines = [] if problem.square else [hz for r in records if (hz := only_frequency(r))]
    if len(lines) == len(records) and max(lines) < 1.2 * min(lines):
        return (
            f"The input is a sine of one frequency, {lines[0]:.3g} Hz, which determines two numbers: order and "
            "coefficients are not determined. Add steps, a sweep or a second frequency"
        )
    zeros = not is_noise(problem) and needed_zeros(chosen, problem, response)
    return str(zeros) if zeros else None


def _check_options(
    order: int | str, input_map: str | None, hold: str | None, learn: Sequence[str], leave_out: Sequence[str]
) -> None:
    """Refuse options of `identify` that do not exist or that exclude each other."""
    unknown = sorted({*learn, *leave_out} - {"delay"})
    refuse_if(
        (input_map not in INPUT_MAPS, f"unknown input map {input_map!r}; use one of {', '.join(INPUT_MAPS)}"),
        (order not in ("auto", *ORDERS), f"order {order!r} is not supported; use 1 to 6, or auto"),
        (
            hold not in (None, *_HOLDS, "bandlimited"),
            f"unknown hold {hold!r}; use one of {', '.join(_HOLDS)}, bandlimited, or None",
        ),
        (unknown, f"{', '.join(map(repr, unknown))} cannot be learned by an identification; use delay"),
        (
            "delay" in learn and "delay" in leave_out,
            "a delay cannot be both learned and left out; choose one",
        ),
    )


def _candidates(
    small: Problem, response: FrequencyResponse, order: int | str, hold: Hold | None, learn: Sequence[str],
    leave_out: Sequence[str], progress: Callable[[str], None],
) -> list[Candidate]:  # fmt: skip
    """Fit candidate models of the orders, holds of the input and delays that the options allow, in ascending order.

    Raises:
        ComputationFailed: none of them could be simulated.
    """
    candidates: list[Candidate] = []
    # A sharp resonance has a minimum every period of the record: the response may lead to one that explains nothing.
    for known in (response, UNKNOWN_RESPONSE):
        candidates += search(
            small, known, orders=ORDERS if order == "auto" else (int(order),), progress=progress,
            holds=_HOLDS if hold is None else (hold,), delays=[False] if "delay" in leave_out else [False, True],
        )  # fmt: skip
        if not response.rich or any(c.known and c.score < HALF for c in candidates):
            break
    if not candidates:
        raise ComputationFailed(
            "no order could be simulated on these recordings; check the units and the sampling of the columns"
        )
    if "delay" in learn:
        # orders whose delay did not vanish
        late = {c.structure.order for c in candidates if c.structure.delayed}
        candidates = [c for c in candidates if c.structure.delayed or c.structure.order not in late]
    return candidates


def _averaged(records: Sequence[Record], input_map: str, whole: Problem, roots, finest: float) -> Problem:
    """Return the normalised records on which candidates are compared: block means if there are many samples."""
    fastest = max(whole.omega, *(np.abs(roots) if roots is not None else ())) / (2 * np.pi)
    size = block_size(whole.dt, fastest, finest, min(len(d) for d in whole.drive))
    # more samples are averaged over blocks, as far as these hide nothing
    size = min(size, int(np.ceil(whole.samples / 10_000)))
    if size < 2:
        return whole
    forces = forces_of(records, input_map)
    small = [averaged(r, f, size) for r, f in zip(records, forces, strict=True)]
    return replace(build_problem(small, "linear", whole.beginnings), fine=whole.dt)


def _determined(
    candidates: Sequence[Candidate], whole: Problem, small: Problem, hold: Hold | None
) -> tuple[Candidate, OrderFit]:
    """Refit the best candidate whose poles the records determine on all samples; return the fit and its description.

    If no candidate has known poles, the last one is returned.
    """
    while True:
        chosen = choose(candidates)
        # a delay or block means hide which hold it is
        open_hold = chosen.structure.delayed or small.fine < small.dt
        holds: Sequence[Hold] = _HOLDS if open_hold and not hold else (hold or chosen.structure.hold,)
        chosen = _refined(chosen, whole, holds, bandlimited=hold is None)
        fit = describe(chosen, whole)
        candidates = [c for c in candidates if c.structure.order != fit.order]
        if fit.poles_known or not candidates:
            return chosen, fit


def _refined(chosen: Candidate, problem: Problem, holds: Sequence[Hold], *, bandlimited: bool) -> Candidate:
    """Refit a candidate on all samples under each possible hold of the input; return the fit with the least error."""

    def fitted(hold: Hold, *steps: int) -> Fit:
        return least_squares(chosen.params, replace(chosen.structure, hold=hold), problem, *steps)

    best = min(map(fitted, holds), key=lambda fit: fit.cost)
    # four times as expensive: it must lead after one step, and then clearly, although a wrong choice costs little
    if bandlimited and fitted("bandlimited", 2).cost <= best.cost:
        other = fitted("bandlimited")
        if other.cost < 0.997**2 * best.cost:
            best = other
    return replace(chosen, **best._asdict())


def _coloured(
    records: Sequence[Record], begun: Sequence[Beginning], fit: OrderFit, error: OutputError
) -> list[Beginning]:
    """Return initial states whose offsets measured at rest have a standard error that includes slow noise.

    Noise is slow if its fifth difference over some samples exceeds that over one. A smooth model error has no such
    effect: at 30 samples a period its fifth difference is 2e-5 of it, and 5e-3 of its third harmonic.
    """
    problem = error.problem
    apart = int(np.clip(1 / (30 * max(fit.natural_hz[0], 1 / problem.seconds) * problem.dt), 1, 4))
    found = []
    for record, b, residual in zip(records, begun, error.solved.residuals, strict=True):
        slow = noise_std(residual[::apart]) > apart**0.25 * noise_std(residual)  # white: 1, a random walk: sqrt(apart)
        if slow and b.begins == "rest" and not b.free:
            alike = sum(other.group == b.group for other in begun)
            stderr = rest_level(record, problem.scale * residual)[1] / np.sqrt(alike)
            b = replace(b, stderr=max(b.stderr, float(stderr)))
        found.append(b)
    return found


def _fitted(begun: Sequence[Beginning], error: OutputError) -> list[Beginning]:
    """Return initial states with the fitted sensor offsets (output unit), directions and standard errors."""
    problem, first = error.problem, error.structure.moved + 1
    polarity = float(np.sign(error.solved.gains[0]) or 1.0)
    variance = np.diag(covariance(error))[first : first + problem.free_zeros]
    errors, fitted = problem.scale * np.sqrt(np.clip(variance, 0, None)), []
    for k, b in enumerate(begun):
        stderr = float(errors[problem.zeros[k]]) if b.free else b.stderr
        fitted.append(replace(b, direction=polarity * b.direction, zero=zero_of(k, error), stderr=stderr, free=False))
    return fitted


def _errors(fit: OutputError) -> Table:
    """Tabulate the errors on the records; a settled record has the sensor offset of its start, as in a prediction."""
    problem, solved, errors = fit.problem, fit.solved, []
    runs = [problem.scale * (solved.gains[0] * run + own @ sizes)
            for run, own, sizes in zip(fit.runs, fit.free[0], solved.own, strict=True)]  # fmt: skip
    for residual, weight, drive, b in zip(
        solved.residuals, problem.weight, problem.drive, problem.beginnings, strict=True
    ):
        error = np.where(weight > 0, residual, np.nan)
        if b.begins == "held":
            # a change by a thousandth of the range is none
            stands = int(np.argmax(np.abs(drive - drive[0]) > 1e-3 * np.ptp(drive)))
            first = error[: max(stands, INITIAL_SAMPLES)]
            error = error - (first[np.isfinite(first)].mean() if np.isfinite(first).any() else 0.0)
        errors.append(problem.scale * error)
    return error_table(runs, errors, problem.dt)


def _to_model(
    chosen: OrderFit,
    records,
    begun: Sequence[Beginning],
    input_map: str,
    own: OutOfFold,
    errors: Table,
    said: tuple[str, ...],
) -> Fitted:
    """Return the fitted model; the scale of state i is rms displacement times omega^i, omega = (a_0 / a_n)^(1/n)."""
    n = chosen.order
    a = chosen.coefficients
    relative = chosen.stderr / a
    output = Output(chosen.offset, chosen.polarity)
    moved = [output.to_model(aligned(r, b, output).displacement) for r, b in zip(records, begun, strict=True)]
    forces = forces_of(records, input_map)
    force_scale = max(float(np.abs(f).max()) for f in forces)
    longest = int(np.argmax([r.samples for r in records]))
    x_rms = float(np.sqrt(np.nanmean(np.concatenate(moved) ** 2)))
    omega = dominant_frequency(a) if chosen.input_offset else (a[0] / a[n]) ** (1 / n)
    dt = records[0].dt
    long = thinned(aligned(records[longest], begun[longest], output), forces[longest], begun[longest].begins == "rest")
    noise = float(np.median(noise_of(records)))
    origin = Origin(
        displacement_unit=records[0].displacement_unit,
        voltage_unit=records[0].voltage_unit,
        covariance=chosen.correlation * np.outer(relative, relative),
        stderr=tuple(chosen.stderr.tolist()),
        misfit=max(chosen.rms / noise, 1.0) if noise else float("inf"),
        noise=noise,
        level=float("nan") if long is None else 100 * chosen.rms / long.range,
        out_of_fold=own,
        errors=errors,
        remarks=said,
        identified_on=tuple(r.name for r in records),
        long_record=long,
    )
    model = linear_model(
        a,
        input_map=INPUT_MAPS[input_map](),
        state_scale=x_rms * omega ** np.arange(n + 1),
        force_scale=force_scale,
        output=output,
        hold=chosen.hold,
        substeps=substeps(a, dt),
        domain=Domain(dt, (np.inf, -np.inf), 0.0, noise=noise).driven_by(records),
    )
    parts = []
    if chosen.delay > 0:
        parts.append(effect("delay", time=chosen.delay))
    if chosen.input_offset:
        parts.append(effect("voltage_offset", offset=chosen.input_offset))
    model = replace(model, effects=tuple(parts))
    return Fitted(model, with_excited(origin, records))
