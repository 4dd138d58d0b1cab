"""`pitp simulate`: computes the displacement of a model under given voltages."""

import math
from collections.abc import Sequence

import numpy as np

from ...common.errors import ComputationFailed
from ...common.units import from_base
from ...files.model_file.model_file import load
from ...files.recordings.voltage_file import Drive, read_voltage
from ...files.recordings.writing import write_signals
from ...method.model.coverage import untrained, untrained_words
from ...method.model.fitted import Fitted
from ...method.model.units import units_of
from ...method.simulate.voltage_only import rollout
from .amounts import zero_in_base
from .console import Table, print_table, say
from .outputs import check_outputs, csv_names, staged
from .recordings import check_kind, warn_of_rate


def simulate(model, voltages, out, zero, json_file, reading) -> None:
    """Simulate the model under voltages from files, write the requested files, and print the ranges.

    Args:
        model: model file.
        voltages: files and folders of time and voltage.
        out: folder for one CSV per voltage, or None.
        zero: "rest", "sensor", or the displacement at 0 V, in the unit of the model's records.
        json_file: where to write the ranges as JSON, or None.
        reading: keyword arguments of `pitp.read_voltage`: columns, units, scale, rate.

    Raises:
        BadInput: with nothing written.
        ComputationFailed: every run diverged; the results are written.
    """
    loaded = load(model)
    drives = read_voltage(*voltages, **reading)
    files = csv_names(drives)
    check_outputs(json_file, folder=out, names=files, inputs=[model, *voltages])
    _tell(loaded, model, drives)
    unit = units_of(loaded).output.unit
    origin = zero_in_base(zero, unit)
    runs = [rollout(loaded, d.voltage, d.dt, start_time=float(d.time[0]), zero=origin) for d in drives]
    rows = {d.name: _row(loaded, d, x, unit) for d, x in zip(drives, runs, strict=True)}
    with staged(folder=out, json_file=json_file, value={"records": rows}) as stage:
        if out is not None:
            for drive, x, file in zip(drives, runs, files, strict=True):
                voltage = drive.voltage, drive.voltage_unit
                write_signals(stage / file, drive.time, voltage=voltage, displacement=(x, unit))
    header = ("drive", "samples", "begins", f"lowest ({unit})", f"highest ({unit})", "")
    table = [
        (n, str(row["samples"]), row["begins"], row["lowest"], row["highest"], "diverged" * row["diverged"])
        for n, row in rows.items()
    ]
    print_table(Table(header, table))
    if all(row["diverged"] for row in rows.values()):
        raise ComputationFailed(f"{model} diverged under every input; stay within the input range of its recordings")


def _tell(model: Fitted, path: str, drives: Sequence[Drive]) -> None:
    """Print what was recognised in the files, and which voltages lie outside the model's range."""
    (low, high), units = map(float, model.domain.voltage_range), units_of(model)
    for drive in drives:
        for line in drive.remarks:
            say(line)
        check_kind(model, path, drive.voltage_unit, drive.name, "input")
        warn_of_rate(model, path, f"{drive.name} is", drive.dt)
        least, most = float(drive.voltage.min()), float(drive.voltage.max())
        # 0.1 %: the voltages of a file are rounded
        if most > high * 1.001 or least < low - 0.001 * abs(high):
            times = max(most - high, low - least) / max(high - low, 1e-300)
            say(
                f"warning: {drive.name} plays {units.input.range_text(least, most, 6)}, the recordings of {path} cover "
                f"{units.input.range_text(low, high, 6)}. The model extrapolates by {100 * times:.2g} % of that "
                "range's width"
            )
        if words := untrained_words(model, "input", untrained(model, "input", drive.voltage, drive.dt)):
            say(f"warning: {drive.name}: {words}")
        if drive.voltage[0] != 0:
            say(f"{drive.name}: starts at {units.input.text(drive.voltage[0], 6)}, taken as settled there")


def _row(model: Fitted, drive: Drive, x: np.ndarray, unit: str) -> dict:
    shown = from_base(x[np.isfinite(x)], unit)
    lowest, highest = (float(shown.min()), float(shown.max())) if len(shown) else (math.nan, math.nan)
    return {
        "samples": len(x),
        "begins": "held" if drive.voltage[0] != 0 else "rest",
        "lowest": lowest,
        "highest": highest,
        "unit": unit,
        "diverged": bool(np.isnan(x).any()),
        "outside_training_share": untrained(model, "input", drive.voltage, drive.dt).fraction,
    }
