"""`pitp info`: prints what a model file holds and how the model was made."""

from pathlib import Path

from ...common.errors import BadInput
from ...files.model_file.model_file import file_digest, load
from ...method.simulate.model_runs import way_of
from ..compare.description import describe
from .console import number
from .outputs import check_outputs, write_json
from .reports import print_model


def info(model, others, json_file) -> None:
    """Print a model's order, coefficients, modes, training history and lineage.

    Args:
        model: model file.
        others: further files; must be empty.
        json_file: where to write the same as JSON, or None.

    Raises:
        BadInput: not a usable model file, or more than one.
    """
    if others:
        raise BadInput(f"info describes one model; to see the differences: pitp compare {model} {others[0]}")
    check_outputs(json_file, inputs=[model])
    loaded = load(model)
    origin = loaded.origin
    summary = {
        **describe(loaded),
        "digest": file_digest(Path(model)),
        "adapted": list(origin.adapted),
        "lineage": list(origin.lineage),
    }
    write_json(json_file, summary)
    print_model(loaded, summary)
    print(f"free runs: {way_of(loaded.model)}")
    print_lineage(summary)


def print_lineage(summary: dict) -> None:
    """Print adaptations and every step by which the model was made, with checksums of the recordings."""
    for entry in summary["adapted"]:
        for name, c in entry["changed"].items():
            interval = " to ".join(map(number, c["ci95"]))
            print(f"adapted: {name} times {number(c['factor'])} ({interval})")
    print(f"this model: sha256 {summary['digest']}")
    for entry in summary["lineage"]:
        versions = ", ".join(f"{name} {value}" for name, value in entry.get("versions", {}).items())
        parent = f" from {entry['parent']}" if entry.get("parent") else ""
        print(f"{entry.get('step', '?')}{parent} with {versions}")
        for r in entry.get("records", []):
            print(f"  {r['sha256']}  {r['name']}{'' if r.get('of') == 'file' else ' (samples)'}")
