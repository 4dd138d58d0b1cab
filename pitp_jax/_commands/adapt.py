"""`pitp adapt`: the same actuator on another day, from one short recording."""

from .._adapt.adaptation import Adaptation
from .._adapt.adaptation import adapt as run_adaptation
from .._model_file.model_file import load, save
from .._record.writing import write_bytes_atomic
from .compatibility import check_suits
from .console import number, print_table
from .outputs import check_files, staged_files, write_json
from .recordings import is_square, read_records


def adapt(model, records, out, json_file, reading) -> None:
    """Adapt, write the model file, and print what changed.

    Args:
        model: model file.
        records: files and folders.
        out: model file to write: with `unchanged` a copy of the one given.
        json_file: where to write the finding for machines, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_files(out, json_file, inputs=[model, *records])
    loaded = load(model)
    read_in = read_records(records, reading, square=is_square(loaded))
    check_files(out, json_file, inputs=[model, *(r.source for r in read_in)])
    check_suits(loaded, model, read_in)
    found = run_adaptation(loaded, read_in)
    with staged_files(out, json_file) as (out_stage, json_stage):
        if found.model is loaded:
            with open(model, "rb") as given:
                write_bytes_atomic(out_stage, given.read())
        else:
            save(out_stage, found.model)
        if json_file:
            write_json(json_stage, found.as_json())
    print_adaptation(found)


def print_adaptation(found: Adaptation) -> None:
    """Verdict, numbers and errors on standard output."""
    where = ", on the half of the recording not used for the fit" if found.heldout else ""
    print(f"{found.verdict}: {number(found.before, 3)} % of range before, {number(found.after, 3)} % after{where}")
    rows = []
    for name, c in found.changed.items():
        now = ""
        if c.seconds is not None and c.seconds_ci95 is not None:
            low, high = (number(1e3 * end, 3) for end in c.seconds_ci95)
            now = f"now {number(1e3 * c.seconds, 3)} ms ({low} to {high})"
        rows.append((name, number(c.factor, 4), " to ".join(number(end, 4) for end in c.ci95), now))
    if rows:
        print_table(("number", "factor", "95 % interval", ""), rows)
    if found.advice:
        print(found.advice)
