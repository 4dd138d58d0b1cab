"""A diagnosis in two to six lines: each effect in plain words with its numbers, what it closes, what is left."""

from ..._model.units import units_of
from .formatting import named, parameter, plain_words


def lines(d) -> list[str]:
    """For the terminal."""
    g = d.gap
    error = f"out-of-fold error {g.before:.3g} -> {g.after:.3g} % of range"
    if d.verdict == "no_gap":
        return [
            f"verdict: no_gap. The model's error, {g.before:.3g} % of range, is its own: there is no effect to add."
        ]
    said = [f"verdict: {d.verdict}" + (f" by {named(d.effects)}" if d.effects else "")]
    for name in d.effects:
        row = d.budget["effects"].get(name) or d.budget["parameters"]
        share, p = row["share"], row.get("probability", d.probability.get(name))
        numbers = _numbers(d, name)
        sure = f" (P {p:.2f})" if p is not None else ""
        tied = row.get("equivalent") or ()
        alike = f"; these records cannot tell it from {named(tied)}" if tied else ""
        told = f"{plain_words(name, units_of(d.model))}{numbers}"
        said.append(f"{name}: {told}; explains {100 * share:.0f} % of the gap{sure}{alike}")
    if d.term is not None:
        said.append(f"{d.term.equation}: closes {100 * (d.term.closed_fraction or 0):.0f} %, -> {d.term.after:.3g} %")
    back = (
        f"; handed back: the nominal with {named(d.handed_back)}" if d.handed_back else "; the nominal is handed back"
    )
    said.append(error + back)
    b = d.budget
    rest = [
        f"{100 * b[k]['share']:.0f} % {text}"
        for k, text in (("unnamed", "explainable without a name"), ("unexplainable", "not from the input"))
    ]
    said.append("of the gap's energy: " + ", ".join(rest))
    said.append(d.where["summary"])
    return said


def _numbers(d, name: str) -> str:
    mine = next((a for a in d.added if a.effect == name), None)
    if mine is None:
        return ""
    unit = d.model.origin.displacement_unit
    texts = [f"{label} {text}" for label, text in (parameter(k, v, unit) for k, v in mine.parameters.items())]
    return f", {', '.join(texts)}"
