"""Tabulate the frequencies and amplitudes that recordings excite, and measure the part of another signal outside them.

    a(f)    = largest over windows of  sqrt(2 mean square of all parts at f or faster)     32 periods of f long
    part(f) = largest over recordings of the energy fraction in the quarter octave of f

A cell (quarter octave, amplitude a) is excited if a <= 1.5 a(f), and part >= 0.001 within an octave of f. A fast motion
covers a slower one of the same amplitude, so a(f) falls with f, and a steady sine between two trained ones lies inside.
A step excites every frequency a little and counts with its own small amplitude. All frequencies below 0.35 of the
resonance are one band, because only the spring acts there.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

Table = tuple[tuple[float, float, float], ...]

PERIODS, PER_OCTAVE = 32, 4  # of the slowest frequency in a window; bands
TOLERANCE = 1.5  # times the amplitude reached: windows see the same motion at slightly different sizes
_TAPER = 0.5  # of a recording, in both ends of its one window together
_NAMED = 0.01  # of a recording: a frequency that a sentence names, and no spill of the window
_COMMON = 2 / 3  # of the energy of one excitation, in bands where its repetition has it as well,
_ALIKE = 1.2  # and of their amplitudes, which differ by less between repetitions
_TAIL = 0.05  # of the energy outside, which its range of frequencies leaves out on either side


class Beyond(NamedTuple):
    """The part of a signal that lies outside the frequencies and amplitudes that the recordings excited.

    Attributes:
        fraction: of the signal's energy about its mean.
        low_hz, high_hz: its frequency range.
        amplitude: of this part, base unit.
        reached: largest amplitude trained there, base unit.
        below_hz, above_hz: nearest lower and higher frequencies trained at this amplitude; None without one.
    """

    fraction: float
    low_hz: float = 0.0
    high_hz: float = 0.0
    amplitude: float = 0.0
    reached: float = 0.0
    below_hz: float | None = None
    above_hz: float | None = None


class _Bands(NamedTuple):
    """The bands (quarter octaves) of one octave, with their mean squares per window.

    Attributes:
        numbers: of the bands, shape (bands,).
        middle: of their energy, Hz, shape (bands,).
        inside, above: mean squares in each, and in each with all faster ones, shape (windows, bands).
    """

    numbers: np.ndarray
    middle: np.ndarray
    inside: np.ndarray
    above: np.ndarray


def _number(hz):
    # 1, 2, 4, ... Hz, which many recordings hold, lie in the middle of a band
    return np.floor(PER_OCTAVE * np.log2(hz) + 0.5).astype(int)


def _edge(number) -> float:
    return float(2.0 ** ((number - 0.5) / PER_OCTAVE))


def _octaves(signal: np.ndarray, dt: float) -> Iterable[_Bands]:
    """Yield the frequency bands of a signal by octaves; the first item also holds all slower bands."""
    signal = np.asarray(signal, np.float64) - np.mean(signal)
    slowest = int(np.floor(np.log2(PERIODS / (len(signal) * dt))))
    for octave in range(slowest, int(np.ceil(np.log2(0.5 / dt)))):
        whole = octave == slowest
        size = len(signal) if whole else min(round(PERIODS / 2.0**octave / dt), len(signal))
        starts = np.unique(np.append(np.arange(0, len(signal) - size, max(size // 2, 1)), len(signal) - size))
        # a slow part may lie at one end of a recording only, so the single window is flat over half of it
        # Tukey's; `scipy.signal` takes half a second to import
        n, taper = np.arange(size), size * (_TAPER if whole else 1.0)
        window = np.sin(np.pi * np.minimum(np.minimum(n, size - n) / taper, 0.5)) ** 2
        pieces = np.lib.stride_tricks.sliding_window_view(signal, size)[starts] * window
        power = 2 * np.abs(np.fft.rfft(pieces)[:, 1:]) ** 2 / (size * np.sum(window**2))
        hz = np.arange(1, power.shape[1] + 1) / (size * dt)
        numbers = _number(hz)
        here = np.flatnonzero((numbers < PER_OCTAVE * (octave + 1)) & (whole | (numbers >= PER_OCTAVE * octave)))
        if not len(here):
            continue
        own, first = np.unique(numbers[here], return_index=True)
        # from one line below the band: the window spreads a sine over three lines, which then count as one
        above = np.cumsum(power[:, ::-1], 1)[:, ::-1][:, np.maximum(here[first] - 1, 0)]
        inside = np.add.reduceat(power[:, here], first, axis=1)
        moment = np.add.reduceat((power[:, here] * hz[here]).mean(0), first)
        middle = moment / np.maximum(inside.mean(0), 1e-300)
        yield _Bands(own, middle, inside, above)


def tabulate(signals: Sequence[np.ndarray], dt: float) -> Table:
    """Return for every quarter octave the largest amplitude and energy fraction that the signals reach.

    Returns:
        a row for every quarter octave: the middle of its energy (Hz), the amplitude reached at it or above (base
        unit), and the largest fraction of a signal's energy in it.
    """
    rows: dict[int, tuple[float, float, float]] = {}
    for signal in signals:
        octaves = list(_octaves(signal, dt))
        total = sum(o.inside.mean(0).sum() for o in octaves)
        if not total > 0:
            continue
        for o in octaves:
            size, part = np.sqrt(2 * o.above.max(0)), o.inside.mean(0) / total
            for number, *new in zip(o.numbers.tolist(), o.middle, size, part, strict=True):
                old = rows.get(number, (0.0, 0.0, 0.0))
                middle = new[0] if new[2] > old[2] else old[0]
                rows[number] = (float(middle), max(old[1], float(new[1])), max(old[2], float(new[2])))
    return tuple(rows[number] for number in sorted(rows) if rows[number][2] > 0)


class Cells:
    """A table of excited frequency bands, with the amplitude that the recordings reach in each.

    Attributes:
        hz, reached, part: columns of the table, shape (bands,).
    """

    def __init__(self, table: Table, resonance_hz: float):
        """Store the columns of a table; bands below 0.35 of the model's resonance count as one."""
        self.hz, self.reached, self.part = np.array(table).T
        # 0.35 is an edge of the diagnosis's bands
        self._numbers, self._slow = _number(self.hz), int(_number(max(0.35 * resonance_hz, 1e-12)))

    def amplitude(self, number: int) -> float:
        """Return the largest amplitude (base unit) reached in this band or in a faster one."""
        return float(self.reached[self._numbers >= number].max(initial=0.0))

    def excite(self, number: int, amplitude):
        """Return whether the recordings excite this band at these amplitudes, in the shape of `amplitude`."""
        near = np.abs(self._numbers - max(number, self._slow)) <= PER_OCTAVE
        return (amplitude <= TOLERANCE * self.amplitude(number)) & (self.part[near].max(initial=0.0) >= 1e-3)

    def beside(self, low: int, high: int, amplitude: float) -> tuple[float | None, float | None]:
        """Return the nearest excited frequencies (Hz) below and above some bands at this amplitude (None: none)."""
        well = (TOLERANCE * self.reached >= amplitude) & (self.part >= _NAMED)
        down, up = self.hz[well & (self._numbers < low)], self.hz[well & (self._numbers > high)]
        return next(map(float, down[::-1]), None), next(map(float, up), None)

    def full(self) -> tuple[float, float, float]:
        """Return the largest amplitude (base unit), and the lowest and highest frequency (Hz) excited with it."""
        well = (TOLERANCE * self.reached >= self.reached.max()) & (self.part >= _NAMED)
        hz = self.hz[well] if well.any() else self.hz
        return float(self.reached.max()), float(hz[0]), float(hz[-1])


