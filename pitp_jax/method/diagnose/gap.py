"""Compute the gap: errors of the nominal and the returned model, and the fraction that the effects remove.

    closed fraction = 1 - sqrt(max(after^2 - floor^2, 0) / (before^2 - floor^2)),   pooled over records

All errors are out of fold. If the search used pieces of long recordings, they are free runs over all recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...common.numbers import figure, of_range
from ..model.fitted import fitted_of
from ..model.model import Model
from ..signal.initial_state import noise_std
from ..signal.record import Record
from ..simulate.prediction import predict
from . import rules
from .data import Case
from .evidence import Evidence, evidence
from .library import model_of
from .pieces import Piece
from .search import Hypothesis, Search
from .shares import energies
from .traces import Trace, levelled
from .verdict import Decision

_GAP = 1.1  # times the floor: up to there no gap to close
_FAR = 10.0  # ranges: the error assigned to a diverged run


@dataclass(frozen=True)
class Gap:
    """Errors of a diagnosis in % of range, pooled over records, and the closed fraction with its 95 % interval.

    Attributes:
        before: of the nominal (refitted in a refit); after: of the chosen set; unrefitted: of the given nominal.
        noise_floor: the nominal's own error, None if unknown; floor_from: its source.
        explainable: error of the best set or the reference.
    """

    before: float
    after: float
    unrefitted: float
    noise_floor: float | None
    floor_from: str
    closed_fraction: float | None
    ci95: tuple[float, float] | None
    explainable: float = float("nan")


@dataclass(frozen=True)
class Errors:
    """Residuals of the given model, the model without effects, and the returned model, on the same samples.

    Attributes:
        given, base, handed: of the given nominal, of the linear model without effects, of the returned model.
        spans: range of every record, scaled.
    """

    given: Evidence
    base: Evidence
    handed: Evidence
    spans: np.ndarray


def out_of_fold(search: Search, handed: Hypothesis) -> Errors:
    """Return the three models' errors on the searched records, each predicted by a fit without that record."""
    return Errors(search.given.evidence, search.base.evidence, handed.evidence, spans(search))


def of_free_runs(search: Search, model: Model, records: Sequence[Record], traces: Sequence[Trace]) -> Errors:
    """Return the three models' errors over all recordings; `traces`: free runs of nominal and returned model."""
    scale = float(search.case.model.scales.state[0])
    given, handed = ([_error(getattr(t, which), t) for t in traces] for which in ("nominal", "augmented"))
    base = given
    if search.base.evidence is not search.given.evidence:
        linear, _ = model_of(search.case.nominal, search.base.fit.slots, model, search.scale)
        base = [_error(levelled(p, r), t) for p, r, t in zip(predict(linear, records), records, traces, strict=True)]
    ranges = np.array([np.nanmax(t.measured) - np.nanmin(t.measured) for t in traces]) / scale
    floor = np.full(len(traces), 1e-12)
    judged = [evidence([e / scale for e in rows], floor) for rows in (given, base, handed)]
    return Errors(judged[0], judged[1], judged[2], ranges)


def _error(run: np.ndarray, trace: Trace) -> np.ndarray:
    """Return the error of a simulation: nan where nothing was measured, a large value where it diverged."""
    far = _FAR * (np.nanmax(trace.measured) - np.nanmin(trace.measured))
    error = np.nan_to_num(run - trace.measured, nan=far, posinf=far, neginf=-far)
    return np.where(np.isfinite(trace.measured), np.clip(error, -far, far), np.nan)


def gap_of(search: Search, decision: Decision, errors: Errors, own: float, source: str) -> Gap:
    """Compute the gap from the errors of the three models, in % of range.

    Args:
        search, decision: of the diagnosis.
        errors: of the three models.
        own: the nominal's own error, scaled, 0 if unknown; source: where it comes from.
    """
    low = floor_percent(errors.spans, own)
    before, after, given = (percent(e, errors.spans) for e in (errors.base, errors.handed, errors.given))
    # over all that was tried, with or without effects: the smallest error of any hypothesis
    least = min(min(h.evidence.score for h in search.every.values()), decision.bar.score)
    room = before * float(np.exp((least - search.base.evidence.score) / 2))
    ci95 = interval(errors.base, errors.handed, errors.spans, low)
    return Gap(
        before, after, given, low if low > 0 else None, source, closed(before, after, low), ci95, min(room, before)
    )


def as_far_as_closed(verdict: str, gap: Gap) -> str:
    """Limit the verdict "explained" to "partly" if the closed fraction may be 0 or a large error remains."""
    nothing = gap.ci95 is not None and gap.ci95[0] <= 0
    much = gap.noise_floor is not None and gap.after > rules.LEFT * gap.noise_floor
    return "partly" if verdict == "explained" and (nothing or much) else verdict


def closed(before: float, after: float, low: float) -> float | None:
    """Return the fraction of the error above the floor `low` that is removed; None if there was none."""
    if before <= _GAP * low or before <= 0:
        return None
    return float(1 - np.sqrt(max(after**2 - low**2, 0.0) / (before**2 - low**2)))


