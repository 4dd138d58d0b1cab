"""Store the longest record used for identification, thinned, because only a long sweep shows slow creep.

    x_k = (h * x)(k q dt),    q = floor(1 / (4 f_max dt))        h: zero-phase low-pass, f_max: of the force, 99 %

It is read as band-limited between its samples. Linear interpolation would change the mean force behind an electrode's
lag by 2 % at 15 Hz.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from .preprocess import force_band
from .record import Record, part_of

_MOST = 150_000  # samples kept in all
_LEAST = 600  # samples kept if the record has them: 100 windows of six in `method/train/creep_balance`
_READ = 1_000_000  # samples of the record that count, because every fitting step integrates its memories along them


@dataclass(frozen=True, eq=False)
class LongRecord:
    """A thinned record in base units, with the sensor's offset and direction unchanged.

    Attributes:
        dt: sampling interval of the original record, s.
        step: every `step`-th sample is kept.
        rest: whether it starts from rest.
        voltage, displacement: float32, in V and m (or V), nan where the output is missing; shape (kept,).
    """

    dt: float
    step: int
    rest: bool
    voltage: np.ndarray
    displacement: np.ndarray

    def __post_init__(self):
        """Refuse voltage and displacement of different length."""
        if self.voltage.shape != self.displacement.shape or self.voltage.ndim != 1 or self.step < 1:
            raise ValueError(f"a long record of shapes {self.voltage.shape} and {self.displacement.shape}")

    @property
    def seconds(self) -> float:
        """Return the duration of the stored record, s."""
        return len(self.voltage) * self.step * self.dt

    @property
    def range(self) -> float:
        """Return the output's range: largest minus smallest displacement, m (or V)."""
        return float(np.nanmax(self.displacement) - np.nanmin(self.displacement))

    def record(self) -> Record:
        """Return the record resampled to its original rate."""
        voltage, kept = self.voltage.astype(float), self.displacement.astype(float)
        seen, place = np.isfinite(kept), np.arange(len(kept))
        displacement = self._between(np.interp(place, place[seen], kept[seen]))
        # values filled in for resampling become missing again
        displacement[np.repeat(~seen, self.step)] = np.nan
        return Record("long record", self.dt * np.arange(len(displacement)), self._between(voltage), displacement)

    def _between(self, kept: np.ndarray) -> np.ndarray:
        return scipy.signal.resample_poly(kept, self.step, 1, padtype="line")


def thinned(record: Record, force: np.ndarray, rest: bool) -> LongRecord | None:
    """Return a record at fewer samples, for storage in a model; None if its input or output never changes.

    `force`: input of the equation (V^2 or V), shape (T,).
    """
    if record.samples > _READ:
        if not record.observed[:_READ].any():
            return None
        record, force = part_of(record, slice(_READ)), force[:_READ]
    if np.ptp(force) == 0:
        return None
    step = int(1 / (4.0 * force_band([force], record.dt) * record.dt))
    # rounded up: never more than the most that are kept
    step = max(step, -(-record.samples // _MOST), 1)
    step = min(step, max(record.samples // _LEAST, 1))
    # the low-pass needs every sample
    seen = np.ones(-(-record.samples // step), bool)
    # a kept sample is missing if any sample of its block is
    seen[np.flatnonzero(~record.observed) // step] = False
    displacement = np.where(seen, _thin(record.filled, step), np.nan)
    return LongRecord(record.dt, step, rest, _thin(record.voltage, step).astype("<f4"), displacement.astype("<f4"))


def _thin(values: np.ndarray, step: int) -> np.ndarray:
    """Low-pass and thin a signal about the line between its ends; an offset would otherwise distort both ends."""
    return scipy.signal.resample_poly(values, 1, step, padtype="line")
