"""Compute the gap: errors of the nominal and the returned model, and the fraction that the effects remove.

    closed fraction = 1 - sqrt(max(after^2 - floor^2, 0) / (before^2 - floor^2)),   pooled over records

All errors are out of fold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..signal.initial_state import noise_std
from . import rules
from .data import Case
from .evidence import Evidence
from .own_error import geometric_mean
from .search import Hypothesis, Search
from .shares import energies
from .verdict import Decision

_GAP = 1.1  # times the floor: up to there no gap to close


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
        given, base, handed: of the given nominal, of the linear model without effects (of the given nominal if that is
            returned), of the returned model.
        spans: range of every record, scaled.
    """

    given: Evidence
    base: Evidence
    handed: Evidence
    spans: np.ndarray


def out_of_fold(search: Search, handed: Hypothesis) -> Errors:
    """Return the three models' errors on the searched records, each predicted by a fit without that record."""
    # a refit that is not handed back leaves the given nominal, and -97 % was closed
    base = search.given if handed is search.given else search.base
    return Errors(search.given.evidence, base.evidence, handed.evidence, spans(search))


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
    room = before * float(np.exp((least - errors.base.score) / 2))
    ci95 = interval(errors.base, errors.handed, errors.spans, low)
    return Gap(
        before, after, given, low if low > 0 else None, source, closed(before, after, low), ci95, min(room, before)
    )


def as_far_as_closed(verdict: str, gap: Gap) -> str:
    """Limit the verdict "explained" to "partly" if the closed fraction may be 0 or a large error remains."""
    nothing = gap.ci95 is not None and gap.ci95[0] <= 0
    much = gap.noise_floor is not None and gap.after > rules.PARTLY * gap.noise_floor
    return "partly" if verdict == "explained" and (nothing or much) else verdict


def closed(before: float, after: float, low: float) -> float | None:
    """Return the fraction of the error above the floor `low` that is removed; None if there was none."""
    if before <= _GAP * low or before <= 0:
        return None
    # squares of independent errors add up, and no effect can remove the floor
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


def _noise(case: Case) -> float:
    """Return the sensor's white noise (rms, scaled), the geometric mean over records."""
    scale = float(case.model.scales.state[0])
    each = [noise_std(s.record.displacement) / scale for s in case.series]
    return geometric_mean(np.maximum(each, 1e-12))


def beside_noise(case: Case, lacking: float, averaged: int) -> float:
    """Adjust the nominal model's own error (scaled) for noise, for samples that are averaged in blocks.

    (OWN own)^2 = OWN^2 (M^2 + noise^2) - noise^2 + noise^2 / k:   averaging k samples removes white noise
    on both sides, so the comparison stays that of the full rate.
    """
    noise, own = _noise(case), rules.OWN
    return float(np.sqrt((own * lacking) ** 2 + (own**2 - 1 + 1 / averaged) * noise**2) / own)


def explains_most(outputs: Sequence[np.ndarray], own: float) -> bool:
    """Return whether the nominal's own error is less than a tenth (LISTED) of the outputs' deviation.

    A larger error shows what the model lacks, and is no measure of the noise.
    """
    return own < rules.LISTED * geometric_mean(np.array([np.std(y) for y in outputs]))