def beyond(table: Table, signal: np.ndarray, dt: float, resonance_hz: float) -> Beyond:
    """Return the part of a signal that lies outside the frequencies and amplitudes of a table.

    Args:
        table: of `tabulate`; an empty one gives a fraction of 0.
        signal: base unit, shape (time,); no missing samples.
        dt: sampling interval in s.
        resonance_hz: of the model.
    """
    if not table or not np.ptp(signal) > 0:
        return Beyond(0.0)
    cells, total, outside = Cells(table, resonance_hz), 0.0, []
    for o in _octaves(signal, dt):
        total += o.inside.mean(0).sum()
        size = np.sqrt(2 * o.above)
        for k, number in enumerate(o.numbers.tolist()):
            new = ~cells.excite(number, size[:, k])
            energy = float(np.mean(o.inside[:, k] * new))
            if energy > 0:
                outside.append((number, energy, float(size[new, k].max())))
    if not outside:
        return Beyond(0.0)
    numbers, energies, sizes = zip(*outside, strict=True)
    energy = np.array(energies)
    passed = np.cumsum(energy) / energy.sum()
    first, last = int(np.searchsorted(passed, _TAIL)), int(np.searchsorted(passed, 1 - _TAIL))
    loudest = first + int(np.argmax(energy[first : last + 1]))
    amplitude, most = sizes[loudest], cells.amplitude(numbers[loudest])
    beside = cells.beside(numbers[first], numbers[last], amplitude)
    return Beyond(
        float(energy.sum() / total), _edge(numbers[first]), _edge(numbers[last] + 1), amplitude, most, *beside
    )


def unexcited(
    table: Table, band: tuple[float, float], amplitude: Callable[[float], float], resonance_hz: float
) -> tuple[float, float] | None:
    """Return the lowest frequency range (Hz) of a band that the recordings did not excite; None if they excited all.

    `amplitude`: of the input that a rig can play at a frequency (base unit).
    """
    if not table:
        return None
    # 1e-6: a band that ends at the edge of a cell does not enter it
    cells, low, high = Cells(table, resonance_hz), int(_number(band[0])), int(_number(band[1] * (1 - 1e-6)))
    ranges = ((n, max(_edge(n), band[0]), min(_edge(n + 1), band[1])) for n in range(low, high + 1))
    missing = [(n, a, b) for n, a, b in ranges if not cells.excite(n, amplitude(np.sqrt(a * b)))]
    if not missing:
        return None
    together = [k for k, (n, _, _) in enumerate(missing) if n - k == missing[0][0]]
    return missing[0][1], missing[together[-1]][2]


def distinct(signals: Sequence[np.ndarray], dt: float) -> tuple[tuple[int, ...], ...]:
    """Group signals by excitation: energy in the same frequency bands at about the same amplitude.

    Two thirds of the energy must be in common bands, and the amplitudes must not differ by more than a fifth.

    Args:
        signals: base unit, each of shape (time,), one sampling interval.
        dt: sampling interval in s.

    Returns:
        the indices of each group, in the order of their first signals.
    """
    groups: list[tuple[dict[int, float], float, list[int]]] = []
    for k, signal in enumerate(signals):
        table = tabulate([signal], dt)
        total, size = sum(part for _, _, part in table), max((a for _, a, _ in table), default=0.0)
        parts = {int(_number(hz)): part / total for hz, _, part in table}
        for other, amplitude, members in groups:
            common = sum(min(part, other.get(number, 0.0)) for number, part in parts.items())
            if common >= _COMMON and size <= _ALIKE * amplitude and amplitude <= _ALIKE * size:
                members.append(k)
                break
        else:
            groups.append((parts, size, [k]))
    return tuple(tuple(members) for _, _, members in groups)
