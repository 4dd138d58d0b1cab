"""A bench: its records, which of the held-out ones repeat a training cell, and the noise the repeats reveal.

    two records of one cell, y = x + e and y' = x + e':    sigma^2 = mean (y - y')^2 / 2
    floor of a record / %  = 100 sigma / (max y - min y),    floor-free e = sqrt(e_rms^2 - floor^2)

sigma is the cell's own for a record that repeats one, the mean over the repeats for every other record. What is
below the resolution of the estimate (two standard errors of a mean of T squares) is reported as that resolution.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pitp_jax as pitp

_SINE = re.compile(r"sine_([\d.]+)Hz_([\d.]+)V")


def cell(name: str) -> tuple[float, float] | None:
    """Frequency (Hz) and amplitude (V) of a sine, by its name; None for any other record."""
    found = _SINE.match(name)
    return (float(found[1]), float(found[2])) if found else None


@dataclass(frozen=True)
class Bench:
    """Records of one actuator.

    Attributes:
        name: of its folder.
        sweep, train, test: records.
        noise: per name of a test record that repeats a training cell, the sensor noise of the pair, base unit.
    """

    name: str
    sweep: tuple
    train: tuple
    test: tuple
    noise: dict[str, float]

    def floor_percent(self, record) -> float:
        """Noise in percent of the record's range; nan where nothing repeats."""
        typical = np.sqrt(np.mean(np.square(list(self.noise.values())))) if self.noise else np.nan
        return 100 * self.noise.get(record.name, typical) / np.ptp(record.displacement[record.observed])


def repeats(train, test) -> dict[str, float]:
    """Noise of every test record that repeats a training cell, sample by sample under the same voltage."""
    cells = {cell(r.name): r for r in train if cell(r.name)}
    noise = {}
    for record in test:
        twin = cells.get(cell(record.name))
        if twin is None:
            continue
        if twin.samples != record.samples or not np.allclose(twin.voltage, record.voltage, rtol=0, atol=1e-3):
            raise ValueError(f"{record.name} and {twin.name} share a cell but not their voltage: compare the files")
        noise[record.name] = float(np.sqrt(np.nanmean((record.displacement - twin.displacement) ** 2) / 2))
    return noise


def load(folder: Path, smoke: bool = False) -> Bench:
    """Read sweep/, train/ and test/ under a folder; `smoke` keeps a few of each, one repeat among them."""
    sweep, train, test = (tuple(pitp.read(folder / part)) for part in ("sweep", "train", "test"))
    noise = repeats(train, test)
    if smoke:
        few = set(list(noise)[:1])
        train = tuple(r for r in train if cell(r.name) in map(cell, few)) + train[:: max(len(train) // 4, 1)]
        test = tuple(r for r in test if r.name in few) + tuple(r for r in test if r.name not in noise)[:5:2]
    return Bench(folder.name, sweep, train, test, noise)


def floor_free(error: float, floor: float, samples: int) -> float:
    """sqrt(e^2 - floor^2), no smaller than what `samples` white samples can tell from zero."""
    resolution = 2 * np.sqrt(2 / samples) * floor**2
    return float(np.sqrt(max(error**2 - floor**2, resolution)))
