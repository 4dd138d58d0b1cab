"""Pair the recordings of two sets by their drives: which of B played what A played, and how far their clocks are apart.

    rho(k) = sum_i (a_i - mean a) (b_{i+k} - mean b) / (T_k std a std b)      over the T_k samples that overlap at lag k
    offset = argmin_d sum_t (a(t) - b(t - d))^2                               Gauss-Newton on interpolated samples

Of several lags that fit alike (a sine repeats every period) the one with the longest overlap is taken. Names say
nothing: two programs name their files differently. An assignment problem gives every recording at most one partner.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import correlate

from .._record.record import Record
from .._report.numbers import number

ALIKE = 0.99  # correlation from which two drives are the same one
_SAME_SIZE = 0.1  # relative difference of amplitude up to which two drives are the same one
_OVERLAP = 0.5  # of the shorter recording, at least
_COARSE = 8192  # samples of the finer search for the lag
_AS_GOOD = 2e-3  # correlations that differ by less are equal: what noise of a logged drive makes of the same lag


@dataclass(frozen=True)
class Pair:
    """Two recordings of one drive.

    Attributes:
        first, second: the recordings; both carry the drive at times t and t - offset of their own clocks.
        offset: clock of `first` less clock of `second` at the same instant, s.
        correlation: of the two drives where they overlap.
    """

    first: Record
    second: Record
    offset: float
    correlation: float

    def drive(self) -> np.ndarray:
        """Interpolate the second's drive at the times of the first, held at its ends; shape (T,)."""
        return np.interp(self.first.time - self.offset, self.second.time, self.second.voltage)

    def output(self) -> np.ndarray:
        """Interpolate the second's output at the times of the first; nan outside and where missing, shape (T,)."""
        return np.interp(
            self.first.time - self.offset, self.second.time, self.second.displacement, left=np.nan, right=np.nan
        )


@dataclass(frozen=True)
class Pairing:
    """Pairs, and the recordings without a partner: (name, why) of the first and of the second set."""

    pairs: tuple[Pair, ...]
    first_alone: tuple[tuple[str, str], ...]
    second_alone: tuple[tuple[str, str], ...]

    def remarks(self, first: str, second: str) -> list[str]:
        """Say in sentences what a user should know of clocks and partners; `first` and `second` name the sets."""
        named = [f"{p.first.name} with {p.second.name}" for p in self.pairs if p.first.name != p.second.name]
        lines = [f"Paired by their commands ({first} with {second}): {', '.join(named)}."] if named else []
        offsets = [p.offset for p in self.pairs]
        # below 0.1 ms it is interpolation
        if offsets and max(map(abs, offsets)) >= 1e-4:
            sizes = sorted(abs(o) for o in offsets)
            middle, apart = float(np.median(sizes)), sizes[-1] - sizes[0]
            by = number(round(middle, 3)) if apart < 5e-3 else f"{number(sizes[0])} to {number(sizes[-1])}"
            word = "ahead of" if np.median(offsets) > 0 else "behind"
            lines.append(f"The clock of the {first} is {by} s {word} that of the {second}; this is no delay.")
        for side, alone in ((first, self.first_alone), (second, self.second_alone)):
            lines += [f"Recording {name} of the {side} has no partner: {why}." for name, why in alone]
        return lines


def pair_records(first: Sequence[Record], second: Sequence[Record]) -> Pairing:
    """Find for each recording of one set the recording of the other with the same drive.

    Args:
        first, second: recordings of two machines, or of a machine and its simulator; rates may differ.

    Returns:
        the pairs in the order of the first set, and what has no partner.
    """
    tried = {(i, j): _match(a, b) for i, a in enumerate(first) for j, b in enumerate(second)}
    # the smallest sum of misfits: one greedy choice could take away the only partner of another recording
    cost = np.array([[_cost(tried[i, j]) for j in range(len(second))] for i in range(len(first))])
    rows, columns = linear_sum_assignment(cost)
    chosen = {i: j for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if _accepted(tried[i, j])}
    pairs = tuple(
        Pair(first[i], second[j], tried[i, j].offset, tried[i, j].correlation) for i, j in sorted(chosen.items())
    )
    alone = [
        tuple(
            (r.name, _why([tried[key(k, o)] for o in range(len(others))], [o.name for o in others]))
            for k, r in enumerate(mine)
            if k not in used
        )
        for mine, others, used, key in (
            (first, second, set(chosen), lambda k, o: (k, o)),
            (second, first, set(chosen.values()), lambda k, o: (o, k)),
        )
    ]
    return Pairing(pairs, *alone)


@dataclass(frozen=True)
class _Match:
    """How two drives lie on each other: correlation, offset (s), amplitude of the first over the second, misfit."""

    correlation: float
    offset: float
    size: float
    misfit: float


