"""Compare two sets of recordings: outputs under equal commands, otherwise linear models fitted to each set.

    y_b(t) = s y_a(t - d) + c + e        least squares over 8 blocks of a recording; s, d: mean and standard error

The sensor offset c belongs to a recording and is not counted as a difference. If no command is common, both sets are
identified.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...common.errors import BadInput, ComputationFailed
from ...common.numbers import number
from ...common.units import base_unit, from_base
from ...method.identify.identification import identify
from ...method.signal.initial_state import noise_std
from ...method.signal.record import Record
from .models import compare_models
from .pairing import Pair, pair_records
from .remarks import remarks_on
from .result import Comparison, Difference, measured


def compare_records(a: Sequence[Record], b: Sequence[Record], names: tuple[str, str]) -> Comparison:
    """Pair recordings and compare their outputs; if none pairs, compare linear models fitted to both sets."""
    pairs = pair_records(a, b)
    remarks = remarks_on(pairs, *names)
    if pairs.pairs:
        rows = [row for pair in pairs.pairs for row in _outputs(pair, names[0])]
        return Comparison("records", names, tuple(rows), tuple(remarks), pairs)
    try:
        one, two = (identify(records).model for records in (a, b))
    except ComputationFailed as error:
        raise ComputationFailed(
            f"the sets have no command in common, and no linear model of one can be identified: {error}"
        ) from None
    compared = compare_models(one, two, names)
    why = "The sets have no command in common, so linear models identified on each are compared."
    return replace(compared, kind="records", remarks=(why, *compared.remarks), pairs=pairs)


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
    blocks = 8
    block = np.arange(len(seen)) * blocks // len(seen)
    fits = [f for k in range(blocks) if (f := _affine(y, other, seen & (block == k), a.dt)) is not None]
    whole = _affine(y, other, seen, a.dt)
    if whole is None or len(fits) < 3:
        return []
    sizes, lags = np.array(fits).T
    errors = [float(v.std(ddof=1) / np.sqrt(len(v))) for v in (sizes, lags)]
    name = a.name if a.name == pair.second.name else f"{a.name}, {pair.second.name}"
    stroke = float(from_base(np.ptp(y[seen]), unit))
    apart = np.sqrt(np.mean((other - y - pair.output_offset)[seen] ** 2))
    difference, floor = (float(from_base(v, unit)) for v in (apart, noise))
    # two recordings of one machine differ by at most 3 standard deviations of both sensors' noise
    return [
        measured(f"{name}: size of the motion", stroke, whole[0] * stroke, unit, (0.0, errors[0] * stroke)),
        measured(f"{name}: time behind {first}", 0.0, 1e3 * whole[1], "ms", (0.0, 1e3 * errors[1])),
        Difference(f"{name}: rms difference (noise: {number(floor, 2)} {unit})", "reference", difference, unit, None,
                   difference > 3 * floor),
    ]  # fmt: skip


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
