"""Average an oversampled record over blocks of samples: a linear system keeps the relation of input and output.

F_k = mean_{t in block k} F_t,    y_k = mean over the observed t of block k of y_t
"""

import numpy as np
from jaxtyping import Float

from .record import Record


def averaged(record: Record, force: Float[np.ndarray, " time"], size: int) -> Record:
    """The record in means over blocks of `size` samples, with the force (V^2 or V) in the voltage's place.

    Not the voltage: the mean of a square is not the square of the mean. A block of which less than half was observed
    is missing.
    """
    count = record.samples // size
    seen = record.observed[: count * size].reshape(count, size)
    y = np.where(seen, record.displacement[: count * size].reshape(count, size), 0.0).sum(1)
    observed = seen.sum(1)
    # a half or more of the block was observed
    y = np.where(2 * observed >= size, y / np.maximum(observed, 1), np.nan)
    # a mean belongs to the middle of its block
    middle = record.time[0] + record.dt * ((size - 1) / 2 + size * np.arange(count))
    force = force[: count * size].reshape(count, size).mean(1)
    return Record(record.name, middle, force, y, source=record.source)
