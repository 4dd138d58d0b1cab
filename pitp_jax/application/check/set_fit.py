"""Compare all records with one linear model of order 2: initial state, offset, direction, and which do not fit.

    F = map(u),   y_r = g_r x(t) + offset_r (+ a free response where it starts moving),    x: unit static gain

The poles are common to all records; each record has its own gain g_r. A record does not belong to the set if |log g_r|
is far from the others', or if its residual with the common poles is much larger than the others'. It is then left out,
and the others are fitted again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput, ComputationFailed
from ...method.identify.beginnings import find_beginnings, start_beside
from ...method.identify.frequency_response import frequency_response
from ...method.identify.linear_ode import coast, logs_from_roots, respond
from ...method.identify.output_error import build_problem
from ...method.identify.rational_fit import PEAK, needs_resonance
from ...method.model.input_map import INPUT_MAPS, forces_of, usual_input_map
from ...method.numerics.coloured_noise import project
from ...method.signal.excitation_kind import kind
from ...method.signal.initial_state import Beginning
from ...method.signal.preprocess import force_band
from ...method.signal.record import Record
from ...method.signal.reduced import averaged, block_size

_UNEXPLAINED = 0.3  # fraction from which a record may not belong


@dataclass(frozen=True)
class Beside:
    """One record compared with the linear model that all records share.

    Attributes:
        beginning: initial state as `identify` would find it, with the rig's direction.
        gain: its own, in the output's base unit for a unit force.
        unexplained: residual as a fraction of its standard deviation, with fitted gain and offset.
        tells: whether it determines the direction.
        strange: why it does not belong to the set, or empty.
        error: residual at every `step`-th sample; 0 where not `seen`.
        seen: where the output was measured.
        step: samples averaged into one.
    """

    beginning: Beginning
    gain: float
    unexplained: float
    tells: bool
    error: np.ndarray
    seen: np.ndarray
    step: int
    strange: str = ""


@dataclass(frozen=True)
class SetFit:
    """The linear model that all records share.

    Attributes:
        natural_hz: of its pole pair, or of the geometric mean of its real poles.
        peak_hz: of a resonance that the frequency response needs (`rational_fit`); None without one.
        unexplained: its residual, of the output's deviation.
        input_map: "square" or "linear".
        records: compared with it, by name.
    """

    natural_hz: float
    peak_hz: float | None
    unexplained: float
    input_map: str
    records: dict[str, Beside]


def fit_set(records: Sequence[Record]) -> SetFit | None:
    """Fit one linear model of order 2 to all moving records; return None if nothing can be fitted.

    The force is taken as the units suggest unless the other input map has less than half the residual.
    """
    best, usual = None, usual_input_map(records[0])
    for name in sorted(INPUT_MAPS, key=lambda name: name != usual):
        fit = _fitted(records, name)
        if fit is not None and (best is None or fit.unexplained < 0.5 * best.unexplained):
            best = fit
        if best is not None and best.unexplained < 0.2:
            break
    return best


def _fitted(records: Sequence[Record], input_map: str) -> SetFit | None:
    """Fit common poles to the records that belong together; return None if the fit fails."""
    try:
        step, small = _thinned(records, input_map)
        every = set(range(len(small)))
        best = _beside_poles_of(every, small, step)
        if best is None:
            return None
        # halves of fewer than 6 records would decide by chance
        if len(small) >= 6 and _doubtful(best[1]):
            halves = [_beside_poles_of(set(list(every)[k::2]), small, step) for k in (0, 1)]
            best = min([best, *(h for h in halves if h is not None)], key=lambda b: _usual(b[1]))
        kept = every
        for _ in range(3):  # each without the records that differ
            belong = {k for k, row in enumerate(best[1]) if not row.strange}
            if len(belong) < 2 / 3 * len(every):  # the records disagree, so none can be excluded
                best, belong = (best[0], [replace(row, strange="") for row in best[1]]), kept
            if belong == kept:
                break
            kept, best = belong, _beside_poles_of(belong, small, step) or best
    except (BadInput, ComputationFailed, np.linalg.LinAlgError):
        return None
    (first, second), rows = best[0][:2], best[1]
    natural, peaks = float(np.exp(second / 2) / (2 * np.pi)), np.exp(first - second / 2) / 2 < PEAK
    belong = [k for k, row in enumerate(rows) if not row.strange] or list(range(len(rows)))
    # beside its line, a sine shows the response at the frequencies of its leakage only
    belong = [k for k in belong if kind(records[k]) != "sine"] or belong
    problem = build_problem([small[k] for k in belong], "linear", [rows[k].beginning for k in belong])
    needed = peaks and needs_resonance(frequency_response(problem), problem.dt)
    named = {r.name: row for r, row in zip(records, rows, strict=True)}
    return SetFit(natural, natural if needed else None, _usual(rows), input_map, named)


def _beside_poles_of(kept: set[int], small, step: int) -> tuple[np.ndarray, list[Beside]] | None:
    """Fit common poles to the records `kept`; return their logarithms, and every record compared with them."""
    begun, roots, _ = find_beginnings([small[k] for k in sorted(kept)], "linear")
    if roots is None:
        return None
    logs, by_place = logs_from_roots(roots), dict(zip(sorted(kept), begun, strict=True))
    resting = [b.zero for b in begun if b.begins == "rest"]
    moving = Beginning("moving", 1.0, 0.0, 0.0)  # with a free initial state
    beginnings = [
        by_place.get(k) or start_beside(r, "linear", logs, abs(_beside(r, logs, moving, 1).gain), resting[:1])
        for k, r in enumerate(small)
    ]
    return logs, _relative([_beside(r, logs, b, step) for r, b in zip(small, beginnings, strict=True)])


def _usual(rows: Sequence[Beside]) -> float:
    return float(np.median([row.unexplained for row in rows]))


def _doubtful(rows: Sequence[Beside]) -> bool:
    """Return whether common poles are doubtful: sensor directions differ, or some record does not fit them."""
    directions = {row.beginning.direction for row in rows if row.tells}
    return len(directions) > 1 or any(row.strange or row.unexplained > _UNEXPLAINED for row in rows)


def _thinned(records: Sequence[Record], input_map: str) -> tuple[int, list[Record]]:
    """Average input and output of all records over blocks; a linear system preserves their relation."""
    forces = forces_of(records, input_map)
    dt, total = records[0].dt, sum(r.samples for r in records)
    shortest = min(r.samples for r in records)
    # 40 samples per period of the force band remain, and 300,000 in all
    fine = block_size(dt, force_band(forces, dt), 40, shortest)
    step = max(fine, min(-(-total // 300_000), shortest // 64), 1)
    small = [averaged(r, force, step) for r, force in zip(records, forces, strict=True)]
    # an input that starts at 0 V was held there before, at rest
    firsts = [np.append(force[:1], r.voltage[1:]) for r, force in zip(small, forces, strict=True)]
    return step, [replace(r, voltage=voltage) for r, voltage in zip(small, firsts, strict=True)]


def _beside(record: Record, logs: np.ndarray, begun: Beginning, step: int) -> Beside:
    """Fit gain and offset of one record at given poles by least squares; the gain's sign is the sensor direction."""
    dt, force, seen = record.dt, record.voltage, record.observed
    driven = respond(logs, force, step=dt, square=False, hold="foh", settled=begun.begins == "held")
    free, _ = coast(logs, record.samples, step=dt)
    columns = [np.ones(len(driven)), driven]
    if begun.begins == "moving":
        columns.append(free)
    stacked = np.column_stack(columns)[seen]
    y = record.displacement[seen]
    factors, error = project(y, stacked)
    level = np.sqrt(np.sum(error**2) / max(len(y) - stacked.shape[1], 1))
    size = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    inverse = np.linalg.pinv((stacked / size).T @ (stacked / size))
    known = level * np.sqrt(max(inverse[1, 1], 0.0)) / size[1]
    # 1e-6: a record without noise
    unexplained, whole = max(float(error.std() / max(y.std(), 1e-300)), 1e-6), np.zeros(record.samples)
    whole[seen] = error
    direction = float(np.copysign(1.0, factors[1]))
    # a record that the poles hardly explain does not show the sign of its gain
    # from 4 standard errors of its gain on, the sign is known
    tells = bool(abs(factors[1]) > 4 * known and unexplained < 0.9)
    return Beside(replace(begun, direction=direction), float(factors[1]), unexplained, tells, whole, seen, step)


