"""Compare two models: responses, facts, coefficients by meaning, effects and origins.

    a_0 x + a_1 x' + a_2 x'' + ... = F      stiffness a_0, damping a_1, inertia a_2 (of a linear model)

Coefficients are compared between two linear models alone: an encoder changes the tokens of a trained model over the
stroke, so its responses are compared instead (`behaviour`). Coefficients of different orders have different meanings
beyond a_0; then the modes are compared instead.
"""

from ...files.model_file.model_file import digest, lineage_of
from ...method.effects.words import coefficient_meaning
from ...method.model.fitted import Fitted
from ...method.model.units import base_units, units_of
from .behaviour import compare_behaviour
from .description import describe
from .result import Comparison, Difference, measured, stated


def compare_models(a: Fitted, b: Fitted, names: tuple[str, str]) -> Comparison:
    """Compare the responses, facts and parameters of two models."""
    # both in the units of the first, because one value in deg and one in rad would differ by 57
    same_kinds = base_units(units_of(a)) == base_units(units_of(b))
    one, two = describe(a), describe(b, units_of(a) if same_kinds else None)
    rows, remarks = compare_behaviour(a, b)
    rows += _adapted_rows(a, b)
    facts = {
        "kind": "kind", "order": "order", "input_map": "input map", "encoder": "encoder",
        "memory_states": "memory states", "hold": "hold of the input", "dt": "sampling interval (s)",
        "polarity": "direction of the sensor", "voltage_range": "input seen",
    }  # fmt: skip
    rows += [stated(words, one[key], two[key]) for key, words in facts.items()]
    rows.append(measured("zero of the sensor", one["offset"], two["offset"], one["output_unit"], (0.0, 0.0)))
    if one["kind"] == two["kind"] == "identified":
        rows += _coefficients(one, two) if one["order"] == two["order"] else _modes(one, two)
    rows += _effects(one["effects"], two["effects"])
    return Comparison("models", names, tuple(rows), (*remarks, *_origin(a, b, names)))


def _adapted_rows(a: Fitted, b: Fitted) -> list[Difference]:
    """Return rows of the factors by which `adapt` changed one of the models but not the other."""
    rows = []
    for k, (mine, other) in enumerate(((a, b), (b, a))):
        for entry in mine.origin.adapted:
            if entry in other.origin.adapted:
                continue
            for name, c in entry["changed"].items():
                low, high = (float(end) - 1 for end in c["ci95"])
                factor, what = float(c["factor"]), f"{name}: factor found by adapt"
                here, there, interval = (1.0, factor, (low, high)) if k else (factor, 1.0, (-high, -low))
                rows.append(Difference(what, here, there, "", interval, low > 0 or high < 0))
    return rows


def _coefficients(one: dict, two: dict) -> list[Difference]:
    """Compare the coefficients that both linear models have."""
    rows = zip(one["coefficients"], two["coefficients"], one["coefficients_unit"], one["coefficients_stderr"],
               two["coefficients_stderr"], strict=False)  # fmt: skip
    return [measured(coefficient_meaning(i), x, y, unit, (e, f)) for i, (x, y, unit, e, f) in enumerate(rows)]


def _modes(one: dict, two: dict) -> list[Difference]:
    """Compare static stiffness and least damped mode of two linear models of different order."""
    stiffness = _coefficients(one, two)[0]
    # a heavily damped pole has no frequency of its own to compare
    here, there = (
        min((m for m in t["modes"] if m["oscillates"]), key=lambda m: m["damping"], default=None) for t in (one, two)
    )
    if here is None or there is None:
        return [stiffness]
    return [
        stiffness,
        measured("frequency of the least damped mode", here["natural_hz"], there["natural_hz"], "Hz"),
        measured("damping ratio of that mode", here["damping"], there["damping"], ""),
    ]


def _effects(one: list[dict], two: list[dict]) -> list[Difference]:
    """Compare the parameters of the effects in both models; model files hold no standard errors of them."""
    sides = [{(e["effect"], e["form"]): e["parameters"] for e in effects} for effects in (one, two)]
    rows = []
    for key in dict.fromkeys([*sides[0], *sides[1]]):
        for name in sides[0].get(key) or sides[1][key]:
            x, y = (side.get(key, {}).get(name) for side in sides)
            unit = (x or y or {}).get("unit", "")
            here, there = (v and float(v["value"]) for v in (x, y))
            rows.append(measured(f"{key[0]} ({key[1]}): {name}", here, there, unit))
    return rows


def _origin(a: Fitted, b: Fitted, names: tuple[str, str]) -> list[str]:
    """Write lines on what the models were made from: parents, and recordings of one or both."""
    # by their checksums, because two rigs may use the same names
    sums: list[dict[str, str]] = [
        {r["sha256"]: r["name"] for e in m.origin.lineage for r in e.get("records", [])} for m in (a, b)
    ]
    parents = [{e.get("parent") for e in lineage_of(m)} for m in (a, b)]
    digests = [digest(m) for m in (a, b)]
    if digests[0] == digests[1]:  # also of two files whose names or dates differ
        return ["Both hold the same model."]
    lines = []
    for k, mine in enumerate(sums):  # either may be the older one
        if digests[k] in parents[1 - k]:
            lines.append(f"{names[1 - k]} was made from {names[k]}.")
        only = [name for s, name in mine.items() if s not in sums[1 - k]]
        if only:
            lines.append(f"Only {names[k]} saw {', '.join(only)}.")
    both = [name for s, name in sums[0].items() if s in sums[1]]
    if both:
        lines.append(f"Both saw {', '.join(both)}.")
    return lines
