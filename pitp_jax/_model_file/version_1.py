"""Read headers of version 1 (until 0.2), in which domain and origin were one `provenance` and notes in a text.

upgraded(header of version 1)  ->  header of version 2
"""

import json
import math
from typing import Any

import numpy as np

from .parts import decode, unpacked


def upgraded(header: dict) -> dict:
    """Return the header with provenance and notes moved to their places in version 2.

    Raises:
        KeyError, TypeError, ValueError: entries are missing or of another kind.
    """
    old = dict(header)
    source, notes = old.pop("provenance"), _values(old.pop("notes"))
    identified, training = notes.get("identification", {}), notes.get("training")
    row = next((row for row in identified.get("orders", []) if row.get("order") == old["order"]), {})
    adapted = notes.get("adapted", [])
    known = source if "misfit" in source else _uncertainty(row, identified, training)
    return old | {
        "long_record": old.get("long_record"),
        "domain": {
            **{name: source[name] for name in ("dt", "voltage_range", "slew", "region")},
            "clock": source.get("clock", 0.0),
        },
        "origin": {
            "displacement_unit": source["displacement_unit"],
            "voltage_unit": source["voltage_unit"],
            "covariance": known["covariance"],
            "stderr": [] if adapted else row.get("stderr", []),
            "misfit": known["misfit"],
            "noise": identified.get("noise_std", math.nan),
            "level": _level(old, row, training),
            "out_of_fold": identified.get("out_of_fold"),
            "remarks": identified.get("remarks", []),
            "identified_on": identified.get("records", []),
            "training": training,
            "adapted": adapted,
            "lineage": [entry for entry in notes.get("lineage", []) if isinstance(entry, dict)],
        },
    }


def _values(notes) -> dict[str, Any]:
    """Return the notes as values; they may be any text."""
    if isinstance(notes, str):
        try:
            notes = decode(json.loads(notes))
        except ValueError:
            return {}
    return notes if isinstance(notes, dict) else {}


def _uncertainty(row: dict, identified: dict, training: dict | None) -> dict:
    """Return covariance and misfit of files that stored them only in the notes."""
    covariance, noise = np.zeros((0, 0)), identified.get("noise_std")
    if training is not None:
        return {"covariance": [], "misfit": math.inf}
    if "correlation" in row:
        relative = np.asarray(row["stderr"], float) / np.asarray(row["coefficients"], float)
        covariance = np.asarray(row["correlation"], float) * np.outer(relative, relative)
    return {"covariance": covariance.tolist(), "misfit": max(row["rms"] / noise, 1.0) if row and noise else math.inf}


def _level(header: dict, row: dict, training: dict | None) -> float:
    """Return the error of free runs on the model's own records, % of range; nan if the notes do not state it."""
    errors = [e["error"] for e in (training or {}).get("history", []) if e.get("stage") == "free runs"]
    if training is not None:
        return math.sqrt(min(errors)) if errors else math.nan
    long = unpacked(header.get("long_record"))
    if long is None or "rms" not in row:
        return math.nan
    return 100 * row["rms"] / long.range
