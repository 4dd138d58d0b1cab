"""`pitp plan`: proposes recordings to take, as CSV files to play, a page with their purpose, and plan.json."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...common.errors import BadInput
from ...common.quantity import Quantity, Units
from ...common.units import spelt
from ...files.model_file.model_file import is_model_file, load
from ...files.recordings.writing import write_signals, write_text_atomic
from ...method.model.units import units_of
from ..pages.plan import headline, page, table
from ..plan.planning import REACHED, Plan
from ..plan.planning import plan as make_plan
from .amounts import Amount, limits_in_base
from .console import print_table
from .outputs import check_outputs, staged, write_json
from .recordings import check_belongs, read_records

PAGE, JSON = "plan.html", "plan.json"


def plan(paths, out, max_voltage, max_slew, max_displacement, band, reading, json_file=None, **more) -> None:
    """Plan recordings, write the inputs, the page and the JSON, and print them in order.

    Args:
        paths: none, or a model file and the records it was trained on.
        out: folder to write to.
        max_voltage, max_slew: limits of the input (`Amount`), or None for those of the model's recordings.
        max_displacement: limit from the position at zero input, or None.
        band: lowest and highest frequency in Hz, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.
        json_file: where to write plan.json once more, or None.
        more: duration, rest, rate, alternate, seed of `pitp.plan`.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    given, records = _sorted(paths)
    check_outputs(json_file, folder=out, names=[PAGE, JSON], inputs=paths)
    model = None if given is None else load(given)
    read_in = read_records(records, reading, input_map=model and model.input_map.name)
    if read_in and model is not None:
        check_belongs(model, str(given), read_in)
    units = _first_units(max_voltage, max_displacement) if model is None else units_of(model)
    planned = make_plan(
        model, read_in, band=band and tuple(band), units=units, **more,
        **limits_in_base(units, max_voltage, max_slew, max_displacement),
    )  # fmt: skip
    files = [f"{r.name.replace('/', '_')}.csv" for r in planned.recordings]
    check_outputs(json_file, folder=out, names=[PAGE, JSON, *files], inputs=paths)
    summary = planned.as_json() | {"files": files}
    with staged(folder=out, json_file=json_file, value=summary) as stage:
        for file, r in zip(files, planned.recordings, strict=True):
            write_signals(stage / file, r.time, voltage=(r.voltage, units.input.unit))
        write_text_atomic(stage / PAGE, page(planned, given or "").html())
        write_json(stage / JSON, summary)
    _print(planned, given is not None)
    print(f"wrote {Path(out) / PAGE}, {JSON} and {len(files)} drives")


def _sorted(paths: Sequence[str]) -> tuple[str | None, list[str]]:
    """Separate the paths, given in any order, into the model file and the recordings."""
    if not paths:
        return None, []
    models = [p for p in paths if Path(p).is_file() and is_model_file(p)]
    if len(models) != 1:
        problem = f"{', '.join(models)}: several model files" if models else f"{paths[0]}: is not a model file"
        raise BadInput(f"{problem}; give one model file and the recordings that it was trained on")
    return models[0], [p for p in paths if p != models[0]]


def _first_units(largest: Amount | None, farthest: Amount | None) -> Units:
    """Return the units of a first session: those of the stated limits, otherwise V and m."""
    units = [given and spelt(given.unit) for given in (largest, farthest)]
    return Units(Quantity(units[0] or "V"), Quantity(units[1] or "m"))


def _print(planned: Plan, modelled: bool) -> None:
    print(headline(planned, modelled))
    if planned.recordings:
        print_table(table(planned), 3)
    if any(np.isfinite(r.go_on) for r in planned.recordings):
        print(REACHED)
    for note in planned.notes:
        print(f"note: {note}")