def percent(errors: Evidence, spans: np.ndarray) -> float:
    """Convert the errors of a model to % of range, pooled over records."""
    return 100 * float(np.sqrt(energies([errors], spans)[0, 0]))


def spans(search: Search) -> np.ndarray:
    """Return the output range of every searched record, in scaled units."""
    return np.array([s.span for s in search.case.series])


def interval(before: Evidence, after: Evidence, spans: np.ndarray, low: float) -> tuple[float, float] | None:
    """Return the 95 % interval of the closed fraction by a bootstrap, within [-1, 1]; None without a gap.

    The nominal's own error is also an estimate, and at most the stated value; the lower end of the interval is computed
    without it.
    """
    # the same draws for both, so that common parts cancel in their ratio
    e = 100**2 * energies([before, after], spans)
    if np.sqrt(e[0, 0]) <= _GAP * low:
        return None

    def drawn(least: float) -> np.ndarray:
        room = e[0] - least**2
        share = 1 - np.sqrt(np.maximum(e[1] - least**2, 0) / np.where(room > 0, room, np.nan))
        return np.clip(np.where(room > 0, share, 0.0), -1, 1)  # a draw without a gap: nothing is closed

    bare, here = drawn(0.0), drawn(low)
    return float(min(np.quantile(bare[1:], 0.025), bare[0])), float(max(np.quantile(here[1:], 0.975), here[0]))


def floor_percent(spans: np.ndarray, own: float) -> float:
    """Convert the nominal model's own error (scaled) to % of range."""
    return 100 * own * float(np.sqrt(np.mean(1 / spans**2))) if own else 0.0


def own_misfit(case: Case) -> tuple[float, str]:
    """Return the nominal model's error beyond noise on its identification records (scaled), and its source in words.

    M^2 = rms^2 - noise_0^2 = (misfit^2 - 1) noise_0^2

    It does not grow with the noise of other records: a simulator without noise has a misfit of thousands, and its
    product with the robot's noise would hide any gap.
    """
    origin, scale = fitted_of(case.model).origin, float(case.model.scales.state[0])
    if not np.isfinite(origin.misfit):
        return 0.0, "the sensor's noise, because the model file holds no error of its own"
    noise = origin.noise / scale if origin.noise > 0 else _noise(case)
    return float(noise * np.sqrt(max(origin.misfit**2 - 1, 0.0))), "its error on the recordings it was identified on"


def _noise(case: Case) -> float:
    """Return the sensor's white noise (rms, scaled), the geometric mean over records."""
    scale = float(case.model.scales.state[0])
    each = [float(noise_std(s.record.displacement)) / scale for s in case.series]
    return float(np.exp(np.mean(np.log(np.maximum(each, 1e-12)))))


def beside_noise(case: Case, lacking: float, averaged: int) -> float:
    """Adjust the nominal model's own error (scaled) for noise, for samples that are averaged in blocks.

    (OWN own)^2 = OWN^2 (M^2 + noise^2) - noise^2 + noise^2 / k:   averaging k samples removes white noise
    on both sides, so the comparison stays that of the full rate.
    """
    noise, own = _noise(case), rules.OWN
    return float(np.sqrt((own * lacking) ** 2 + (own**2 - 1 + 1 / averaged) * noise**2) / own)


def explains_most(outputs: Sequence[np.ndarray], own: float) -> bool:
    """Return whether the nominal's own error leaves less than HALF of the outputs' deviation.

    The error of a model that explains less is no measure of noise.
    """
    deviations = [np.std(y) for y in outputs]
    return own < rules.HALF * float(np.exp(np.mean(np.log(np.maximum(deviations, 1e-300)))))


def on_pieces(pieces: Sequence[Piece], records: Sequence[Record], traces: Sequence[Trace]) -> str:
    """Describe the searched pieces of the recordings, and the errors on all other samples, in a sentence."""
    searched = {r.name: np.zeros(r.samples, bool) for r in records}
    for p in pieces:
        time = next(r.time for r in records if r.name == p.record)
        searched[p.record] |= (time - time[0] >= p.from_s) & (time - time[0] <= p.to_s)
    others = [~searched[t.name] for t in traces]
    before, after = (_over(traces, which, others) for which in ("nominal", "augmented"))
    part = 100 * sum(map(np.sum, searched.values())) / sum(r.samples for r in records)
    return (
        f"The search used {len(pieces)} pieces with {figure(part, 2)} % of the samples. On the other samples the "
        f"error is {of_range(after)} of range ({of_range(before)} with the nominal model). All other errors are of "
        "free runs over all recordings"
    )


def _over(traces: Sequence[Trace], which: str, places: Sequence[np.ndarray]) -> float:
    """Return the free-run error (% of range) of "nominal" or "augmented" at some samples, pooled over recordings."""
    squares = []
    for t, here in zip(traces, places, strict=True):
        e = _error(getattr(t, which), t)[here]
        if np.isfinite(e).any():
            squares.append(np.nanmean(e**2) / np.ptp(t.measured[np.isfinite(t.measured)]) ** 2)
    return 100 * float(np.sqrt(np.mean(squares))) if squares else float("nan")
