"""Find the next experiment: the excitation whose responses differ most between two hypotheses.

    maximise over excitations  rms_t (y_a - y_b) / sigma     within stroke, voltages and slews already played

Both are simulated under sines (low, at the resonance, high), steps, and, if voltages of both signs were applied, a
carrier of both signs. The carrier separates a lag before the square from a lag after it. Each experiment starts and
ends at zero volts; one whose stroke would exceed the recorded stroke is made smaller.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...common.numbers import figure
from ..signal.reduced import centred_means
from .data import Case
from .library import Scale
from .search import Hypothesis
from .simulator import Drive

_SIZES = (1.0, 0.7, 0.5, 0.3)  # of the recorded input: smaller ones if an effect would exceed the recorded stroke


@dataclass(frozen=True)
class Experiment:
    """A voltage to record next, with the two effects that it separates.

    Attributes:
        separates: the two effects.
        excitation: its description in words.
        time, voltage: s and V, shape (T,).
        difference: predicted rms difference of the outputs over the noise.
    """

    separates: tuple[str, str]
    excitation: str
    time: np.ndarray
    voltage: np.ndarray
    difference: float

    def __str__(self) -> str:
        """Describe the excitation, its length, and what it separates."""
        return f"{self.excitation} for {figure(self.time[-1], 2)} s, to separate {' from '.join(self.separates)}"


def excitations(low: float, top: float, slew: float, hz: float, dt: float, size: float) -> dict[str, np.ndarray]:
    """Return voltages (V) by name, at the fraction `size` of the range, each about sixty natural periods long."""
    t = np.arange(int(np.clip(60 / hz / dt, 2000, 40000))) * dt
    drives, middle = {}, (top + low) / 2 if low >= 0 else 0.0
    for m in (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 2.5):  # times the natural frequency
        # three periods at least, and ten samples in each
        if m * hz * t[-1] < 3 or m * hz > 0.1 / dt:
            continue
        # within the range and the slew that were played
        swing = size * min((top - low) / 2 * 0.95, slew / (2 * np.pi * m * hz))
        drives[f"a sine of {m * hz:.3g} Hz"] = size * middle - swing * np.cos(2 * np.pi * m * hz * t)
        carrier = size * min(0.95 * top, -0.95 * low, slew / (2 * np.pi * m * hz))
        if carrier > 0:
            drives[f"a sine of {m * hz:.3g} Hz about zero"] = carrier * np.sin(2 * np.pi * m * hz * t)
    level = low + np.repeat([0.2, 0.9, 0.5, 1.0, 0.1, 0.7], -(-len(t) // 6))[: len(t)] * (top - low)
    rise = max(int(np.ceil((top - low) / slew / dt)), 1)
    # a mean over the time that the largest step takes at the largest slew
    ramped = np.convolve(np.pad(level, (rise, 0), mode="edge"), np.ones(rise) / rise, "valid")
    drives["steps of six levels"] = size * ramped[: len(t)]
    return {name: _from_zero(u, slew * dt) for name, u in drives.items()}


def _from_zero(voltage: np.ndarray, step: float) -> np.ndarray:
    """Add ramps from and to zero volts to a voltage, at half the largest change `step` per sample."""
    up, down = (np.linspace(0.0, v, int(np.ceil(2 * abs(v) / step)) + 1)[:-1] for v in (voltage[0], voltage[-1]))
    return np.concatenate([up, voltage, down[::-1]])


def separate(case: Case, scale: Scale, a: Hypothesis, b: Hypothesis, names: tuple[str, str]) -> Experiment | None:
    """Return the excitation that best separates two hypotheses; None if each exceeds the recorded stroke."""
    volts = np.concatenate([s.record.voltage for s in case.series])
    dt = case.series[0].record.dt
    slew = max(float(np.abs(np.diff(s.record.voltage)).max()) for s in case.series) / dt
    limits = float(volts.min()), float(volts.max()), slew, 1 / (2 * np.pi * scale.tau), dt
    reach = max(np.nanmax(s.output) for s in case.series), min(np.nanmin(s.output) for s in case.series)
    noise = float(np.mean([s.noise for s in case.series])) + 1e-12
    best: Experiment | None = None
    for size in _SIZES:
        tried = excitations(*limits, size)
        k = case.thinned
        drives = tuple(Drive(centred_means(u, k, False), dt * k, (0.0, 0.0)) for u in tried.values())
        imagined = replace(case.simulator, drives=drives)
        places, starts = list(range(len(drives))), np.zeros((len(drives), 2))
        # both hypotheses under the same voltages, from rest
        runs = [imagined.run(np.tile(h.fit.slots, (len(drives), 1)), places, starts) for h in (a, b)]
        for (what, u), *pair in zip(tried.items(), *runs, strict=True):
            both = np.stack(pair)
            # at most 5 % beyond the recorded stroke, where neither hypothesis was tested; nan is not inside
            if not (both.max() <= 1.05 * reach[0] + 1e-9 and both.min() >= 1.05 * min(reach[1], 0.0) - 0.02 * reach[0]):
                continue
            difference = float(np.std(both[0] - both[1]) / noise)
            if best is None or difference > best.difference:
                best = Experiment(names, what, np.arange(len(u)) * dt, u, difference)
    return best
