"""Set the sensor's offset of a model where no recording shows it at rest.

    offset = median over records of    mean(y - d x),    x: free run, d: direction

Of recordings that start moving the offset is the reading that the model extrapolates to 0 V. A hardening spring rests
elsewhere than the linear model that it replaces: its offset was 3 mV off where its runs left 0.3 mV.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..model.model import Model
from ..signal.record import Record
from ..simulate.prediction import predict


def with_offset(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with the offset (base unit) of its free runs; its own if a record begins at rest or diverges."""
    runs = predict(model, records)
    if any(p.begins == "rest" or p.diverged for p in runs):
        return model
    left = [
        p.zero + np.nanmean((r.displacement - p.displacement)[p.scored]) for p, r in zip(runs, records, strict=True)
    ]
    return replace(model, output=replace(model.output, offset=float(np.median(left))))
