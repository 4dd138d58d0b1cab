"""Describe the missing force as an equation when no effect fits, with units and intervals.

    sum_i a_i x^(i) = F - f,   f = c1 x x' + c2 x^2 x' + c3 x' F        (`method.effects.found_term`)

It is fitted on whole free runs and scored out of fold like an effect. It acts like an effect in the model, but names no
cause.
"""

from dataclasses import dataclass

from ...common.quantity import Units
from ..effects.found_term import PRODUCTS, TERM
from ..model.units import units_of
from .gap import Gap
from .result import in_units
from .search import Hypothesis, Search


@dataclass(frozen=True)
class Term:
    """The missing force as an equation found in the data, with its parameters and the fraction it closes.

    Attributes:
        equation: sum_i a_i x^(i) = F - (this), with the parameters' names.
        parameters: name to value, unit, stderr and 95 % interval.
        closed_fraction, ci95: as those of a gap.
        after: out-of-fold error with the term, %.
        effect: the effect in the augmented model.
    """

    equation: str
    parameters: dict
    closed_fraction: float | None
    ci95: tuple[float, float] | None
    after: float
    effect: object

    def as_json(self) -> dict:
        """Return the term as the dict of docs/contract.md."""
        rows = {"equation": self.equation, "parameters": self.parameters, "closed_fraction": self.closed_fraction}
        return rows | {"ci95": list(self.ci95) if self.ci95 else None}


def term_of(search: Search, decision, handed: Hypothesis, made: tuple, errors: dict, gap: Gap) -> Term | None:
    """Return the missing force of the returned model as a term; None if the model has none."""
    pair = next(((e, names) for e, names in made[1] if e.spec == TERM), None)
    if pair is None:
        return None
    effect, names = pair
    rows = in_units(made[0], effect, names, handed.fit, errors)
    kept = {}
    for name, row in rows.items():
        near = [row["value"] - 1.96 * row["stderr"], row["value"] + 1.96 * row["stderr"]] if row["stderr"] else None
        kept[name] = row | {"ci95": near}
    beside = [e for e, _ in made[1] if e is not effect]
    line = equation(tuple(rows), beside, units_of(search.case.model))
    return Term(line, kept, gap.closed_fraction, gap.ci95, gap.after, effect)


def equation(coefficients: tuple[str, ...], beside: list, units: Units) -> str:
    """Write the missing force as an equation, such as `missing force = c1 x x' + c3 x' V^2`.

    An input that is not a voltage is written u, and the other effects are named.
    """
    drive = ("V" if units.input_word == "voltage" else "u") + ("^2" if units.squared else "")
    products = dict(zip((p.name for p in TERM.parameters), PRODUCTS, strict=True))
    terms = " + ".join(f"{c} {products[c].replace('F', drive)}" for c in coefficients)
    others = f", in addition to {' and '.join(f'{f.name} ({f.form})' for f in beside)}" if beside else ""
    return f"missing force = {terms}{others}"
