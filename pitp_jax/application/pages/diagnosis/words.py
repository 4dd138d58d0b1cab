"""Describe a diagnosis in a few lines: the returned model, its effects, the verdict, the next step."""

from ....common.numbers import interval, of_range, percent
from ....method.diagnose import rules
from ....method.model.units import units_of
from .formatting import named, parameter_between, plain_words


def lines(d) -> list[str]:
    """Return the lines of a diagnosis for the terminal."""
    from .answers import next_step  # the page's cards use the same words

    told = [result_line(d), *(f"  {line}" for line in part_lines(d))]
    said = f"verdict: {d.verdict}" + (f" by {named(d.effects)}" if d.effects else "")
    told.append(f"{said}. {d.reason}" if d.reason else f"{said}.")
    if d.verdict == "no_gap":
        return [*told, next_step(d)]
    told += [f"{name}: {plain_words(name, units_of(d.model))}" for name in d.effects]
    if d.term is not None:
        told.append(f"{d.term.equation}: closes {100 * (d.term.closed_fraction or 0):.0f} %, -> {d.term.after:.3g} %")
    b = d.budget
    rest = [
        f"{100 * b[k]['share']:.0f} % {text}"
        for k, text in (
            ("unnamed", "can be predicted from the input, but no single cause is certain"),
            ("unexplainable", "cannot be predicted"),
        )
    ]
    return [*told, "energy of the error: " + ", ".join(rest), d.where["summary"], next_step(d)]


def result_line(d) -> str:
    """Describe by how much the returned model reduces the error, out of sample, in one line."""
    g = d.gap
    if d.verdict == "no_gap":
        which = "refitted nominal model" if d.handed_back else "nominal model"
        return f"The {which} is handed back: its error, {of_range(g.before)} of range, is its own."
    where = "held-out recordings" if d.heldout else "left-out parts of the recordings"
    where = "all recordings" if d.pieces is not None else where
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
    told = []
    for part in d.parts:
        line = f"{part.effect} ({part.form}): {', '.join(numbers_of(d, part))}"
        told.append("; ".join([line, *contribution(part), certainty(part)]))
    return told


def numbers_of(d, part, equals: str = " ") -> list[str]:
    """Return the parameters of an added effect, one text each."""
    unit = d.model.origin.displacement_unit
    texts = (parameter_between(name, number, unit) for name, number in part.parameters.items())
    return [f"{label}{equals}{text}" for label, text in texts]


def contribution(part) -> list[str]:
    """Return an added effect's fraction of the reduction, with P; empty for refitted coefficients."""
    if not part.fraction:
        return []
    sure = "" if part.probability is None else f", P {part.probability:.2f}"
    return [f"{percent(part.fraction)} of the reduction{sure}"]


def certainty(part) -> str:
    """Describe the certainty of an added effect in words."""
    if part.certainty == "tied":
        return f"tied: these recordings do not separate it from {named(part.tied)}"
    if part.certainty == "likely":
        return f"likely; to make it certain, record {part.recording}"
    if part.certainty == "certain":
        return "certain"
    return "too small to be named as a cause" if 0 < part.fraction < rules.LISTED else "not certain"
