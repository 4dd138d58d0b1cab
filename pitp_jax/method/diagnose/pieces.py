"""Choose pieces of long recordings, so that a diagnosis takes a bounded number of simulated steps.

    distance of two pieces = |f_a - f_b| + OTHER [they are of different recordings]
    f = (spread, log10 centre frequency, mean) of the force and of the motion;  spread and mean in units of the largest

The first piece has the largest motion. Each further piece lies farthest from all chosen ones, until their samples use
up the steps that a run may take. Different motion is thus chosen before repeated motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..model.model import Model
from ..signal.excited import distinct
from ..signal.record import Record
from ..simulate.prediction import at_rate
from .data import THINNED_SAMPLES, steps_a_sample, thinning
from .library import slots_of

RUN_STEPS = 20_000  # samples x steps a sample of one run of all records: a search makes 2,000 to 30,000 runs
_PIECES = 6  # at least
_SHORTEST = 300  # thinned samples of a piece, at least
_OTHER = 0.15  # distance added between pieces of different recordings
_STILL = 0.05  # of the largest motion of a recording: a piece with less shows nothing


@dataclass(frozen=True)
class Piece:
    """A piece of a recording: its start and end, s after the first sample of the recording."""

    record: str
    from_s: float
    to_s: float


def cut(model: Model, records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Piece, ...] | None]:
    """Choose the pieces of long recordings that a search uses.

    Args:
        model: the nominal.
        records: recordings that move.

    Returns:
        the records and None if a run of all of them takes at most `RUN_STEPS`. Otherwise pieces of them, each with the
            name and times of its recording, and their origins.
    """
    model, (nominal, _) = at_rate(model, records[0].dt), slots_of(model)
    k, samples = thinning(model, nominal, records), sum(r.samples for r in records)
    if samples / k * steps_a_sample(nominal, k * records[0].dt) <= RUN_STEPS:
        return tuple(records), None
    # as fine as a short set is thinned
    k = thinning(model, nominal, records, most=np.inf)
    steps = steps_a_sample(nominal, k * records[0].dt)
    most = int(min(THINNED_SAMPLES, RUN_STEPS / steps)) * k
    # one piece of each distinct excitation, as far as the pieces remain long enough
    groups = len(distinct([r.voltage for r in records], records[0].dt))
    size = max(most // max(groups, _PIECES), min(_SHORTEST * k, most // _PIECES))
    windows = [w for r in records for w in _windows(r, size)]
    chosen, total = [], 0
    for n in _farthest(_features(model, windows, records), [id(w.record) for w in windows]):
        total += windows[n].last - windows[n].first
        if total > most and len(chosen) >= _PIECES:
            break
        chosen.append(windows[n])
    place = {id(r): n for n, r in enumerate(records)}
    chosen.sort(key=lambda w: (place[id(w.record)], w.first))
    pieces = tuple(_piece(w) for w in chosen)
    return tuple(w.taken() for w in chosen), pieces


@dataclass(frozen=True)
class _Window:
    """The samples `first` to `last` - 1 of a record."""

    record: Record
    first: int
    last: int

    def taken(self) -> Record:
        """Return these samples as a record with the name of the recording."""
        part = slice(self.first, self.last)
        r = self.record
        return replace(r, time=r.time[part], voltage=r.voltage[part], displacement=r.displacement[part])


def _piece(window: _Window) -> Piece:
    time = window.record.time
    return Piece(window.record.name, float(time[window.first] - time[0]), float(time[window.last - 1] - time[0]))


def _windows(record: Record, size: int) -> list[_Window]:
    """Cut a record into equal windows of at most `size` samples; return the windows with enough motion."""
    edges = np.linspace(0, record.samples, -(-record.samples // size) + 1).astype(int)
    windows = [_Window(record, int(a), int(b)) for a, b in zip(edges, edges[1:], strict=False)]
    moves = [_spread(record.displacement[w.first : w.last]) for w in windows]
    return [w for w, m in zip(windows, moves, strict=True) if m > _STILL * max(moves)]


def _spread(values: np.ndarray) -> float:
    """Return the standard deviation of the measured samples; 0 if at most half of the samples are measured."""
    there = np.isfinite(values)
    return float(values[there].std()) if 2 * there.sum() > len(values) else 0.0


def _features(model: Model, windows: Sequence[_Window], records: Sequence[Record]) -> np.ndarray:
    """Return spread, centre frequency (log10) and mean of force and motion of every window, (windows, 6)."""
    columns = []
    forces = [model.input_map.force(r.voltage) for r in records]
    at = {id(r): n for n, r in enumerate(records)}
    for signals in (forces, [r.displacement for r in records]):
        parts = [signals[at[id(w.record)]][w.first : w.last] for w in windows]
        spread = np.array([_spread(p) for p in parts])
        # rms of the differences over that of the values: the centre of the band
        speed = np.array([_spread(np.diff(p)) for p in parts]) / np.maximum(spread, 1e-300)
        moves = spread > _STILL * spread.max()
        hertz = np.log10(np.maximum(np.where(moves, speed, np.median(speed[moves])), 1e-300))
        mean = np.array([np.nanmean(p) if np.isfinite(p).any() else 0.0 for p in parts])
        columns += [spread / spread.max(), hertz, mean / max(np.ptp(mean), 2 * spread.max())]
    return np.stack(columns, 1)


def _farthest(features: np.ndarray, owners: Sequence[int]) -> list[int]:
    """Order all windows: the largest motion first, then always the one farthest from all before it."""
    owner, order = np.array(owners), [int(np.argmax(features[:, 3]))]
    distance = np.full(len(features), np.inf)
    while len(order) < len(features):
        last = order[-1]
        away = np.linalg.norm(features - features[last], axis=1) + _OTHER * (owner != owner[last])
        distance = np.minimum(distance, away)
        distance[order] = -1.0
        order.append(int(np.argmax(distance)))
    return order
