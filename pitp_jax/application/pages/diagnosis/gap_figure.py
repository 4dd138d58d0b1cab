"""Draw the gap at a glance: one record, measured, with the model without and with the effects found."""

import numpy as np

from ....common.numbers import shown_unit
from ....common.units import OUTPUT_UNITS
from ....method.diagnose.diagnosis import Diagnosis
from ....method.diagnose.traces import Trace
from ....method.model.units import units_of
from ..lines import ERROR, MEASURED, PREDICTED, finish, line, own_axes

_CYCLES = 6  # oscillations in the zoom


def output_unit(diagnosis: Diagnosis) -> tuple[float, str]:
    """Return the factor from m or V to the unit of the user's files, and the displayed name of this unit."""
    unit = diagnosis.model.origin.displacement_unit
    return 1 / OUTPUT_UNITS[unit], shown_unit(unit)


def worst(diagnosis: Diagnosis) -> Trace:
    """Return the held-out record with the largest error relative to its range; without one, a fitted record."""
    held = [t for t in diagnosis.traces if t.heldout] or list(diagnosis.traces)
    return max(held, key=lambda t: np.nan_to_num(errors(t)[0]))


def errors(trace: Trace) -> tuple[float, float]:
    """Return e_rms (% of range) of the nominal and the augmented model on a record; nan without measurement."""
    seen = np.isfinite(trace.measured)
    if not seen.any() or not np.ptp(trace.measured[seen]):
        return float("nan"), float("nan")
    first, second = (
        100 * float(np.sqrt(np.mean((y - trace.measured)[seen] ** 2)) / np.ptp(trace.measured[seen]))
        for y in (trace.nominal, trace.augmented)
    )
    return first, second


def telling(trace: Trace) -> slice:
    """Return the slice of about six oscillations in which the nominal model's error is largest."""
    e = np.where(np.isfinite(trace.measured), trace.nominal - trace.measured, 0.0)
    x = trace.nominal - np.mean(trace.nominal)
    total = len(e)
    turns = np.flatnonzero(np.diff(np.signbit(x)))
    width = max(total // 8, min(total, 64))
    peak = _loudest(e, width)
    near = np.count_nonzero((turns >= peak) & (turns < peak + width)) / 2
    width = int(np.clip(_CYCLES * width / max(near, 1e-9), min(total, 64), total))
    first = _loudest(e, width)
    return slice(first, first + width)


def _loudest(e: np.ndarray, width: int) -> int:
    energy = np.concatenate([[0.0], np.cumsum(e**2)])
    return int(np.argmax(energy[width:] - energy[:-width]))


def gap(diagnosis: Diagnosis, axes=None) -> np.ndarray:
    """Draw measured, nominal and augmented output of the worst held-out record, with both errors below.

    Args:
        diagnosis: the diagnosis; without a gap only the nominal is drawn.
        axes: two axes; None makes a figure.

    Returns:
        The two axes, shape (2,).
    """
    axes = own_axes(axes, 2, (5.0, 3.4), (2.2, 1.0))
    scale, unit = output_unit(diagnosis)
    trace = worst(diagnosis)
    part = telling(trace)
    time, measured = trace.time[part], scale * trace.measured[part]
    runs = [("model as given" if not refitted(diagnosis) else "model, refitted", trace.nominal, ERROR)]
    if diagnosis.effects:
        added = "all effects" if len(diagnosis.effects) > 1 else "".join(diagnosis.effects)
        runs.append((f"with {added}", trace.augmented, PREDICTED))
    elif diagnosis.handed_back:
        runs.append(
            ("best candidate" if diagnosis.term is None else "with the found equation", trace.augmented, PREDICTED)
        )
    line(axes[0], time, measured, color=MEASURED, lw=2.6, label="measured")
    for k, (label, run, color) in enumerate(runs):
        line(axes[0], time, scale * run[part], color=color, lw=1.1, ls="-" if k else "--", label=label)
        line(axes[1], time, scale * run[part] - measured, color=color, lw=0.9)
    kind = units_of(diagnosis.model).output_word
    finish(axes, "time (s)", [f"{kind} ({unit})", f"error ({unit})"], legend_columns=len(runs) + 1)
    return axes


def refitted(diagnosis: Diagnosis) -> bool:
    """Return whether the nominal's coefficients were refitted: its error differs from the given model's."""
    return diagnosis.gap.before != diagnosis.gap.unrefitted


def time_spent(diagnosis: Diagnosis) -> dict[str, np.ndarray]:
    """Return the fraction of time in every bin of displacement, voltage and time of `Diagnosis.where`."""
    model, parts = diagnosis.model, {}
    for axis in ("displacement", "voltage", "time"):
        rows = diagnosis.where[axis]
        total = np.zeros(len(rows))
        for t in diagnosis.traces:
            values = model.output.to_model(t.measured[np.isfinite(t.measured)]) if axis == "displacement" else t.voltage
            if axis != "time" and len(values):
                edges = [row["range"][0] for row in rows] + [rows[-1]["range"][1]]
                total += np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0] / len(values)
        parts[axis] = total / total.sum() if total.sum() else np.full(len(rows), 1 / max(len(rows), 1))
    return parts
