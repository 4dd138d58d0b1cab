"""Limits of rig and actuator that all planned recordings respect: voltage, slew, displacement, frequency.

    low <= u <= high,   |u'| <= slew,   |x| <= farthest,   f_low <= f <= f_high <= rate / 20

Limits that are not given are taken from the training records of the model.
"""

import math
from dataclasses import dataclass

from ...common.errors import BadInput
from ...common.quantity import Units

_PER_PERIOD = 20  # samples a period of the highest frequency: a tenth of Nyquist


@dataclass(frozen=True)
class Limits:
    """Limits of rig and actuator that every planned recording respects.

    Attributes:
        low, high: voltage range in V, low <= 0 < high.
        slew: V/s.
        farthest: largest displacement from 0 V in both directions, m, or infinity.
        band: lowest and highest input frequency in Hz.
        rate: samples per second.
        rest: seconds at zero input after each recording.
        units: for messages, names and files; all numbers here are in base units.

    Raises:
        BadInput: with all limits that cannot be met, in one line.
    """

    low: float
    high: float
    slew: float
    farthest: float
    band: tuple[float, float]
    rate: float
    rest: float
    units: Units = Units()

    def __post_init__(self):
        """Refuse limits that no recording could respect."""
        first, last = self.band
        wrong = []
        units = self.units
        for name, value in ((units.max_input, self.high), (units.max_rate, self.slew), ("--rate", self.rate)):
            if not (value > 0 and math.isfinite(value)):
                wrong.append(f"{name} must be positive and finite, not {value:g}")
        if not self.farthest > 0:
            wrong.append(f"{units.max_output} must be positive, not {self.farthest:g}")
        if not (self.rest >= 0 and math.isfinite(self.rest)):
            wrong.append(f"--rest must not be negative, but is {self.rest:g}")
        if not 0 < first < last < math.inf:
            wrong.append(f"--band needs 0 < LO < HI, not {first:g} {last:g}")
        elif last > self.rate / _PER_PERIOD * (1 + 1e-9):
            wrong.append(
                f"--band up to {last:g} Hz is too high for --rate {self.rate:g} Hz; give a --rate of "
                f"{_PER_PERIOD * last:g} Hz or more, or end the band at {self.rate / _PER_PERIOD:g} Hz"
            )
        if wrong:
            raise BadInput("; ".join(wrong))

    @property
    def shortest(self) -> float:
        """Return the duration of the shortest recording, s: two periods of the lowest frequency, at most half ramps."""
        return max(2 / self.band[0], 4 * self.ramp(self.high))

    def ramp(self, volts: float) -> float:
        """Return the duration (s) of a smooth step of this height (V), whose steepest slope is 15/8 of the mean slope.

        It is at least half a period of the highest frequency, so that a step excites no more than the band.
        """
        return max(2.0 * abs(volts) / self.slew, 0.5 / self.band[1])
