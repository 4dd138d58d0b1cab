"""Record the lineage of a model: every processing step, checksums of its recordings, versions, its parent.

    step = {"step", "versions", "parent": digest | null, "records": [{"name", "sha256", "of": "file" | "samples"}]}

A digest is the SHA-256 on a model file's second line. Until a model is written, its parent is the model itself
(`model_file.lineage_of`). A recording from a file has the sum of that file, as `sha256sum` prints it; any other
recording has the sum of its samples t, u, y (little-endian float64, one series after the other).
"""

import hashlib
import os
import platform
from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from ... import __version__
from ..signal.record import Record
from .fitted import Fitted, fitted_of
from .model import Model


def descended(
    model: Model | Fitted, step: str, records: Sequence[Record], parent: Model | Fitted | None = None
) -> Fitted:
    """Return the model with one processing step added to its lineage."""
    versions = {
        "pitp_jax": __version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    entry = {"step": step, "versions": versions, "parent": parent and fitted_of(parent), "records": sums(records)}
    fitted = fitted_of(model)
    return replace(fitted, origin=replace(fitted.origin, lineage=(*fitted.origin.lineage, entry)))


def sums(records: Sequence[Record]) -> list[dict]:
    """Return name and SHA-256 of each recording: of its file, or of its samples if there is no file."""
    return [_sum(r) for r in records]


def was_made_from(model: Model | Fitted, records: Sequence[Record]) -> bool:
    """Return whether every one of these recordings was used in some step of the model's lineage."""
    seen = {r["sha256"] for entry in fitted_of(model).origin.lineage for r in entry.get("records", ())}
    return bool(seen) and all(one["sha256"] in seen for one in sums(records))


def _sum(record: Record) -> dict:
    if os.path.isfile(record.source):
        with open(record.source, "rb") as file:
            return {"name": record.name, "sha256": hashlib.file_digest(file, "sha256").hexdigest(), "of": "file"}
    series = np.stack([record.time, record.voltage, record.displacement])
    checksum = hashlib.sha256(series.astype("<f8").tobytes())  # one byte order: equal sums on every machine
    return {"name": record.name, "sha256": checksum.hexdigest(), "of": "samples"}
