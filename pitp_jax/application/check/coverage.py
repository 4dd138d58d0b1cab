"""Find the frequencies and amplitudes that recordings excite, and the gaps near the resonance.

    windows of 16 periods of the resonance:  lines that hold 80 % of the force's energy,  amplitude sqrt(2) std(u)

A point is (frequency of the force, amplitude of the voltage). A gap is an interval near the resonance (f0/3 to 1.5 f0)
that is more than half as wide as its lower end and holds no point above half the largest amplitude.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...common.numbers import short
from ...common.units import from_base
from ...method.model.input_map import INPUT_MAPS
from ...method.signal.record import Record

_BELOW, _ABOVE = 1 / 3, 1.5  # resonance frequencies: the range in which gaps count


@dataclass(frozen=True)
class Coverage:
    """Excited frequencies with their amplitudes, and the gaps between them near the resonance.

    Attributes:
        resonance: in Hz.
        points: force frequency (Hz), amplitude of the input (its base unit), seconds; shape (points, 3).
        gaps: intervals in Hz near the resonance without a point above half the largest amplitude.
        largest: amplitude, in the input's base unit.
        doubled: whether the force has twice the input's frequency (a squared input without bias).
        unit: of the input, for the amplitudes.
    """

    resonance: float
    points: np.ndarray
    gaps: tuple[tuple[float, float], ...]
    largest: float
    doubled: bool
    unit: str

    def advice(self) -> list[str]:
        """Write a sentence for every gap, and one if all inputs near the resonance have the same amplitude."""
        lines, f0 = [], self.resonance
        for low, high in self.gaps:
            by = " (frequencies of the force; an input without bias runs at half of them)" if self.doubled else ""
            one, other, half = low + (high - low) / 3, high - (high - low) / 3, self.largest / 2
            lines.append(
                f"nothing between {short(low)} and {short(high)} Hz, near the resonance at {short(f0)} Hz, exceeds "
                f"half the swing ({self._swing(half)}); record a slow sweep, or sines at {short(one)} and "
                f"{short(other)} Hz of {self._swing(1.6 * half)}{by}"
            )
        # The amplitude matters most here, because the motion is largest.
        near = self.points[(self.points[:, 0] > _BELOW * f0) & (self.points[:, 0] < _ABOVE * f0), 1]
        if len(near) and near.min() > 0.7 * near.max():
            lines.append(
                f"all inputs near the resonance at {short(f0)} Hz have almost the same amplitude "
                f"({self._swing(near.max())}), so effects of the amplitude cannot be learned; add some of "
                f"{self._swing(near.max() / 2)}"
            )
        return lines

    def _swing(self, amplitude: float) -> str:
        return f"{short(2 * from_base(float(amplitude), self.unit))} {self.unit} from peak to peak"


def coverage(records: Sequence[Record], input_map: str, resonance: float) -> Coverage | None:
    """Return the frequencies and amplitudes that the records excite, and the gaps; None if nothing is excited.

    Args:
        records: of one sampling rate.
        input_map: "square" or "linear".
        resonance: in Hz.
    """
    points = np.array([p for r in records for p in _points(r, input_map, resonance)])
    if not len(points):
        return None
    largest = float(points[:, 1].max())
    points = points[points[:, 1] > 0.02 * largest]  # a weaker window is not excited
    # without bias the force has twice the input's frequency, and nothing at that frequency itself
    doubled = input_map == "square" and all(abs(r.voltage.mean()) < 0.1 * r.voltage.std() for r in records)
    strong = np.unique(points[points[:, 1] >= largest / 2, 0])
    return Coverage(resonance, points, tuple(_gaps(strong, resonance)), largest, doubled, records[0].voltage_unit)


def _points(record: Record, input_map: str, resonance: float) -> list[tuple[float, float, float]]:
    size = int(min(max(16 / (resonance * record.dt), 64), record.samples))
    force, window, excited = INPUT_MAPS[input_map]().force(record.voltage), np.hanning(size), []
    # windows overlap by half, because the Hann window weights their ends little
    for first in range(0, record.samples - size + 1, max(size // 2, 1)):
        part = np.asarray(force[first : first + size], np.float64)
        power = np.abs(np.fft.rfft((part - part.mean()) * window))[1:] ** 2
        amplitude = float(np.sqrt(2) * record.voltage[first : first + size].std())
        if not power.sum() > 0:
            continue
        order = np.argsort(power)[::-1]
        # as few lines as hold most of the energy
        many = int(np.searchsorted(np.cumsum(power[order]), 0.8 * power.sum())) + 1
        # a line much weaker than its neighbour is leakage of that one
        beside = np.maximum(np.append(power[1:], 0.0), np.append(0.0, power[:-1]))
        lines = [k for k in order[:many] if power[k] >= 0.3 * beside[k]]
        excited += [((k + 1) / (size * record.dt), amplitude, size * record.dt / 2 / len(lines)) for k in lines]
    return excited


def _gaps(strong: np.ndarray, resonance: float) -> list[tuple[float, float]]:
    """Return the intervals (Hz) near the resonance that no strong input excites, the ends of the range included."""
    low, high = _BELOW * resonance, _ABOVE * resonance
    ends = np.concatenate([[min(low, *strong)], strong, [max(high, *strong)]]) if len(strong) else np.array([low, high])
    pairs = [(max(a, low), min(b, high)) for a, b in pairwise(ends)]
    return [(float(a), float(b)) for a, b in pairs if b > 1.5 * a]
