"""`pitp identify`: records to a linear model of the right order."""

from .._identify.identification import Identification
from .._identify.identification import identify as run_identify
from .._model_file.model_file import save
from .._report.description import describe
from .._table.units import from_base
from .console import number, print_table, say
from .outputs import check_outputs, staged
from .recordings import read_records, warn
from .reports import print_beginnings, print_model


def identify(records, out, order, input_map, learn, json_file, reading) -> None:
    """Identify, write the model file, and print the comparison of orders.

    Args:
        records: files and folders.
        out: model file to write.
        order: 1 to 6 or "auto".
        input_map: "square" or "linear".
        learn: ("delay",) to fit a pure delay as well.
        json_file: where to write the result for machines, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(out, json_file, inputs=records)
    read_in = read_records(records, reading, square=input_map == "square")
    warn(read_in)
    found = run_identify(read_in, order=order, input_map=input_map, learn=learn, progress=say)
    told = describe(found.model)
    orders, beginnings = [vars(fit) for fit in found.orders], {name: vars(b) for name, b in found.beginnings.items()}
    value = {**told, "orders": orders, "rest": found.rest, "beginnings": beginnings}
    with staged(file=out, json_file=json_file, value=value) as stage:
        save(stage, found.model)
    unit = read_in[0].displacement_unit
    print_orders(found, unit)
    print_model(told)
    if found.chosen.delay:
        print(f"delay: {number(1e3 * found.chosen.delay, 3)} +- {number(1e3 * found.chosen.delay_stderr, 2)} ms")
    print_beginnings(found.beginnings, unit)


def print_orders(found: Identification, unit: str) -> None:
    """The compared orders, the chosen one marked."""
    rows = [
        (
            f"{fit.order}{' *' if fit.order == found.chosen.order else ''}",
            number(from_base(fit.mae, unit, "displacement")),
            number(from_base(fit.rms, unit, "displacement")),
            f"{fit.bic:.0f}",
            ", ".join(number(f, 3) for f in fit.natural_hz),
            "yes" if fit.identifiable else "no",
        )
        for fit in found.orders
    ]
    print_table(("order", f"mae ({unit})", f"rms ({unit})", "bic", "natural (Hz)", "identifiable"), rows)
