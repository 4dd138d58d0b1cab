"""Describe a diagnosis in a few lines and a table: the returned model, its parts, the verdict, the next step."""

import numpy as np

from ...common.numbers import figure, interval, of_range, percent
from ...common.page import Page, Table
from ..effects.words import parameter, plain_words
from ..model.encoder import ConstantEncoder
from ..model.units import units_of
from . import rules
from .traces import Trace

NEXT_CSV = "next_experiment.csv"


def lines(d) -> list[str]:
    """Return the lines of a diagnosis for the terminal."""
    return [result_line(d), *(f"  {line}" for line in part_lines(d)), *verdict_lines(d)]


def summary(d) -> Page:
    """Return the first screen of a diagnosis: the same lines, with the parts as a table."""
    rows = []
    for p in d.parts:
        values = "; ".join(numbers_of(d, p, " = "))
        share = percent(p.fraction) if p.fraction else ""
        rows.append((p.effect, p.form, values, share, p.probability, certainty(p)))
    header = ("part", "form", "values (95 % interval)", "of the reduction", "P", "certainty")
    note = "Parts of the model handed back, the largest first."
    table = Table(header, rows, note, [p.effect in d.effects for p in d.parts], (0, 1, 2, 5))
    css = {"explained": "good", "unknown": "open"}.get(d.verdict, "")
    kind = "Diagnosis: a model beside recordings of the real actuator"
    return Page(result_line(d), kind, [table, *verdict_lines(d)], css=css)


def verdict_lines(d) -> list[str]:
    """Return the verdict with its reason, the meaning of its effects, the remaining error, and the next step."""
    by = f" by {named(d.effects)}{''.join(f', or by {name}' for name in d.equivalent)}" if d.effects else ""
    text = [f"verdict: {d.verdict}{by}. {d.reason}".rstrip()]
    if d.verdict == "no_gap":
        return [*text, next_step(d)]
    text += [f"{name}: {plain_words(name, units_of(d.model))}" for name in d.effects]
    if d.term is not None:
        closed = percent(d.term.closed_fraction or 0)
        text.append(f"{d.term.equation}: closes {closed}, -> {d.term.after:.3g} %")
    if tone := d.where.get("tone"):
        text.append(
            f"In every recording, at least {percent(tone['share'])} of the error is one oscillation at "
            f"{figure(tone['hz'])} Hz, for every input. Something disturbs the rig from outside (vibration, electrical "
            "interference, a supply)."
        )
    return [*text, f"energy of the error: {', '.join(_rest(d))}", d.where["summary"], next_step(d)]


def _rest(d) -> list[str]:
    """Return the parts of the error's energy that no reported effect explains."""
    parts = (
        ("unnamed", "can be predicted from the input, but no single cause is certain"),
        ("unexplainable", "is left by the parts above" if further(d) else "is predicted by no model tried here"),
    )
    shares = {k: d.budget[k]["share"] for k, _ in parts}
    return [f"{percent(shares[k])} {text}" for k, text in parts if shares[k] >= 0.005 or k != "unnamed"]


def further(d) -> float:
    """Return the fraction of the remaining error that another model predicts; 0 if it is small."""
    fraction = 1 - d.gap.explainable / d.gap.after if d.handed_back and d.gap.after > 0 else 0.0
    return fraction if fraction > 1 - rules.FIRST else 0.0


def result_line(d) -> str:
    """Describe by how much the returned model reduces the error, out of sample, in one line."""
    g = d.gap
    if d.verdict == "no_gap":
        which = "refitted nominal model" if d.handed_back else "nominal model"
        return f"The {which} is handed back: its error, {of_range(g.before)} of range, is its own."
    where = "held-out recordings" if d.heldout else "left-out parts of the recordings"
    if d.effects == ("steady_tone",):
        return (
            f"The nominal model is handed back: without the tone its error is {of_range(g.after)} of range "
            f"({of_range(g.before)} with it)."
        )
    if not d.handed_back:
        return (
            f"The nominal model is handed back: no model reduces its error on {where} ({of_range(g.before)} of range)."
        )
    given = f" (as given: {of_range(g.unrefitted)})" if g.unrefitted != g.before else ""
    closed = ""
    if g.closed_fraction is not None:
        ends = f", 95 % interval {interval(*g.ci95)}" if g.ci95 else ""
        closed = f": {percent(g.closed_fraction)} of the gap is closed{ends}"
    return (
        f"The model handed back reduces the error on {where} from {of_range(g.before)}{given} to {of_range(g.after)} "
        f"of range{closed}."
    )


def part_lines(d) -> list[str]:
    """Return one line per added effect: parameters with intervals, contribution and certainty."""
    texts = []
    for part in d.parts:
        line = f"{part.effect} ({part.form}): {', '.join(numbers_of(d, part))}"
        if part.fraction:
            line += f"; {percent(part.fraction)} of the reduction"
            line += "" if part.probability is None else f", P {part.probability:.2f}"
        texts.append(f"{line}; {certainty(part)}")
    return texts


def numbers_of(d, part, equals: str = " ") -> list[str]:
    """Return the parameters of an effect, one text each."""
    unit = d.model.origin.displacement_unit
    return [equals.join(parameter(name, number, unit)) for name, number in part.parameters.items()]


def certainty(part) -> str:
    """Describe the certainty of an added effect in words."""
    if part.certainty == "tied":
        return f"tied: these recordings do not separate it from {named(part.tied)}"
    if part.certainty == "likely":
        return f"likely; to make it certain, record {part.recording}"
    if part.certainty == "certain":
        return "certain"
    return "too small to be named as a cause" if 0 < part.fraction < rules.LISTED else "not certain"


def next_step(d) -> str:
    """Recommend the next step after a diagnosis, in one sentence."""
    if d.verdict == "no_gap":
        if isinstance(d.model.encoder, ConstantEncoder):
            return "Next: predict and invert with this model; if its error is too large, train it with `pitp fit`."
        return "Next: predict and invert with this model; more recordings would not improve it."
    if d.next_experiment is not None:
        return f"Next: play and record {NEXT_CSV}, which separates {named(d.next_experiment.separates)}."
    if d.where.get("tone"):
        return "Next: find the source of this oscillation; no model of the actuator can predict it."
    if fraction := further(d):
        return (
            f"Next: diagnose again with --nominal model_augmented, because up to {percent(fraction)} of the remaining "
            "error can be predicted."
        )
    if d.effects:
        return "Next: predict and invert with model_augmented, or repair the rig and diagnose again."
    return f"Next: check {worst(d).name}, which holds most of the gap, then record an input of another kind."


def worst(d) -> Trace:
    """Return the record that holds most of the gap: by `where`, otherwise the largest error relative to its range."""
    held, shares = [t for t in d.traces if t.heldout] or list(d.traces), d.where["records"]
    return max(held, key=lambda t: (shares.get(t.name, 0.0), np.nan_to_num(errors(t)[0])))


def errors(trace: Trace) -> tuple[float, float]:
    """Return e_rms (% of range) of the nominal and the returned model on a record; nan without measurement."""
    seen = np.isfinite(trace.measured)
    if not seen.any() or not np.ptp(trace.measured[seen]):
        return float("nan"), float("nan")
    first, second = (
        100 * float(np.sqrt(np.mean((y - trace.measured)[seen] ** 2)) / np.ptp(trace.measured[seen]))
        for y in (trace.nominal, trace.augmented)
    )
    return first, second


def named(names) -> str:
    """Join names in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
