"""Estimate the state in which records start to move, from the free runs of a model over their first samples.

    p = argmin sum (x(t; s + w p) - y(t))^2 + r^2 |p|^2,    r = 1e-3

s: the equilibrium of mean y and mean u.    w: 1 for S; for each state of memories and effects, the larger of its range
over the run from s and its distance from the equilibrium of the highest |u|.    All states are unknown, except a clock:
a loop starts with any force inside it, and a store that is slower than the record keeps a charge from before it.
Levenberg and Marquardt with several dampings at once, all records at once.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from ..model.model import Model
from ..signal.initial_state import INITIAL_SAMPLES, first_known
from ..signal.record import Record
from .decoder import still_state
from .model_runs import evaluate, model_runs, padded

_STEP, _ITERATIONS, _PRIOR = 1e-6, 20, 1e-3  # difference of a number; of Levenberg and Marquardt; r
# of the largest singular value, tried at once; the first keeps the state
_DAMPINGS = np.append([np.inf, 0.0], np.geomspace(1e-3, 1, 7))
_ENOUGH, _LOST = 0.999, 1e6  # of the cost, which a step must leave at most; scaled error of a run that diverges


def still(model: Model, row: Float[Array, "3"], *_) -> tuple[Array, Array]:
    """Compute the equilibrium state of a scaled displacement, a voltage (V) and an age (s), for `evaluate`."""
    return row, still_state(model, *row)


def initial_samples(model: Model, record: Record) -> int:
    """Return the number of samples used to estimate the initial state of a record that begins in motion.

    1.5 periods of the dominant mode, at least 50 samples, at most a quarter of the record; after an initial gap they
    follow the gap.
    """
    omega = model.natural_frequency
    periods = 3 * np.pi / (omega * record.dt) if omega > 0 else np.inf
    count = round(min(max(INITIAL_SAMPLES, periods), record.samples // 4))
    return min(first_known(record) + count, record.samples)


@np.errstate(over="ignore", invalid="ignore")  # of runs that diverge
def moving_states(
    model: Model, records: Sequence[Record], ages: Float[np.ndarray, " records"]
) -> Float[np.ndarray, "records state"]:
    """Estimate the scaled initial state of records from their first samples, read with the model's sensor.

    Args:
        model: any.
        records: of one sampling rate.
        ages: of the film at their first samples, s.
    """
    counts, dt = [initial_samples(model, r) for r in records], records[0].dt
    given = list(zip(records, counts, strict=True))
    voltage = padded([r.voltage[:n] for r, n in given])
    y = np.stack([np.pad(r.displacement[:n], (0, max(counts) - n), constant_values=np.nan) for r, n in given])
    x = model.output.to_model(y) / model.scales.state[0]
    seen = np.isfinite(x)
    mean, volts = np.nansum(x, 1) / np.maximum(seen.sum(1), 1), [r.voltage.mean() for r in records]
    centre = evaluate(still, model, mean, volts, ages)
    far = evaluate(still, model, 1.0, np.abs(voltage).max(1), ages)
    path = np.where(seen[..., None], model_runs(model, voltage, dt, centre)[0], centre[:, None])
    unit = np.maximum(np.ptp(path, axis=1), np.abs(far - centre))
    unit[:, : model.order] = 1.0
    unit = np.where(evaluate(still, model, mean, volts, ages + 1) == centre, np.nan_to_num(unit), 0.0)
    best, size = np.zeros_like(centre), len(centre[0])

    def residuals(rows):
        begun = (centre[:, None] + unit[:, None] * rows).reshape(-1, size)
        runs = model_runs(model, np.repeat(voltage, rows.shape[1], axis=0), dt, begun)[1].reshape(*rows.shape[:2], -1)
        # a run that diverges is a large error, so that no step leads there
        error = np.clip(np.nan_to_num(runs, nan=_LOST), -_LOST, _LOST) - x[:, None]
        return np.concatenate([np.where(seen[:, None], error, 0.0), _PRIOR * rows], axis=2)

    for _ in range(_ITERATIONS):
        both = residuals(best[:, None] + _STEP * np.eye(size + 1, size, -1))
        error, slopes = both[:, :1], (both[:, 1:] - both[:, :1]).mT / _STEP
        left, sizes, right = np.linalg.svd(slopes, full_matrices=False)
        damped = sizes[:, None] / (sizes[:, None] ** 2 + (_DAMPINGS * sizes[:, :1])[..., None] ** 2)
        tried = best[:, None] - damped * (error @ left) @ right
        costs = (residuals(tried) ** 2).sum(2)
        costs[:, 0] *= _ENOUGH
        chosen = costs.argmin(1)
        best = tried[np.arange(len(tried)), chosen]
        if not chosen.any():
            break
    return centre + unit * best
