"""Refuse impossible values of a recording, and ask the user about improbable ones.

100 kV, 1 km and more                        refused: a unit is wrong
range of x > 1 m, 90 % of x equal            reported
x = u, x of three values or fewer            reported: a column given twice, a sensor that does not move
|u| <= 10 V on a squared input               reported: a monitor's voltage, not the actuator's
"""

from collections.abc import Sequence

import numpy as np

from ...common.errors import BadInput
from ...common.units import base_unit
from ...method.signal.record import Record
from .outliers import has_few

_HIGHEST = {"V": 1e5, "m": 1e3}  # base units: beyond them a unit is wrong
_EQUAL = 0.9  # of the samples
_SAME = 1e-9  # relative difference of equal numbers that were written with different digits
_FEW = 3  # values of an output that only flickers


def refuse_implausible(voltage: np.ndarray, displacement: np.ndarray, units, columns, place) -> None:
    """Refuse inputs and outputs too large for any rig: 100 kV, 1 km.

    Args:
        voltage: in its base unit, shape (T,).
        displacement: in its base unit, shape (T,); nan where missing.
        units: base units of both; only volts and metres have a limit.
        columns: headers of input and output.
        place: turns a sample index into words.

    Raises:
        BadInput: with the columns concerned.
    """
    problems = []
    for values, base, stem, column in zip((voltage, displacement), units, ("input", "output"), columns, strict=True):
        most = _HIGHEST.get(base, np.inf)
        far = np.abs(values) > most
        if far.any() and not (stem == "output" and far.mean() < 0.01):  # a few are sensor faults, and masked
            at = int(np.argmax(far))
            problems.append(
                f"column {column!r}, {place(at)}: {values[at]:.4g} {base} is more than {most:g} {base}; give the right "
                f"--{stem}-unit or --{stem}-scale"
            )
    if problems:
        raise BadInput("; ".join(problems))


def questions(voltage: np.ndarray, displacement: np.ndarray, unit: str) -> list[str]:
    """Return questions to the user about a recording that is improbable but possible.

    Args:
        voltage: input in its base unit, shape (T,).
        displacement: output in its base unit, shape (T,); nan where missing.
        unit: of the output: only a length has a largest plausible range.
    """
    seen = np.isfinite(displacement)
    x, u = displacement[seen], voltage[seen]
    lines = []
    if unit == "m" and np.ptp(x) > 1:
        lines.append(f"moves by {np.ptp(x):.3g} m; check the unit of the output")
    near = _SAME * float(np.ptp(u))
    if near > 0 and all(np.allclose(x[:k], u[:k], rtol=_SAME, atol=near) for k in (64, None)):
        lines.append("input and output hold the same numbers; give the column of the measured output")
    if has_few(x, _FEW) and np.ptp(u) > 0 and not has_few(u, _FEW):
        values = np.unique(x)
        beside = f", with a flicker of {np.ptp(values):.3g}" if len(values) > 1 else ""
        lines.append(f"the output does not move while the input does (it reads {np.median(x):.6g}{beside})")
    # neighbours are equal where most outputs are
    elif (x[1:] == x[:-1]).mean() > _EQUAL / 2 and (equal := float(np.mean(x == np.median(x)))) > _EQUAL:
        lines.append(f"{100 * equal:.0f} % of its outputs are equal; check that the sensor works")
    return lines


def monitor_warning(records: Sequence[Record]) -> str | None:
    """Return a question if the input, whose square drives the motion, stays within a monitor's 10 V; otherwise None."""
    highest = max(float(np.abs(record.voltage).max()) for record in records)
    # 10 V: the range of a DAQ
    if not 0 < highest <= 10.0 or any(base_unit(record.voltage_unit) != "V" for record in records):
        return None
    return (
        f"the input never exceeds {highest:.3g} V; if it is the amplifier's monitor (1 V per kV), give --input-scale "
        "1000"
    )
