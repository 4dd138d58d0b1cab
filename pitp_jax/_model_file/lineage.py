"""The line of descent of a model: every step that made it, the sums of the recordings it saw, versions, its parent.

    step = {"step", "versions", "parent": digest | null, "records": [{"name", "sha256", "of": "file" | "samples"}]}

A digest is the SHA-256 on a model file's second line. A recording from a file has the sum of that file, as `sha256sum`
prints it; any other the sum of its samples t, u, y (little-endian float64, one series after the other).
"""

import hashlib
import json
import os
import platform
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from .. import __version__
from .._errors import BadInput
from .._model.model import Model
from .._record.record import Record
from .model_file import digest


def descended(model: Model, step: str, records: Sequence[Record], parent: Model | None = None) -> Model:
    """The model with one step more in its notes."""
    versions = {
        "pitp_jax": __version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    try:
        known = None if parent is None else digest(parent)
    except BadInput:  # a part of one's own, which no file holds
        known = None
    entry = {"step": step, "versions": versions, "parent": known, "records": [_sum(r) for r in records]}
    try:
        notes = json.loads(model.provenance.notes)
    except ValueError:
        notes = {}
    notes["lineage"] = [*notes.get("lineage", []), entry]
    return replace(model, provenance=model.provenance.with_(notes=json.dumps(notes)))


def lineage(model: Model) -> list[dict]:
    """All steps, oldest first; none for a model of before there were any."""
    try:
        found = json.loads(model.provenance.notes).get("lineage", [])
    except (AttributeError, ValueError):
        return []
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def _sum(record: Record) -> dict:
    found, of = hashlib.sha256(), "samples"
    if os.path.isfile(record.source):
        of = "file"
        with open(record.source, "rb") as file:
            for block in iter(lambda: file.read(1 << 20), b""):
                found.update(block)
    else:
        for series in (record.time, record.voltage, record.displacement):
            found.update(np.asarray(series, "<f8").tobytes())
    return {"name": record.name, "sha256": found.hexdigest(), "of": of}
