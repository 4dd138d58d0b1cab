"""Seven records a set, as in shared/gap: a sweep, four sines, a multisine, steps; cone at 1 kHz, roll at 5 kHz.

    F = u^2,  a_0 = U^2 / X,  a_1 = 2 zeta a_0 / w0,  a_2 = a_0 / w0^2       (zeta 0.03 to 0.12, log-uniform)
    y_measured = round((y + noise) / digit) digit,  digit = twice the pooled range / 2^16

The noise is 0.3 % of range in the norm of the gap, sqrt(mean over records (std / range)^2), of a colour of NOISES;
coarse: nearly all of it is the digit's own.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from pitp_jax import Record
from pitp_jax.application.plan import waveforms

NAMES = ("sweep", "sine0", "sine1", "sine2", "sine3", "multisine", "steps")
SESSION = 26  # record lengths from the first sample of a session to its last
_STARTS = (0, 5, 9, 13, 17, 21, 25)  # in record lengths: the sweep is two long
_NOISE, _COARSE = 0.003, 0.25
_SETTLES = 2000  # samples until a colour has settled


def _memory(pole: float):
    """An autoregression's (numerator, denominator), of variance 1."""
    return [np.sqrt(1 - pole**2)], [1.0, -pole]


NOISES = {
    "white": ([1.0], [1.0]), "ar": _memory(0.9), "ar98": _memory(0.98), "average": ([20**-0.5] * 20, [1.0]),
    "coarse": ([1.0], [1.0]),
}  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """One kind of actuator: rate (Hz), record length (s), volts, resonance (Hz), X (m), bands over the resonance."""

    rate: float
    length: float
    top: float
    offset: float
    f0: float
    scale: float
    sines: tuple[tuple[float, float], ...]
    sweep: tuple[float, float, float]
    multisine: tuple[float, float, float]
    lag: float


KINDS = {
    "cone": Kind(1e3, 10.0, 5500.0, 3000.0, 7.0, 3.5e-3,
                 ((0.085, 1170.0), (0.22, 2340.0), (0.5, 1820.0), (1.15, 780.0)),
                 (0.07, 1.55, 2080.0), (0.045, 1.1, 2420.0), 22e-3),
    "roll": Kind(5e3, 3.0, 1200.0, 700.0, 142.0, 0.56e-3,
                 ((0.056, 225.0), (0.134, 450.0), (0.315, 350.0), (0.74, 150.0)),
                 (0.035, 0.98, 400.0), (0.03, 0.69, 475.0), 1.8e-3),
}  # fmt: skip
KINDS["short"] = replace(KINDS["cone"], length=2.0)  # for tests and --smoke


@dataclass(frozen=True)
class Healthy:
    """A drawn plant: damping ratio, resonance in Hz, static displacement X (m) under the largest voltage."""

    kind: Kind
    zeta: float
    f0: float
    scale: float

    @property
    def constants(self) -> dict[str, float]:
        """What the integrator needs."""
        return {"zeta": self.zeta, "step": 2 * np.pi * self.f0 / self.kind.rate, "seconds": 1 / self.kind.rate}


def draw_plant(kind: Kind, rng: np.random.Generator) -> Healthy:
    """A healthy plant of that kind."""
    zeta = np.exp(rng.uniform(np.log(0.03), np.log(0.12)))
    return Healthy(kind, zeta, kind.f0 * rng.uniform(0.85, 1.15), kind.scale * rng.uniform(0.8, 1.25))


def draw_voltages(plant: Healthy, rng: np.random.Generator) -> list[np.ndarray]:
    """The voltages of one set in V, rounded as in a file; the sweep twice as long as the others."""
    k, f0 = plant.kind, plant.kind.f0
    careful = min(1.0, np.sqrt(plant.zeta / 0.08))  # nobody drives a lightly damped actuator as hard over its resonance
    low, high, swing = k.sweep
    size = careful * swing * rng.uniform(0.9, 1.1)
    waves = [waveforms.sweep(low * f0, high * f0, 2 * k.length, k.rate, size, k.offset)]
    for ratio, swing in k.sines:
        size = swing * rng.uniform(0.85, 1.06) * (careful if ratio > 0.4 else 1.0)
        waves.append(waveforms.sine(ratio * f0 * rng.uniform(0.85, 1.15), k.length, k.rate, size, k.offset))
    low, high, swing = k.multisine
    band = (low * f0, high * f0)
    waves.append(
        waveforms.multisine(band, k.length, k.rate, careful * swing * rng.uniform(0.8, 1.0), k.offset, seed=rng)
    )
    levels = np.repeat(rng.uniform(0.12, 0.93, 8) * k.top, round(k.length * k.rate / 8))
    pole = np.exp(-1 / (k.lag * k.rate))
    steps = k.offset + lfilter([0.0, 1 - pole], [1.0, -pole], levels - k.offset)  # from the offset, as the others
    return [np.round(u, 2) for u in [u for _, u in waves] + [steps]]


def clocks(kind: Kind) -> np.ndarray:
    """Session time of the first sample of every record in s, shape (7,)."""
    return np.asarray(_STARTS) * kind.length


def stack(rows: list[np.ndarray]) -> np.ndarray:
    """Records of unlike length as (R, T), the last value held."""
    longest = max(map(len, rows))
    return np.stack([np.pad(row, (0, longest - len(row)), mode="edge") for row in rows])


def noise_std(outputs: list[np.ndarray]) -> float:
    """Standard deviation of the sensor noise, in the unit of the outputs."""
    return _NOISE / float(np.sqrt(np.mean([1 / np.ptp(y) ** 2 for y in outputs])))


def measure(outputs: list[np.ndarray], noise: str, rng: np.random.Generator) -> list[np.ndarray]:
    """Noisy readings in m of noise-free outputs in m, in whole digits of the sensor and of the file (0.1 um)."""
    std, digit, readings = noise_std(outputs), 2 * np.ptp(np.concatenate(outputs)) / 2**16, []
    if noise == "coarse":
        std, digit = _COARSE * std, np.sqrt(12 * (1 - _COARSE**2)) * std
    settle = 200 if noise in ("white", "ar") else _SETTLES  # as it was drawn for the figures on record
    for y in outputs:
        e = np.asarray(lfilter(*NOISES[noise], rng.standard_normal(len(y) + settle)))[settle:]
        readings.append(np.round(np.round((y + std * e) / digit) * digit, 7))
    return readings


def records(kind: Kind, starts, voltages, readings) -> list[Record]:
    """A set of records, from `starts` (s) on."""
    return [
        Record(name, start + np.arange(len(u)) / kind.rate, u, y, displacement_unit="mm", source=f"withheld {name}")
        for name, start, u, y in zip(NAMES, starts, voltages, readings, strict=True)
    ]
