"""`pitp info`: what a model file holds and where it came from; of two, what differs."""

import math

from .._model.fitted import Fitted
from .._model_file.model_file import digest, load
from .console import number, print_table
from .outputs import check_files, write_json
from .reports import describe, in_words, print_model

_SAME = ("kind", "order", "input_map", "encoder", "memory_states", "hold", "substeps", "dt", "offset", "polarity")


def info(model, other, json_file) -> None:
    """Print a model's order, coefficients, modes, history and line of descent, or what differs between two.

    Args:
        model: model file.
        other: another one, or None.
        json_file: where to write the same for machines, or None.

    Raises:
        BadInput: not a usable model file.
    """
    check_files(json_file, inputs=[model, *([other] if other else [])])
    loaded = [load(path) for path in (model, other) if path]
    told = [traced(one) for one in loaded]
    found = differences(*loaded) if other else told[0]
    if json_file:
        write_json(json_file, found)
    if other:
        print_differences(found, model, other)
        return
    print_model(told[0])
    print_lineage(told[0])


def traced(model: Fitted) -> dict:
    """`describe`, the file's digest, what it was adapted to, and its line of descent."""
    origin = model.origin
    return {
        **describe(model),
        "digest": digest(model),
        "adapted": list(origin.adapted),
        "lineage": list(origin.lineage),
    }


def print_lineage(told: dict) -> None:
    """Every step with the sums of what it saw."""
    for entry in told["adapted"]:
        for name, c in entry["changed"].items():
            print(f"adapted: {name} times {number(c['factor'])} ({' to '.join(map(number, c['ci95']))})")
    print(f"this model: sha256 {told['digest']}")
    for entry in told["lineage"]:
        versions = ", ".join(f"{name} {value}" for name, value in entry.get("versions", {}).items())
        parent = f" from {entry['parent']}" if entry.get("parent") else ""
        print(f"{entry.get('step', '?')}{parent} with {versions}")
        for r in entry.get("records", []):
            print(f"  {r['sha256']}  {r['name']}{'' if r.get('of') == 'file' else ' (samples)'}")


def differences(a: Fitted, b: Fitted) -> dict:
    """What differs between two models: plain values, coefficients with intervals, effects, recordings, descent."""
    one, two = traced(a), traced(b)
    values = {k: [one[k], two[k]] for k in _SAME if one[k] != two[k]}
    voltage = [one["voltage_range"], two["voltage_range"]]
    if voltage[0] != voltage[1]:
        values["voltage_range"] = voltage
    sums = [{r["sha256"]: r["name"] for e in t["lineage"] for r in e.get("records", [])} for t in (one, two)]
    digests = [{e.get("parent") for e in t["lineage"]} for t in (one, two)]
    words = [[in_words(e) for e in t["effects"]] for t in (one, two)]
    return {
        "same": one["digest"] == two["digest"],
        "digests": [one["digest"], two["digest"]],
        "descends": "b from a" if one["digest"] in digests[1] else "a from b" if two["digest"] in digests[0] else None,
        "values": values,
        "coefficients": _ratios(one, two) if one["order"] == two["order"] else None,
        "adapted": [[e for e in t["adapted"] if e not in o["adapted"]] for t, o in ((one, two), (two, one))],
        "effects": [[w for w in mine if w not in others] for mine, others in (words, words[::-1])],
        "records": [[n for s, n in mine.items() if s not in others] for mine, others in (sums, sums[::-1])],
        "records_of_both": [n for s, n in sums[0].items() if s in sums[1]],
    }


def _ratios(one: dict, two: dict) -> list[dict]:
    """Second over first of every nominal coefficient, with the 95 % interval where both errors are known."""
    found = []
    pairs = (zip(t["coefficients"], t["coefficients_stderr"], strict=True) for t in (one, two))
    for i, ((a, da), (b, db)) in enumerate(zip(*pairs, strict=True)):
        ratio, interval = b / a, None
        if da is not None and db is not None:
            wide = math.exp(1.96 * math.hypot(da / a, db / b))
            interval = [ratio / wide, ratio * wide]
        found.append({"name": f"a{i}", "ratio": ratio, "ci95": interval})
    return found


def print_differences(found: dict, first: str, second: str) -> None:
    """On standard output."""
    if found["same"]:
        print(f"{first} and {second} hold the same model")
        return
    names = {"a from b": (first, second), "b from a": (second, first)}
    if found["descends"]:
        print("{} was made from {}".format(*names[found["descends"]]))
    rows = [(name, *(_cell(v) for v in pair)) for name, pair in found["values"].items()]
    if rows:
        print_table(("", first, second), rows)
    if found["coefficients"] is None:
        print("coefficients of different orders cannot be compared")
    else:
        table = [(c["name"], number(c["ratio"], 5), "-" if c["ci95"] is None else " to ".join(map(number, c["ci95"])))
                 for c in found["coefficients"]]  # fmt: skip
        print_table(("coefficient", f"{second} / {first}", "95 % interval"), table)
    for path, adapted, effects, records in zip(
        (first, second), found["adapted"], found["effects"], found["records"], strict=True
    ):
        for entry in adapted:
            for name, c in entry["changed"].items():
                print(f"{path}: {name} times {number(c['factor'])} ({' to '.join(map(number, c['ci95']))})")
        for effect in effects:
            print(f"only {path}: with {effect}")
        if records:
            print(f"only {path} saw {', '.join(records)}")
    if found["records_of_both"]:
        print(f"both saw {', '.join(found['records_of_both'])}")


def _cell(value) -> str:
    if isinstance(value, (list, tuple)):
        return " to ".join(map(_cell, value))
    return number(value) if isinstance(value, float) else str(value)
