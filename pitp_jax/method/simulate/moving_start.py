"""Estimate the state in which records start to move, from the free runs of a model over their first samples.

    p = argmin sum (x(t; p) - y(t))^2 + r^2 |p - (mean y, 0, ..., mean y, mean u / max |u|)|^2,    r = 1e-3

p: the state S(0), and the level and the input at which all memories and effects are assumed settled. A store that is
slower than the record keeps the mean of the input, not u(0). Gauss-Newton, all records at once.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from ..model.model import Model
from ..signal.initial_state import INITIAL_SAMPLES, first_known
from ..signal.record import Record
from .decoder import settled_state
from .model_runs import evaluate, model_runs

_STEP, _ITERATIONS, _PRIOR = 1e-6, 12, 1e-3  # difference of a scaled state; Gauss-Newton; r
_SHORTER = 0.2  # of a step that overshoots


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
    counts, dt, order = [initial_samples(model, r) for r in records], records[0].dt, model.order
    given = list(zip(records, counts, strict=True))
    voltage = np.stack([np.pad(r.voltage[:n], (0, max(counts) - n), mode="edge") for r, n in given])
    y = np.stack([np.pad(r.displacement[:n], (0, max(counts) - n), constant_values=np.nan) for r, n in given])
    x = model.output.to_model(y) / model.scales.state[0]
    seen, size = np.isfinite(x), order + 2
    unit = np.abs(voltage).max() or 1.0
    best = np.zeros((len(records), size))
    best[:, [0, order]] = (np.nansum(x, 1) / np.maximum(seen.sum(1), 1))[:, None]
    best[:, -1] = [r.voltage.mean() / unit for r in records]
    prior, steps = best, _STEP * np.eye(size + 1, size, -1)

    def starts(rows):
        flat = rows.reshape(-1, size)
        age = np.repeat(ages, rows.shape[1])
        return evaluate(_settled, model, unit * flat[:, -1], age, *flat[:, :-1].T)

    def residuals(rows):
        runs = model_runs(model, np.repeat(voltage, rows.shape[1], axis=0), dt, starts(rows))[1]
        error = np.where(seen[:, None], runs.reshape(*rows.shape[:2], -1) - x[:, None], 0.0)
        return np.concatenate([error, _PRIOR * (rows - prior[:, None])], axis=2)

    for _ in range(_ITERATIONS):
        both = residuals(best[:, None] + steps)
        error = both[:, 0]
        slopes = (both[:, 1:] - error[:, None]).mT / _STEP
        finite = np.isfinite(both.sum((1, 2)))[:, None]  # a record whose runs diverge keeps its state
        inverse = np.linalg.pinv(np.where(finite[..., None], slopes, 0.0))
        move = -(inverse @ error[..., None])[..., 0]
        after = residuals((best + move)[:, None])[:, 0]
        better = (after**2).sum(1) < (error**2).sum(1)
        move = np.where(finite, np.where(better, 1.0, _SHORTER)[:, None] * move, 0.0)
        best = best + move
        if np.abs(move).max() < _STEP:
            break
    return starts(best[:, None])


def _settled(model: Model, row: Float[Array, " numbers"], *_) -> tuple[Array, Array]:
    return row, settled_state(model, row[2:-1], row[-1], row[0], row[1])
