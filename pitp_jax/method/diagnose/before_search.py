"""Answer what needs no search: there is no gap, or a tone that no input contains is all of it.

no_gap        the free runs leave at most SETTLED times the nominal's own error (up to OWN times it, the search decides)
steady_tone   y = x + A_r sin(2 pi f t + phi_r), one f for all recordings, and without it at most OWN times
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...common.units import base_unit
from ..model.fitted import fitted_of
from ..model.model import Model
from ..signal.record import Record
from ..signal.reduced import centred_means
from . import rules
from .data import build_case
from .evidence import Evidence, evidence, probability
from .fit import Fit
from .gap import Gap, closed, interval
from .outcome import Diagnosis
from .own_error import OwnError
from .parts import Part, Parts
from .result import Ranked
from .scale import scale_of
from .shares import without_effects
from .steady_tone import Tone, fit_tone
from .where import locate, motions, nowhere

TONE = "steady_tone"
_FORM = "one line"


@dataclass(frozen=True)
class _Errors:
    """The errors of the free runs, as given and after the tone is subtracted; equal without a tone."""

    given: Evidence
    rest: Evidence
    tone: Tone | None


def answered(model: Model, records: Sequence[Record], runs: OwnError, notes: tuple[str, ...]) -> Diagnosis | None:
    """Return the diagnosis if the nominal's free runs decide it; None: a search must.

    Args:
        model: the nominal, which was not made from these recordings.
        records: that move.
        runs: `own_error` of both.
        notes: on recordings left out.
    """
    given = evidence(runs.residuals, 1e-6 * runs.spans)
    if runs.ratio(runs.residuals) <= rules.SETTLED:
        return _diagnosis(model, records, runs, _Errors(given, given, None), notes)
    errors = [np.nan_to_num(e) for e in runs.residuals]
    tone = fit_tone(errors, [r.voltage for r in records], [r.dt for r in records])
    if tone is None or runs.ratio(rest := tone.taken_from(runs.residuals)) > rules.OWN:
        return None
    return _diagnosis(model, records, runs, _Errors(given, evidence(rest, 1e-6 * runs.spans), tone), notes)


def _diagnosis(model: Model, records, runs: OwnError, errors: _Errors, notes: tuple[str, ...]) -> Diagnosis:
    names = tuple(r.name for r in records)
    before, after = (runs.percent(np.sqrt(e.mse)) for e in (errors.given, errors.rest))
    low, spans = runs.percent(runs.own), runs.spans
    unit = base_unit(fitted_of(model).origin.displacement_unit)
    rows = _tone_rows(errors, unit, spans, before, after, low) if errors.tone is not None else None
    gap = Gap(before, after, before, low, runs.source, closed(before, after, low) if rows else None,
              interval(errors.given, errors.rest, spans, low) if rows else None, after)  # fmt: skip
    part, row, share = rows or (None, None, {})
    try:
        where = _where(model, records, runs)
    except Exception as error:  # it only describes the result
        where, notes = nowhere(), (*notes, f"the place of the gap failed ({type(error).__name__}: {error})")
    return Diagnosis(
        verdict="explained" if part else "no_gap",
        effects=(TONE,) if part else (),
        equivalent=(),
        added=(),
        gap=gap,
        ranking=(row,) if row else (),
        where=where,
        next_experiment=None,
        fitted=names,
        heldout=names if len(names) > 1 else (),
        shift=np.ones(model.order + 1),
        traces=runs.traces,
        model=fitted_of(model),
        notes=notes,
        budget=without_effects(share),
        probability={TONE: part.probability} if part and part.probability is not None else {},
        parts=Parts((part,) if part else ()),
    )


def _tone_rows(errors: _Errors, unit: str, spans: np.ndarray, before: float, after: float, low: float):
    """Return the tone as a part, as a candidate, and as a fraction of the budget."""
    tone, p = errors.tone, probability(errors.rest, errors.given)
    assert tone is not None
    numbers = {"frequency": (*tone.frequency, "Hz"), "amplitude": (*tone.amplitude, unit)}
    between = {k: {"value": v, "unit": u, "ci95": [v - 1.96 * e, v + 1.96 * e]} for k, (v, e, u) in numbers.items()}
    rows = {k: {"value": v, "unit": u, "stderr": e} for k, (v, e, u) in numbers.items()}
    share = float(1 - (after / before) ** 2)
    part = Part(TONE, _FORM, between, share, p, "certain")
    ci95 = interval(errors.given, errors.rest, spans, low)
    row = Ranked(TONE, "sensor", _FORM, rows, after, after, closed(before, after, low), ci95, p)
    return part, row, {TONE: {"share": share, "ci95": [share, share], "probability": p, "equivalent": []}}


def _where(model: Model, records: Sequence[Record], runs: OwnError) -> dict:
    """Locate the errors of the free runs (`where.locate`)."""
    case = build_case(model, records)
    scale = scale_of(case, Fit((), (), case.nominal.copy(), case.starts.copy()))
    errors = [
        s.direction * centred_means(e, case.thinned, s.begins == "rest")[: len(s.output)] / case.model.scales.state[0]
        for e, s in zip(runs.residuals, case.series, strict=True)
    ]
    return locate(motions(case, scale), errors)