def _relative(rows: Sequence[Beside]) -> list[Beside]:
    """Compare every record's gain with the median, and note why a record does not belong to the others."""
    gains = np.array([abs(row.gain) if row.tells else np.nan for row in rows])
    if not np.isfinite(gains).any():
        return list(rows)
    logs = np.log(gains / np.nanmedian(gains))
    usual = _usual(rows)
    spreads = 5.0  # standard deviations from which a record may not belong, and a factor of at least 2
    # 1.4826 median deviations are a standard deviation, and a few outliers do not change them
    far = np.abs(logs) > max(spreads * 1.4826 * np.nanmedian(np.abs(logs)), np.log(2.0))
    spread = 1.4826 * np.median([abs(np.log(row.unexplained / usual)) for row in rows])
    judged = []
    for row, log, off in zip(rows, logs, far, strict=True):
        worse = np.log(row.unexplained / usual) > max(spreads * spread, np.log(3.0))
        poor = bool(row.unexplained > _UNEXPLAINED and worse)
        judged.append(replace(row, strange=_strange(row, float(np.exp(log)), bool(off), poor, usual)))
    return judged


def _strange(row: Beside, gain: float, off: bool, poor: bool, usual: float) -> str:
    """Write why a record does not belong to the others; empty if it does."""
    if off and not poor:
        # factors between units that are easily confused
        near = min((1e-6, 1e-3, 1e-2, 1e-1, 1e1, 1e2, 1e3, 1e6), key=lambda unit: abs(np.log(gain / unit)))
        if abs(np.log(gain / near)) < 0.3:  # within 35 % of such a factor
            return f"moves {gain:.3g} times as far as the others under its input; check its unit and scale"
        return f"moves {gain:.2g} times as far as the others under its input; check preload, scale and actuator"
    if poor:
        return (
            f"does not fit the others: one linear model leaves {100 * row.unexplained:.0f} % of it unexplained and "
            f"{100 * usual:.0f} % of most others; check whether actuator, input or "
            "sensor changed, or whether the stroke is much larger there (hardening)"
        )
    return ""
