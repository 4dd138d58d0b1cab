"""Record a model's line of descent: every step that made it, the sums of the recordings it saw, versions, its parent.

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
    """Add one step to the model's notes."""
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
    except ValueError:  # notes are the user's to set: text of their own loses nothing but its lineage
        notes = {}
    notes["lineage"] = [*notes.get("lineage", []), entry]
    return replace(model, provenance=model.provenance.with_(notes=json.dumps(notes)))


def lineage(model: Model) -> list[dict]:
    """List all steps, oldest first; none for a model of before there were any."""
    try:
        steps = json.loads(model.provenance.notes).get("lineage", [])
    except (AttributeError, ValueError):
        return []
    # notes of a file are anybody's JSON: what is no step is passed over, so that `pitp info` still opens the model
    return [entry for entry in steps if isinstance(entry, dict)] if isinstance(steps, list) else []


def _sum(record: Record) -> dict:
    checksum, of = hashlib.sha256(), "samples"
    if os.path.isfile(record.source):
        of = "file"
        with open(record.source, "rb") as file:
            for block in iter(lambda: file.read(1 << 20), b""):  # a recording may be larger than the memory
                checksum.update(block)
    else:
        for series in (record.time, record.voltage, record.displacement):
            checksum.update(np.asarray(series, "<f8").tobytes())  # one byte order: the sum is the same on every machine
    return {"name": record.name, "sha256": checksum.hexdigest(), "of": of}
