"""Describe a diagnosis in a few lines and a table: the returned model, its parts, the verdict, the next step."""

import numpy as np

from ...common.numbers import figure, interval, of_range, percent
from ...common.page import Page, Table
from ..effects.words import parameter, plain_words
from ..model.units import units_of
from . import rules
from .data import FEWEST_FOLDS
from .library import FREE
from .traces import Trace

NEXT_CSV, TONE = "next_experiment.csv", "steady_tone"
CAUSES = {
    "nuisance": "sensor offsets and initial states",
    "parameters": "changed coefficients",
    "simulator": "the model of the simulator",
    "unnamed": "can be predicted from the input, but no single cause is certain",
    "unexplainable": "remaining error",
}


def lines(d) -> list[str]:
    """Return the lines of a diagnosis for the terminal."""
    return [result_line(d), *(f"  {line}" for line in part_lines(d)), *verdict_lines(d)]


def summary(d) -> Page:
    """Return the first screen of a diagnosis: the same lines, with the parts as a table."""
    rows = []
    for p in d.parts:
        values = "; ".join(numbers_of(d, p, " = "))
        rows.append((p.effect, p.form, values, percent(p.fraction or None), p.probability, certainty(p)))
    header = ("part", "form", "values (95 % interval)", "of the reduction", "P", "certainty")
    table = Table(header, rows, "The largest part first.", [p.effect in d.effects for p in d.parts], (0, 1, 2, 5))
    kind = "Diagnosis: a model beside recordings of the real actuator"
    css = {"explained": "good", "unknown": "open"}
    return Page(result_line(d), kind, [table, *verdict_lines(d)], css=css.get(d.verdict, ""))


def verdict_lines(d) -> list[str]:
    """Return the verdict with its reason, the meaning of its effects, the remaining error, and the next step."""
    by = f" by {named(d.effects)}{''.join(f', or by {name}' for name in d.equivalent)}" if d.effects else ""
    text = [f"verdict: {d.verdict}{by}. {d.reason}".rstrip()]
    if d.verdict == "no_gap":
        return [*text, next_step(d)]
    text += [f"{name}: {plain_words(name, units_of(d.model))}" for name in d.effects]
    if d.term is not None:
        text.append(d.term.equation)
    if (tone := d.where.get("tone")) and d.effects != (TONE,):
        text.append(
            f"In every recording, at least {percent(tone['share'])} of the error is one oscillation at about "
            f"{figure(tone['hz'], 2)} Hz, for every input."
        )
    energy = [f"{percent(part['share'])} {cause}" for cause, part in causes(d.budget) if part["share"] >= 0.01]
    return [*text, f"energy of the error: {'; '.join(energy)}", d.where["summary"], next_step(d)]


def causes(budget: dict) -> list[tuple[str, dict]]:
    """Return all parts of the error's energy by their cause in words, the largest first."""
    words = ((CAUSES.get(k) or k, part) for k, part in (budget | budget["effects"]).items() if k != "effects")
    return sorted(words, key=lambda row: -row[1]["share"])


def result_line(d) -> str:
    """Describe by how much the returned model reduces the error, out of sample, in one line."""
    g = d.gap
    if d.verdict == "no_gap":
        which = "refitted nominal model" if d.handed_back else "nominal model"
        own = f"{g.floor_from}: {of_range(g.noise_floor)}" if g.noise_floor else "no model of the input predicts it"
        return f"The {which} is handed back: its error is {of_range(g.before)} of range ({own})."
    where = "held-out recordings" if len(d.folds) >= FEWEST_FOLDS else "left-out parts of the recordings"
    if d.effects == (TONE,):
        return (
            f"The nominal model is handed back: without the tone its error is {of_range(g.after)} of range "
            f"({of_range(g.before)} with it)."
        )
    if not d.handed_back:
        return (
            f"The nominal model is handed back: no model significantly reduces its error on {where} "
            f"({of_range(g.before)} of range)."
        )
    given = f" (as given: {of_range(g.unrefitted)})" if g.unrefitted != g.before else ""
    closed = f": {percent(g.closed_fraction)} of the gap is closed, 95 % interval {interval(*g.ci95)}" if g.ci95 else ""
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
    texts = (equals.join(parameter(name, number, unit)) for name, number in part.parameters.items())
    return [text.replace("= ×", "×") for text in texts]


def certainty(part) -> str:
    """Describe the certainty of an added effect in words."""
    if part.certainty == "tied":
        return f"tied: these recordings do not separate it from {named(part.tied)}"
    if part.certainty == "likely":
        return f"likely; to make it certain, record {part.experiment or part.recording}"
    if part.certainty == "certain":
        return "certain"
    if part.effect == FREE:
        return "describes the error, names no cause"
    return "too small to be named as a cause" if 0 < part.fraction < rules.LISTED else "not certain"


def next_step(d) -> str:
    """Recommend the next step after a diagnosis, in one sentence."""
    if d.verdict == "no_gap":
        return "Next: predict and invert with this model; if its error is too large, train with `pitp fit`."
    if d.verdict == "unknown" and "The search stopped" in " ".join(d.notes):
        return "Next: diagnose again without a limit of time (--seconds)."
    if d.next_experiment is not None:
        return f"Next: play and record {NEXT_CSV}: {d.next_experiment}."
    if d.where.get("tone"):
        return "Next: find the source of this oscillation; no model of the actuator can predict it."
    left = d.gap.explainable / d.gap.after if d.handed_back and d.gap.after else 1.0
    if left < rules.FIRST and d.verdict != "explained":
        return (
            f"Next: diagnose again with --nominal model_augmented, because up to {percent(1 - left)} of the remaining "
            "error can be predicted."
        )
    if d.effects:
        return "Next: predict and invert with model_augmented, or repair the rig and diagnose again."
    return f"Next: check {worst(d).name}, which has the largest error, then record an input of another kind."


def worst(d) -> Trace:
    """Return the record that holds most of the gap: by `where`, otherwise the largest error relative to its range."""
    return max(d.traces, key=lambda t: (d.where["records"].get(t.name, 0.0), np.nan_to_num(errors(t)[0])))


def errors(trace: Trace) -> tuple[float, float]:
    """Return e_rms (% of range) of the nominal and the returned model on a record; nan without measurement."""
    if not np.isfinite(trace.measured).any() or not trace.span:
        return float("nan"), float("nan")
    runs = np.stack([trace.nominal, trace.augmented])
    first, second = (100 * np.sqrt(np.nanmean((runs - trace.measured) ** 2, axis=1)) / trace.span).tolist()
    return first, second


def named(names) -> str:
    """Join names in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
