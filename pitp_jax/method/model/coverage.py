"""Find the part of an input or a target outside the training data of a model, and describe it in a sentence."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ...common.numbers import short
from ...common.quantity import Quantity
from ..signal.excited import Beyond, Cells, beyond, tabulate
from ..signal.record import Record
from .fitted import Fitted, fitted_of
from .model import Model
from .origin import Origin
from .units import units_of

WORTH_A_LINE = 0.1  # fraction of the energy
Side = Literal["input", "output"]


def with_excited(origin: Origin, records: Sequence[Record]) -> Origin:
    """Return the origin with the frequencies and amplitudes that these recordings excite; one sampling interval."""
    inputs, outputs, dt = [r.voltage for r in records], [r.filled for r in records], records[0].dt
    return replace(origin, excited_input=tabulate(inputs, dt), excited_output=tabulate(outputs, dt))


def untrained(model: Model | Fitted, side: Side, series: np.ndarray, dt: float) -> Beyond:
    """Return the part of a voltage (V) or of a target (m), shape (time,), outside the training data's tones."""
    fitted = fitted_of(model)
    return beyond(getattr(fitted.origin, f"excited_{side}"), series, dt, _resonance(fitted))


def _resonance(fitted: Fitted) -> float:
    return fitted.model.natural_frequency / (2 * np.pi)


def untrained_words(model: Model | Fitted, side: Side, part: Beyond) -> str:
    """Describe the untrained part of an input or a target, and the remedy; empty below a tenth of its energy."""
    if part.fraction <= WORTH_A_LINE:
        return ""
    low, high = short(part.low_hz), short(part.high_hz)
    # a trained amplitude below a twentieth does not count as trained
    at = "" if part.reached < 0.05 * part.amplitude else " at this amplitude"
    size, unit, what = "", getattr(units_of(model), side), {"input": "input", "output": "target"}[side]
    if part.below_hz is not None and part.above_hz is not None:
        trained = f"up to {short(part.below_hz)} Hz and from {short(part.above_hz)} Hz{at}"
    elif part.below_hz is not None:
        trained = f"up to {short(part.below_hz)} Hz{at}"
    elif part.above_hz is not None:
        trained = f"from {short(part.above_hz)} Hz{at}"
    else:
        size = f", with amplitudes of up to {_two(unit, part.amplitude)}"
        trained = f"with amplitudes of up to {_two(unit, part.reached)} there"
    return (
        f"The {what} has {100 * part.fraction:.0f} % of its energy between {low} and {high} Hz{size}; the model was "
        f"trained {trained}. Record such a motion and train again: `pitp plan MODEL RECORDINGS --band {low} {high}` "
        "proposes it first."
    )


def trained_words(model: Model | Fitted) -> str:
    """Describe the frequencies and amplitudes of the training data in a sentence; empty if unknown."""
    fitted, lines = fitted_of(model), []
    units, origin = units_of(fitted), fitted.origin
    for what, table, unit in (
        ("inputs", origin.excited_input, units.input),
        ("motions", origin.excited_output, units.output),
    ):
        if table:
            size, low, high = Cells(table, _resonance(fitted)).full()
            lines.append(f"{what} of up to {_two(unit, size)} in amplitude between {short(low)} and {short(high)} Hz")
    if not lines:
        return ""
    return f"The model was trained with {' and '.join(lines)}. Beyond these, the error of this code is not known."


def _two(unit: Quantity, base: float) -> str:
    return f"{float(f'{float(unit.shown(base)):.2g}'):.6g} {unit.unit}"
