"""Cross-validate a training: the error on every record of a model that was trained without this record.

    for every record k:    nominal and training on the others  ->  e_k of the free run of record k

If fitted and predicted errors are similar, the records describe the actuator. If record k is predicted ten times worse
than fitted, either it contains something that no other record does, or the model has learned the records instead.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ...common.errors import BadInput, ComputationFailed
from ..model.expected_error import merged
from ..model.fitted import Fitted
from ..model.model import Model
from ..signal.excited import Table
from ..signal.initial_state import in_motion
from ..signal.record import Record
from .errors import errors, scores
from .training import train


@dataclass(frozen=True)
class HeldOut:
    """The errors of one record, e_rms in %: fitted with all records, and predicted by a model of the others.

    `problem`: why training on the other records failed; then `predicted` is infinite. `cells`: the predicted error by
    frequency and amplitude (`error_table`).
    """

    name: str
    fitted: float
    predicted: float
    problem: str = ""
    cells: Table = ()

    @property
    def suspect(self) -> bool:
        """Return whether the prediction error exceeds ten times the fitted error."""
        # not <= instead of >, because nan is suspect too
        return not self.predicted <= 10 * self.fitted


def with_held_out(model: Fitted, held_out: Sequence[HeldOut]) -> Fitted:
    """Store the errors of held-out recordings in the model's origin: % of range (None: training failed), and cells."""
    errors = {h.name: h.predicted if math.isfinite(h.predicted) else None for h in held_out}
    training = {**(model.origin.training or {}), "left_out_errors": errors}
    cells = merged([cell for h in held_out for cell in h.cells])
    return Fitted(model.model, replace(model.origin, training=training, errors=cells))


def cross_validate(
    nominal: Model | Fitted | Callable[[Sequence[Record]], Fitted],
    records: Sequence[Record],
    model: Model | Fitted,
    *,
    key,
    **options,
) -> tuple[HeldOut, ...]:
    """Train once without each record that moves, and predict this record.

    Args:
        nominal: the initial model, or a function that identifies one on given records, called once per record left out.
        records: the training records.
        model: trained on all of them, for the fitted errors.
        key, options: as for `train`.

    Raises:
        BadInput: fewer than two records move.

    Returns:
        per record the error of its free run, e_rms in % of its range, fitted and left out.

    Examples:
        >>> left_out = pitp.cross_validate(nominal, records, model, key=jax.random.key(0))  # doctest: +SKIP
    """
    moving, _ = in_motion(records)  # any model predicts a still record
    if len(moving) < 2:
        raise BadInput("cross-validation leaves out one recording at a time; give at least two recordings with motion")
    fitted = errors(model, moving)
    return tuple(
        _held_out(nominal, moving, k, float(fitted[k]), lambda r: train(*r, key=key, **options))
        for k in range(len(moving))
    )


def _held_out(nominal, records: Sequence[Record], k: int, fitted: float, trained: Callable) -> HeldOut:
    one, others = records[k], [r for j, r in enumerate(records) if j != k]
    try:
        start = nominal if isinstance(nominal, Model | Fitted) else nominal(others)
        blind = trained((start, others)).model
    except (BadInput, ComputationFailed) as error:  # only this fold fails; the others remain valid
        return HeldOut(one.name, fitted, float("inf"), str(error))
    (score,) = scores(blind, [one])
    return HeldOut(one.name, fitted, score.percent, cells=score.cells)
