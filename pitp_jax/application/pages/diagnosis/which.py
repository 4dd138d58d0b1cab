"""Write the effect card: form and parameters with units, ties, or the reason why no effect is reported."""

import numpy as np

from ....common.numbers import of_range, percent, with_error
from ....method.diagnose.diagnosis import Diagnosis
from ....method.diagnose.result import Ranked
from .. import html
from ..html import tag
from .formatting import coefficient_name, named, parameter
from .gap_figure import refitted
from .words import numbers_of

_NEAREST = 3  # rejected candidates named


def which(d: Diagnosis) -> str:
    """Return the card with the reported effects, or with the reason why none is reported, as HTML."""
    if d.effects:
        lines = [_effect(d, name) for name in d.effects]
        if refitted(d):
            lines.append(
                tag("p", "The model's own coefficients, fitted as well (factor on the given ones):")
                + html.bullets(_shift(d))
            )
        return html.card("Which", named(d.effects), *lines, tag("p", _rivals(d)))
    if d.verdict == "no_gap":
        return html.card("Which", "None", tag("p", "No effect reduces the error below the model's own error."))
    nearest = [f"{r.effect}: closes {fraction_closed(r.closed_fraction)}" for r in d.ranking]
    why = tag("p", d.reason) if d.reason else ""
    return html.card(
        "Which",
        "No single cause is certain",
        _term(d),
        why,
        tag("p", "The best candidates:"),
        html.bullets(nearest[:_NEAREST]),
    )


def _term(d: Diagnosis) -> str:
    """Return the equation found in the data, with its parameters, as HTML."""
    if d.term is None:
        return ""
    share = fraction_closed(d.term.closed_fraction)
    line = f"The missing force as an equation found in the data (a description, not a cause) closes {share} of the gap:"
    numbers = [_line(d, name, number) for name, number in d.term.parameters.items()]
    return tag("p", line) + tag("p", d.term.equation) + html.bullets(numbers)


def _rivals(d: Diagnosis) -> str:
    """Describe the effects tied with the reported one, or the next best effect, in a sentence."""
    if d.equivalent:
        return f"These recordings do not separate {d.effects[0]} from {named(d.equivalent)}."
    others = [r for r in d.ranking if r.effect not in d.effects]
    if not others:
        return "No other effect is close."
    error, closed = of_range(others[0].heldout), fraction_closed(others[0].closed_fraction)
    return f"Next best: {others[0].effect} with an error of {error} (closes {closed})."


def fraction_closed(value: float | None) -> str:
    """Return a closed fraction as text."""
    return "nothing" if value is None or value < 0.005 else percent(value)


def _effect(d: Diagnosis, name: str) -> str:
    """Return one reported effect as HTML: its form and its parameters in the returned model."""
    part = next((p for p in d.parts if p.effect == name), None)
    if part is None:
        return ""
    title = f"{name}, form “{part.form}”" if len(d.effects) > 1 else f"Form “{part.form}”"
    p = part.probability
    sure = tag("p", f"P {p:.2f} that it is better than the best set without it.") if p is not None else ""
    return tag("p", title) + html.bullets(numbers_of(d, part, " = ")) + sure


def _line(d: Diagnosis, name: str, number: dict) -> str:
    label, text = parameter(name, number, d.model.origin.displacement_unit)
    return f"{label} = {text}"


def parameter_lines(d: Diagnosis, row: Ranked) -> list[str]:
    """Return the parameters of a candidate effect, one text each."""
    return [_line(d, name, number) for name, number in row.parameters.items()]


def _shift(d: Diagnosis) -> list[str]:
    """Return the refitted coefficients over the given ones as texts, with standard errors if known."""
    row = next((r for r in d.ranking if r.effect == "parameter_change"), None)
    order, lines = len(d.shift) - 1, []
    for i, factor in enumerate(d.shift):
        number = row.parameters.get(f"a_{i} over given") if row else None
        near = number is not None and np.isclose(number["value"], factor, rtol=1e-2)
        error = number["stderr"] if number and near else None
        lines.append(f"{coefficient_name(i, order)}: × {with_error(float(factor), error, '')}")
    return lines
