"""Read the recordings of a command, report what was recognised, and check whether they can belong to its model."""

from collections.abc import Sequence

from ...common.errors import BadInput
from ...common.units import base_unit
from ...files.model_file.model_file import load
from ...files.recordings.plausible import monitor_warning
from ...files.recordings.reading import read
from ...files.recordings.remarks import Remark, by_kind
from ...method.model.fitted import Fitted
from ...method.model.input_map import SquareInput, usual_input_map
from ...method.signal.record import Record
from ...method.signal.sets import RATE_TOLERANCE
from .console import say
from .reports import listed


def read_records(paths: Sequence[str], reading: dict, *, input_map: str | None) -> tuple[Record, ...]:
    """Read recordings, and print what was recognised, what was masked, and what looks wrong.

    Args:
        paths: files and folders; without any, no records are returned.
        reading: keyword arguments of `pitp.read`.
        input_map: name of the input map, as far as it is known; None: by units.

    Raises:
        BadInput: as `pitp.read`.
    """
    if not paths:
        return ()
    records = read(*paths, **reading)
    for line in recognised(records):
        say(line)
    if input_map is None:
        input_map = usual_input_map(records[0])
    if input_map == SquareInput.name and (warning := monitor_warning(records)):
        say(f"warning: {warning}")
    return records


def open_both(model: str, records: Sequence[str], reading: dict) -> tuple[Fitted, tuple[Record, ...]]:
    """Load a model, and read recordings that can belong to it.

    Args:
        model: model file.
        records: files and folders.
        reading: keyword arguments of `pitp.read`.

    Raises:
        BadInput: one cannot be read, or they do not belong together.
    """
    loaded = load(model)
    read_in = read_records(records, reading, input_map=loaded.input_map.name)
    check_belongs(loaded, model, read_in)
    return loaded, read_in


def warn(records: Sequence[Record]) -> None:
    """Print the warnings of `pitp check` that need no fit, on standard error."""
    from ..check.one_record import quick_problems  # imported here: a third of a command's modules

    for line in quick_problems(records):
        say(f"warning: {line}")


def recognised(records: Sequence[Record]) -> list[str]:
    """Write a line for every kind of file among the records, then one for every kind of remark."""
    kinds: dict[str, list[str]] = {}
    remarks: list[Remark] = []
    for record in records:
        seen = record.recognised
        if seen:
            kind = f"{seen['file']}; time {seen['time']}, input {seen['input']}, output {seen['output']}"
            kinds.setdefault(kind, []).append(record.name)
            remarks += seen["findings"]
    return [f"read {listed(names, 3)}: {kind}" for kind, names in kinds.items()] + by_kind(remarks)


def check_kind(model: Fitted, path: str, unit: str, source: str, stem: str = "output") -> None:
    """Refuse an input or an output of another kind than the model's, for example volts for a model in metres.

    Raises:
        BadInput: naming both.
    """
    own = base_unit({"input": model.origin.voltage_unit, "output": model.origin.displacement_unit}[stem])
    if base_unit(unit) != own:
        raise BadInput(
            f"{source}: {stem} in {unit}, but {path} {'predicts' if stem == 'output' else 'needs'} {own}; choose the "
            f"column with --{stem}-column, or give the column's --{stem}-unit"
        )


def check_belongs(model: Fitted, path: str, records: Sequence[Record]) -> None:
    """Refuse records whose input or output is of another kind than the model's; warn about another sampling rate.

    Raises:
        BadInput: naming record and model.
    """
    for record in records:
        check_kind(model, path, record.displacement_unit, record.source)
        check_kind(model, path, record.voltage_unit, record.source, "input")
    warn_of_rate(model, path, "the recordings are", records[0].dt)


def warn_of_rate(model: Fitted, path: str, what: str, dt: float) -> None:
    """Warn if `what` is sampled at another rate than the model's recordings."""
    if abs(dt / model.dt - 1) > RATE_TOLERANCE:
        say(
            f"warning: {what} sampled every {dt:.6g} s, those of {path} every {model.dt:.6g} s; expect larger errors "
            "with coarser sampling"
        )
