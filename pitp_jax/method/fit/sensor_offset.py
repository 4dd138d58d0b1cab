"""Estimate the sensor offset of a model from its free runs, where no recording starts at rest.

    offset = median over records of    mean(y - d x),    y: reading, x: free run, d: direction

If every recording starts in motion, the offset is the reading at 0 V that a model extrapolates. A linear model and the
nonlinear one that replaces it have different mean displacements, so the offset of the first is wrong for the second.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..model.model import Model
from ..signal.record import Record
from ..simulate.prediction import predict


def with_offset(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with the sensor offset (base unit) of its free runs.

    The model keeps its own offset if a record starts at rest or a free run diverges.
    """
    runs = predict(model, records)
    if any(p.begins == "rest" or p.diverged for p in runs):
        return model
    left = [
        p.zero + np.nanmean((r.displacement - p.displacement)[p.scored]) for p, r in zip(runs, records, strict=True)
    ]
    return replace(model, output=replace(model.output, offset=float(np.median(left))))
