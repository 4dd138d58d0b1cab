"""The limits of a feedforward: voltage range and slew of the amplifier, displacement of the actuator.

low <= u <= high,   |u'| <= slew,   |x| <= farthest
"""

from dataclasses import dataclass

import numpy as np

from ...common.errors import BadInput, refuse_if
from ...common.quantity import Units
from ..model.model import Model

_BIPOLAR = 0.1  # of the largest voltage
_VOLTS = Units()


@dataclass(frozen=True)
class Limits:
    """Limits of voltage range, slew, and displacement from the position at 0 V; and the start and end voltage.

    All in base units (V, V/s, m); `units` is for messages. `assumed`: the limits that come from the model's recordings.
    """

    low: float
    high: float
    slew: float
    farthest: float = np.inf
    ends: float = 0.0
    units: Units = Units()
    assumed: tuple[str, ...] = ()

    @property
    def unnoticed(self) -> float:
        """Return the tolerated deviation of the first sample's voltage, V: a hundredth of the range."""
        return 0.01 * (self.high - self.low)

    @property
    def slew_text(self) -> str:
        """Describe the slew limit, with its origin if the user did not give it."""
        origin = f" (the largest of the model's recordings; {self.units.max_rate} sets another)"
        return self.units.input.rate_text(self.slew, 3) + (origin if "slew" in self.assumed else "")

    @property
    def text(self) -> str:
        """Describe all limits, with the origin of those that the user did not give."""
        parts = [self.units.input.range_text(self.low, self.high), f"at most {self.units.input.rate_text(self.slew)}"]
        if np.isfinite(self.farthest):
            parts.append(f"{self.units.output_word} within {self.units.limit.text(self.farthest)}")
        named = [{"range": self.units.input_word, "slew": "rate"}[part] for part in self.assumed]
        origin = f" ({' and '.join(named)} of the model's recordings)" if named else ""
        return ", ".join(parts) + origin


def limits_of(
    model: Model,
    max_voltage: float | None,
    max_slew: float | None,
    max_displacement: float | None,
    start_input: float = 0.0,
    units: Units = _VOLTS,
) -> tuple[Limits, tuple[str, ...]]:
    """Choose the given limits, or those of the training records; return them with warnings.

    Raises:
        BadInput: a limit that is not positive, an infinite voltage, or a start beyond it.
    """
    low, high = model.domain.voltage_range
    warnings: tuple[str, ...] = ()
    if model.input_map.one_sided:  # squared: negative voltages of the records count too
        if high <= 0 > low:
            warnings += (
                "the recordings have only negative inputs, the planned input is positive; for a squared "
                "input, its negative has the same effect",
            )
        low, high = 0.0, max(high, -low)
    trained_high, trained_slew = high, model.domain.slew
    given = ((units.max_input, max_voltage), (units.max_rate, max_slew), (units.max_output, max_displacement))
    refuse_if(
        *((value is not None and not value > 0, f"{name} must be positive, not {value}") for name, value in given),
        (max_voltage == np.inf, f"{units.max_input} must be finite; give the amplifier's limit"),
    )
    if max_voltage is not None:
        bipolar = -low > _BIPOLAR * high  # beyond the noise of a reading of zero volts
        high, low = max_voltage, -max_voltage if bipolar else max(low, -max_voltage)
        if max_voltage > 1.0001 * trained_high:  # the trained limit may be given with four digits
            warnings += (
                f"{units.max_input} {units.input.text(max_voltage)} is above {units.input.text(trained_high)}, the "
                "largest input in the model's recordings",
            )
    slew, farthest = trained_slew if max_slew is None else max_slew, max_displacement or np.inf
    low, high = min(low, 0.0), max(high, 0.0)
    if not low <= start_input <= high:
        raise BadInput(
            f"--start-input {units.input.text(start_input)} lies outside {units.input.range_text(low, high)}; raise "
            f"{units.max_input}"
        )
    chosen = (("range", max_voltage, high), ("slew", max_slew, slew))
    assumed = tuple(part for part, value, limit in chosen if value is None and np.isfinite(limit))
    return Limits(low, high, slew, farthest, start_input, units, assumed), warnings


def limit_slew(voltage: np.ndarray, limits: Limits, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Clip a voltage to its range, then to its slew limit, starting at the start voltage.

    Returns:
        The limited voltage, and True where it differs from the requested one.
    """
    kept = np.clip(voltage, limits.low, limits.high)
    kept[0] = last = limits.ends
    most = limits.slew * dt
    if np.isfinite(most) and (np.abs(np.diff(kept)) > most).any():
        for i, asked in enumerate(kept):
            kept[i] = last = min(max(asked, last - most), last + most)
    cut = np.abs(kept - voltage) > 1e-6 * max(abs(limits.high), 1e-30)
    cut[0] = False  # the initial voltage, not a limit: a model may need a voltage at x = 0
    return kept, cut


def travel(voltage: np.ndarray) -> float:
    """Compute the total variation of a voltage, V: the sum of its absolute changes."""
    return float(np.abs(np.diff(voltage)).sum())
