"""Keep the limits of a feedforward: the amplifier's range and slew, and the membrane's stroke.

low <= u <= high,   |u'| <= slew,   |x| <= farthest
"""

from dataclasses import dataclass

import numpy as np

from .._errors import BadInput
from .._model.model import Model

_BIPOLAR = 0.1  # of the largest voltage


@dataclass(frozen=True)
class Limits:
    """Voltage range (V), slew (V/s), the displacement from 0 V either way (m), and the voltage at both ends (V)."""

    low: float
    high: float
    slew: float
    farthest: float = np.inf
    ends: float = 0.0

    @property
    def unnoticed(self) -> float:
        """What the first sample may miss, V: a hundredth of the range, 1e-4 of the largest force of a square."""
        return 0.01 * (self.high - self.low)

    @property
    def range_text(self) -> str:
        """The range in words; from zero volts on only its end."""
        return f"{self.high:g} V" if self.low == 0 else f"{self.low:g} to {self.high:g} V"


def limits_of(
    model: Model,
    max_voltage: float | None,
    max_slew: float | None,
    max_displacement: float | None,
    start_input: float = 0.0,
) -> tuple[Limits, tuple[str, ...]]:
    """Choose the limits given, or those of the training records; and warn.

    Raises:
        BadInput: a limit that is not positive, an endless voltage, or a start beyond it.
    """
    low, high = model.domain.voltage_range
    warnings: tuple[str, ...] = ()
    if model.input_map.one_sided:  # squared: what was played below zero counts as well
        if high <= 0 > low:
            warnings += (
                "trained on negative voltages alone, this one is positive: play its negative, the square is the same",
            )
        low, high = 0.0, max(high, -low)
    trained_high, trained_slew = high, model.domain.slew
    given = (("max-voltage", max_voltage), ("max-slew", max_slew), ("max-displacement", max_displacement))
    for name, value in given:
        if value is not None and not value > 0:
            raise BadInput(f"--{name} must be positive, got {value}")
    if max_voltage == np.inf:
        raise BadInput("--max-voltage must be finite: give the amplifier's limit")
    if max_voltage is not None:
        bipolar = -low > _BIPOLAR * high  # beyond the noise of a reading of zero volts
        high, low = max_voltage, -max_voltage if bipolar else max(low, -max_voltage)
        if max_voltage > 1.0001 * trained_high:
            warnings += (f"--max-voltage {max_voltage:g} V is above the {trained_high:g} V the model was trained on",)
    slew, farthest = trained_slew if max_slew is None else max_slew, max_displacement or np.inf
    low, high = min(low, 0.0), max(high, 0.0)
    if not low <= start_input <= high:
        raise BadInput(f"--start-input {start_input:g} V lies outside {low:g} to {high:g} V: raise --max-voltage")
    return Limits(low, high, slew, farthest, start_input), warnings


def limit_slew(voltage: np.ndarray, limits: Limits, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Clip to the voltage range, then to the slew rate, from the voltage at the ends, which is the first sample.

    Returns:
        The voltage kept, and True where it differs from the voltage asked for.
    """
    kept = np.clip(voltage, limits.low, limits.high)
    kept[0] = last = limits.ends
    most = limits.slew * dt
    if np.isfinite(most) and (np.abs(np.diff(kept)) > most).any():
        for i, asked in enumerate(kept):
            kept[i] = last = min(max(asked, last - most), last + most)
    cut = np.abs(kept - voltage) > 1e-6 * max(abs(limits.high), 1e-30)
    cut[0] = False  # where it stands, not a limit: a model may need a voltage at x = 0
    return kept, cut


def travel(voltage: np.ndarray) -> float:
    """Compute the total variation, V."""
    return float(np.abs(np.diff(voltage)).sum())
