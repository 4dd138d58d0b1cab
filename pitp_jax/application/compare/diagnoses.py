"""Compare two diagnoses: verdicts, effects with their parameters, and the error before and after.

Both are read as JSON, so that a diagnosis saved by an older version, or by another rig, can be one of the two.
"""

from .result import Comparison, Difference, measured, stated

_GAP = {"before": "gap before", "after": "gap after", "noise_floor": "noise floor"}


def compare_diagnoses(a: dict, b: dict, names: tuple[str, str]) -> Comparison:
    """Compare all results of two diagnoses that are given as their JSON."""
    rows = [stated("verdict", a["verdict"], b["verdict"]), stated("effects", a["effects"], b["effects"])]
    rows.append(stated("handed back", a.get("handed_back") or [], b.get("handed_back") or []))
    first = [d["ranking"][0]["effect"] if d.get("ranking") else None for d in (a, b)]
    rows.append(stated("best single effect", *first))
    rows += _effects(a, b)
    rows += _parts(a.get("parts") or [], b.get("parts") or [], {*a["effects"], *b["effects"]})
    rows += [
        measured(words, _number(a["gap"].get(key)), _number(b["gap"].get(key)), "% of range", (None, None))
        for key, words in _GAP.items()
    ]
    closed = [{"share": d["gap"].get("closed_fraction"), "ci95": d["gap"].get("ci95")} for d in (a, b)]
    rows.append(_portion("fraction of the gap that is closed", *closed))
    rows += _budget(a.get("budget") or {}, b.get("budget") or {})
    remarks = []
    for name, d in zip(names, (a, b), strict=True):
        if d.get("equivalent"):
            first, others = d["effects"][0] if d["effects"] else "the best candidate", ", ".join(d["equivalent"])
            remarks.append(f"{name}: these recordings do not separate {first} from {others}.")
    return Comparison("diagnoses", names, tuple(r for r in rows if (r.a, r.b) != (None, None)), tuple(remarks))


def _number(value) -> float | None:
    return None if value is None else float(value)


def _effects(a: dict, b: dict) -> list[Difference]:
    """Compare the parameters of all effects that either diagnosis reports, as the rankings hold them."""
    rows = []
    # backwards, so that of several forms of one effect the best ranked one remains
    tables = [{r["effect"]: r for r in reversed(d.get("ranking", []))} for d in (a, b)]
    for name in dict.fromkeys([*a["effects"], *b["effects"]]):
        sides = [table.get(name, {}).get("parameters", {}) for table in tables]
        forms = [table.get(name, {}).get("form") for table in tables]
        if forms[0] != forms[1] and None not in forms:  # parameters of two forms have different meanings
            rows.append(stated(f"form of {name}", *forms))
            continue
        for key in dict.fromkeys([*sides[0], *sides[1]]):
            x, y = (side.get(key, {}) for side in sides)
            errors = (_number(x.get("stderr")), _number(y.get("stderr")))
            unit = x.get("unit") or y.get("unit") or ""
            rows.append(
                measured(
                    f"{name}: {key}", _number(x.get("value")), _number(y.get("value")), unit.replace("1", ""), errors
                )
            )
    return rows


def _parts(a: list[dict], b: list[dict], told: set[str]) -> list[Difference]:
    """Compare the parameters of the parts of both returned models, without the effects that a verdict reports."""
    sides = [{(p["effect"], p["form"]): p["parameters"] for p in parts if p["effect"] not in told} for parts in (a, b)]
    rows = []
    for key in dict.fromkeys([*sides[0], *sides[1]]):
        for name in sides[0].get(key) or sides[1][key]:
            x, y = (side.get(key, {}).get(name, {}) for side in sides)
            # a lower bound has no upper end
            ends = [e.get("ci95") or (None, None) for e in (x, y)]
            errors = [None if low is None or high is None else (high - low) / 3.92 for low, high in ends]
            values = (_number(x.get("value")), _number(y.get("value")))
            unit = x.get("unit") or y.get("unit") or ""
            rows.append(measured(f"{key[0]} ({key[1]}): {name}", *values, unit, (errors[0], errors[1])))
    return rows


def _portion(what: str, one: dict, two: dict) -> Difference:
    """Compare a fraction in both diagnoses, with a standard error from its 95 % interval."""
    errors = [(e["ci95"][1] - e["ci95"][0]) / 3.92 if e.get("ci95") else None for e in (one, two)]
    return measured(what, _number(one.get("share")), _number(two.get("share")), "", (errors[0], errors[1]))


def _budget(a: dict, b: dict) -> list[Difference]:
    words = {"nuisance": "sensor offsets and directions", "parameters": "moved parameters", "simulator": "the "
    "simulator's model",
             "unnamed": "predictable from the input, no single cause certain", "unexplainable": "not "
             "explainable"}  # fmt: skip
    rows = [_portion(f"of the gap: {w}", a.get(k, {}), b.get(k, {})) for k, w in words.items() if k in a or k in b]
    effects = [d.get("effects", {}) for d in (a, b)]
    names = dict.fromkeys([*effects[0], *effects[1]])
    return rows + [_portion(f"of the gap: {n}", effects[0].get(n, {}), effects[1].get(n, {})) for n in names]
