"""Write advice on all records together, one sentence each with numbers, the most important first."""

from collections.abc import Mapping, Sequence

import numpy as np

from ...common.units import base_unit, from_base, to_base
from ...method.signal.record import Record
from .coverage import Coverage
from .repeats import Repeat
from .set_fit import SetFit


def set_advice(
    rows: Mapping, used: Sequence[Record], cover: Coverage | None, repeats: Sequence[Repeat],
    cycles: Mapping[str, float], fitted: SetFit | None, turned: Sequence[str],
) -> list[str]:  # fmt: skip
    """Write advice on all records together, one sentence each.

    Args:
        rows: checked records by name.
        used: records of one rate in which input and output move.
        cover: excited frequencies and amplitudes.
        repeats: inputs that were played more than once.
        cycles: scatter between the cycles of a periodic input, % of range.
        fitted: the linear fit.
        turned: records whose sensor is reversed relative to most.
    """
    if not used:
        return [
            "no recording shows motion under a changing input, so nothing can be identified; check sensor and amplifier"
        ]
    lines = []
    strange = [name for name, row in fitted.records.items() if row.strange] if fitted else []
    if strange:
        it = "it" if len(strange) == 1 else "them"
        lines.append(f"{some_of(strange)} may not belong to this set; check {it}, or leave {it} out")
    if turned:
        lines.append(f"the sensor is reversed in {some_of(turned)}; this is taken into account, but check its sign")
    if fitted is None:
        lines.append("no linear model could be fitted, so initial states, sensor offsets and directions are not known")
    lines += _zeros(rows, used, fitted)
    if cover is not None:
        lines += cover.advice()
        per, fewest = 1 / (cover.resonance * used[0].dt), 20  # for RK4 and a usable second derivative
        if per < fewest:
            lines.append(
                f"{per:.1f} samples in a period of the resonance at {cover.resonance:.3g} Hz are few; sample at "
                f"{fewest * cover.resonance:.0f} Hz or more"
            )
    # None: the initial state is not known
    begins = {rows[r.name].begins for r in used} - {None}
    if begins and "rest" not in begins:
        none = f"0 {used[0].voltage_unit}"
        what = "displacement" if base_unit(used[0].displacement_unit) == "m" else "output"
        lines.append(f"no recording starts at rest at {none}, so the {what} there is not known; start one there")
    lines += _floor(repeats, cycles)
    return lines


def _zeros(rows: Mapping, used: Sequence[Record], fitted: SetFit | None) -> list[str]:
    """Write a line if the sensor offset differs between records by more than its error; otherwise nothing."""
    known = [r for r in used if rows[r.name].zero is not None and rows[r.name].zero_stderr is not None]
    if len(known) < 2:
        return []
    # compared in base units: 0.05 mm and 50 um are the same offset
    zeros, errors = (
        np.array([to_base(getattr(rows[r.name], field), r.displacement_unit) for r in known])
        for field in ("zero", "zero_stderr")
    )
    # the offset was measured for records at rest, and fitted for all others
    resting = [zero for r, zero in zip(known, zeros, strict=True) if rows[r.name].begins == "rest"]
    middle, far = float(np.median(resting or zeros)), False
    for r, zero, error in zip(known, zeros, errors, strict=True):
        y = r.displacement[r.observed]
        may = 4 * error + 0.002 * np.ptp(y)
        if fitted is not None and rows[r.name].begins != "rest":
            may += fitted.records[r.name].unexplained * y.std()
        far = far or abs(zero - middle) > may
    unit = known[0].displacement_unit
    if not far:
        return []
    low, high, most = (float(from_base(float(v), unit)) for v in (zeros.min(), zeros.max(), middle))
    places = max(1 - int(np.floor(np.log10(high - low))), 0)  # two digits of the difference
    return [
        f"the sensor offset differs between recordings by up to {high - low:.2g} {unit} (in most it is "
        f"{most:.{places}f} {unit}); each recording gets its own offset, no action is needed"
    ]


def _floor(repeats: Sequence[Repeat], cycles: Mapping[str, float]) -> list[str]:
    """Write how well inputs that were played twice repeat, or that none was."""
    known = [r for r in repeats if np.isfinite(r.percent)]
    if known:
        worst = max(known, key=lambda r: r.percent)
        which = f"worst {worst.percent:.2g} %: " if len(known) > 1 else ""
        return [
            f"inputs played twice give outputs that agree to {np.median([r.percent for r in known]):.2g} % of range "
            f"({which}{some_of(worst.names)}); no model can do better"
        ]
    if cycles:
        return [
            f"cycles within a recording repeat to {np.median(list(cycles.values())):.2g} % of range; record one input "
            "twice to measure repeatability"
        ]
    return ["no input was played twice; repeat one recording to measure how well the rig repeats"]


def some_of(names: Sequence[str]) -> str:
    """List up to three names, and count the others."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