def _cost(m: _Match) -> float:
    return m.misfit if _accepted(m) else 10.0  # above any accepted misfit, and finite, as the assignment needs


def _accepted(m: _Match) -> bool:
    return m.correlation >= ALIKE and abs(m.size - 1) <= _SAME_SIZE


def _why(matches: Sequence[_Match], names: Sequence[str]) -> str:
    best = max(range(len(matches)), key=lambda k: matches[k].correlation)
    m = matches[best]
    if _accepted(m):
        return f"its drive is that of {names[best]}, which has a closer partner"
    if m.correlation >= ALIKE:
        return f"{names[best]} has the same drive at another size (factor {m.size:.3g}); are the units right"
    return f"no drive correlates with its own by {ALIKE:g} (closest: {names[best]}, {m.correlation:.2f})"


def _match(a: Record, b: Record) -> _Match:
    """Search all lags on a common grid, then refine the best between samples."""
    dt = max(a.dt, b.dt)
    longest = max(a.time[-1] - a.time[0], b.time[-1] - b.time[0])
    dt *= max(1, int(np.ceil(longest / dt / _COARSE)))  # the peak is refined between samples anyway
    x, y = (_on_grid(r, dt) for r in (a, b))
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return _Match(0.0, 0.0, np.inf, np.inf)
    lags, rho = _correlation(x, y)
    overlap = np.minimum(len(x), lags + len(y)) - np.maximum(0, lags)
    good = np.flatnonzero(rho >= rho.max() - _AS_GOOD)
    at = good[np.lexsort((-rho[good], -overlap[good]))[0]]
    at = int(at + np.argmax(rho[max(at - 2, 0) : at + 3]) - min(at, 2))  # the peak beside the longest overlap
    offset = float(a.time[0] - b.time[0] + lags[at] * dt)  # of clocks: lags count samples from both beginnings
    return _refined(a, b, offset, float(rho[at]))


def _on_grid(record: Record, dt: float) -> np.ndarray:
    count = int((record.time[-1] - record.time[0]) / dt + 1e-9) + 1
    return np.interp(record.time[0] + dt * np.arange(count), record.time, record.voltage)


def _correlation(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags k (x_i beside y_{i-k}) with enough overlap, and the correlation at each."""
    lags = np.arange(-(len(y) - 1), len(x))
    low, high = np.maximum(0, lags), np.minimum(len(x), lags + len(y))
    keep = (high - low) >= _OVERLAP * min(len(x), len(y))
    lags, low, high = lags[keep], low[keep], high[keep]
    x, y = x - x.mean(), y - y.mean()
    cross = correlate(x, y, method="fft")[keep]
    count = high - low

    def sums(values, first, last):  # over any stretch, as a difference of two cumulative sums
        total = np.concatenate([[0.0], np.cumsum(values)])
        return total[last] - total[first]

    sx, sxx = sums(x, low, high), sums(x * x, low, high)
    sy, syy = sums(y, low - lags, high - lags), sums(y * y, low - lags, high - lags)
    spread = np.maximum(sxx - sx**2 / count, 0) * np.maximum(syy - sy**2 / count, 0)
    # a stretch in which hardly anything moves correlates with everything
    moving = spread > 0.05 * (x @ x) * (y @ y)
    rho = np.where(moving, (cross - sx * sy / count) / np.sqrt(np.where(moving, spread, 1.0)), 0.0)
    return lags, rho


def _refined(a: Record, b: Record, offset: float, correlation: float) -> _Match:
    """Refine the offset between samples, and measure how alike the drives are at it."""
    step = max(a.dt, b.dt)
    for _ in range(8):
        inside, x, y = _overlap(a, b, offset)
        if inside.sum() < 8:
            return _Match(0.0, offset, np.inf, np.inf)
        slope = np.gradient(y, a.dt)
        # a step of at most a sample: the correlation's peak is that near, and a square wave has no slope to trust
        move = float(np.clip(-((x - x.mean() - y + y.mean()) @ slope) / max(slope @ slope, 1e-300), -step, step))
        offset += move
        if abs(move) < 1e-6 * step:
            break
    _, x, y = _overlap(a, b, offset)
    x_, y_ = x - x.mean(), y - y.mean()
    if not (np.any(x_) and np.any(y_)):
        return _Match(0.0, offset, np.inf, np.inf)
    rho = float(x_ @ y_ / np.sqrt((x_ @ x_) * (y_ @ y_)))
    size = float(np.sqrt((x_ @ x_) / (y_ @ y_)))
    return _Match(max(rho, correlation), offset, size, float(np.sqrt(np.mean((x - y) ** 2)) / x_.std()))


def _overlap(a: Record, b: Record, offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    at = a.time - offset
    inside = (at >= b.time[0]) & (at <= b.time[-1])
    return inside, a.voltage[inside], np.interp(at[inside], b.time, b.voltage)
