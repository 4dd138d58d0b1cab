"""Check whether a model and recordings can belong to the same actuator."""

from collections.abc import Sequence

from ...common.errors import BadInput
from ...common.units import base_unit
from ...method.model.fitted import Fitted
from ...method.signal.record import Record
from ...method.signal.sets import RATE_TOLERANCE
from .console import say


def check_kind(model: Fitted, path: str, unit: str, source: str) -> None:
    """Refuse an output of another kind than the model's, for example volts for a model in metres.

    Raises:
        BadInput: naming both.
    """
    own = base_unit(model.origin.displacement_unit)
    if base_unit(unit) != own:
        raise BadInput(f"{source}: output in {unit}, but {path} predicts {own}; choose the column with --output-column")


def check_belongs(model: Fitted, path: str, records: Sequence[Record]) -> None:
    """Refuse records whose output is of another kind than the model's; warn about another sampling rate.

    Raises:
        BadInput: naming record and model.
    """
    for record in records:
        check_kind(model, path, record.displacement_unit, record.source)
    ratio = records[0].dt / model.dt
    if abs(ratio - 1.0) > RATE_TOLERANCE:
        say(
            f"warning: the recordings are sampled every {records[0].dt:.6g} s, those of {path} every {model.dt:.6g} "
            "s; expect larger errors with coarser sampling"
        )
