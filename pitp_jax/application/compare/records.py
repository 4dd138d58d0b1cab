"""Compare two sets of recordings: outputs under equal commands, otherwise linear models fitted to each set.

    y_b(t) = s y_a(t - d) + c + e        least squares over 8 blocks of a recording; s, d: mean and standard error

The sensor offset c belongs to a recording and is not counted as a difference. If no command is common, both sets are
identified.
"""

from collections.abc import Sequence

import numpy as np

from ...common.errors import BadInput, ComputationFailed
from ...common.numbers import number
from ...common.units import base_unit, from_base
from ...method.identify.identification import Identification, identify
from ...method.model.input_map import usual_input_map
from ...method.signal.initial_state import noise_std
from ...method.signal.record import Record
from .models import compare_models
from .pairing import Pair, pair_records
from .remarks import remarks_on
from .result import Comparison, Difference, measured

_BLOCKS = 8
_NOISES = 3.0  # allowed difference of two recordings of one machine, in standard deviations of both sensors' noise


def compare_records(a: Sequence[Record], b: Sequence[Record], names: tuple[str, str]) -> Comparison:
    """Pair recordings and compare their outputs; if none pairs, compare linear models fitted to both sets."""
    pairs = pair_records(a, b)
    remarks = remarks_on(pairs, *names)
    if pairs.pairs:
        rows = [row for pair in pairs.pairs for row in _outputs(pair, names[0])]
        remarks += _offset_lines(pairs.pairs, names)
        return Comparison("records", names, tuple(rows), tuple(remarks), pairs)
    try:
        models = [linear_model_of(records).model for records in (a, b)]
    except ComputationFailed as error:
        raise ComputationFailed(
            f"the sets have no command in common, and no linear model of one can be identified: {error}"
        ) from None
    compared = compare_models(models[0], models[1], names)
    first = "The sets have no command in common, so linear models identified on each are compared."
    return Comparison("records", names, compared.rows, (first, *compared.remarks), pairs)


def linear_model_of(records: Sequence[Record]) -> Identification:
    """Identify a linear model with delay, with the input map (linear or square) that leaves the smaller residual.

    Raises:
        BadInput, ComputationFailed: as `identify`.
    """
    identified, failed = [], None
    moved_by_voltage = usual_input_map(records[0].voltage_unit, records[0].displacement_unit) == "square"
    for input_map in ("linear", "square") if moved_by_voltage else ("linear",):
        try:
            identified.append(identify(records, input_map=input_map, learn=("delay",)))
        except ComputationFailed as error:  # the other map may still succeed
            failed = error
    if not identified:
        raise failed or ComputationFailed("no linear model can be identified")
    return min(identified, key=lambda i: i.chosen.rms)


def _offset_lines(pairs: Sequence[Pair], names: tuple[str, str]) -> list[str]:
    """Write the constant offsets between the outputs where one exceeds the remaining rms difference of its pair."""
    unit = pairs[0].first.displacement_unit
    if all(abs(p.output_offset) <= np.nanstd(p.output() - p.first.displacement) for p in pairs):
        return []
    offsets = sorted(float(from_base(p.output_offset, unit)) for p in pairs)
    ends = " to ".join(dict.fromkeys(number(v, 3) for v in (offsets[0], offsets[-1])))
    return [
        f"The output of the {names[1]} minus that of the {names[0]} has a constant offset of {ends} {unit}, which was "
        "subtracted. This is not a difference."
    ]


def _outputs(pair: Pair, first: str) -> list[Difference]:
    """Compare the second output of a pair with the first: size, time lag and rms difference."""
    a, unit = pair.first, pair.first.displacement_unit
    if base_unit(unit) != base_unit(pair.second.displacement_unit):
        raise BadInput(
            f"{pair.second.name}: output in {pair.second.displacement_unit}, but {a.name} in {unit}; give "
            "--output-column to choose the same quantity"
        )
    y, other = a.displacement, pair.output()
    seen = np.isfinite(y) & np.isfinite(other)
    noise = float(np.hypot(noise_std(y), noise_std(pair.second.displacement)))
    # block by block, because one error of a whole recording would not give the uncertainty of size and lag
    fits = [f for f in (_affine(y, other, seen & block, a.dt) for block in _blocks(seen)) if f is not None]
    whole = _affine(y, other, seen, a.dt)
    if whole is None or len(fits) < 3:
        return []
    sizes, lags = np.array(fits)[:, 0], np.array(fits)[:, 1]
    errors = [float(v.std(ddof=1) / np.sqrt(len(v))) for v in (sizes, lags)]
    name = a.name if a.name == pair.second.name else f"{a.name}, {pair.second.name}"
    stroke = float(from_base(np.ptp(y[seen]), unit))
    apart = np.sqrt(np.mean((other - y - pair.output_offset)[seen] ** 2))
    difference, floor = (float(from_base(v, unit)) for v in (apart, noise))
    return [
        measured(f"{name}: size of the motion", stroke, whole[0] * stroke, unit, (0.0, errors[0] * stroke)),
        measured(f"{name}: time behind {first}", 0.0, 1e3 * whole[1], "ms", (0.0, 1e3 * errors[1])),
        Difference(f"{name}: rms difference (noise: {number(floor, 2)} {unit})", "reference", difference, unit, None,
                   difference > _NOISES * floor),
    ]  # fmt: skip


def _blocks(seen: np.ndarray) -> list[np.ndarray]:
    number = np.arange(len(seen)) * _BLOCKS // len(seen)
    return [number == k for k in range(_BLOCKS)]


def _affine(y: np.ndarray, other: np.ndarray, use: np.ndarray, dt: float) -> tuple[float, float] | None:
    """Fit size s and time lag d (s) of `other` = s y(t - d) + c; return None if hardly anything moves.

    Gauss-Newton: about the lag so far, s y(t - d) is s y - s (d - lag) y', linear in s and s (d - lag).
    """
    if use.sum() < 16 or np.ptp(y[use]) < 0.05 * np.ptp(y[np.isfinite(y)]):
        return None
    time, known = dt * np.arange(len(y)), np.isfinite(y)
    lag = 0.0
    size = 1.0
    for _ in range(6):
        moved = np.interp(time - lag, time[known], y[known])
        slope = np.gradient(moved, dt)
        basis = np.column_stack([moved, -slope, np.ones(len(y))])[use]
        fit = np.linalg.lstsq(basis, other[use], rcond=None)[0]
        if abs(fit[0]) < 0.05:  # the other hardly follows: its lag would be a quotient of noise
            return None
        size, step = float(fit[0]), float(fit[1] / fit[0])
        lag += float(np.clip(step, -0.1, 0.1))
    return size, lag
