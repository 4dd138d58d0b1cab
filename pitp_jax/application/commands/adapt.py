"""`pitp adapt`: adapts a model to the same actuator on another day, from one short recording."""

from ...files.model_file.model_file import save
from ...files.recordings.writing import write_bytes_atomic
from ...method.adapt.adaptation import Adaptation
from ...method.adapt.adaptation import adapt as run_adaptation
from .console import Table, number, print_table
from .outputs import check_outputs, staged
from .recordings import open_both


def adapt(model, records, out, json_file, reading) -> None:
    """Adapt a model to a new recording, write the model file, and print what changed.

    Args:
        model: model file.
        records: files and folders.
        out: model file to write; for `unchanged` a copy of the given one.
        json_file: where to write the result as JSON, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(out, json_file, inputs=[model, *records])
    loaded, read_in = open_both(model, records, reading)
    day = run_adaptation(loaded, read_in)
    with staged(file=out, json_file=json_file, value=day.as_json()) as stage:
        if day.model is loaded:
            with open(model, "rb") as given:
                write_bytes_atomic(stage, given.read())
        else:
            save(stage, day.model)
    print_adaptation(day)


def print_adaptation(day: Adaptation) -> None:
    """Print verdict, changed parameters, and errors before and after."""
    where = ", on the half of the recording that was held out" if day.heldout else ""
    print(f"{day.verdict}: {number(day.before, 3)} % of range before, {number(day.after, 3)} % after{where}")
    rows = []
    for name, c in day.changed.items():
        now = []
        if c.seconds is not None and c.seconds_ci95 is not None:
            low, high = (number(1e3 * end, 3) for end in c.seconds_ci95)
            now.append(f"now {number(1e3 * c.seconds, 3)} ms ({low} to {high})")
        if not c.is_significant:
            now.append("applied, though 1 lies within its interval")
        rows.append((name, c.factor, " to ".join(number(end, 4) for end in c.ci95), ", ".join(now)))
    print_table(Table(("number", "factor", "95 % interval", ""), rows))
    if day.advice:
        print(day.advice)
