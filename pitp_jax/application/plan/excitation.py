"""Build the excitations of the paper's protocol for its two actuators, cone and roll.

    cone, 1 kHz   sweep 0.01-20 Hz, 200 s, A1 = A2 = 3 kV
                  30 sines of 10 s: 1..10 Hz x A3 in {1, 2, 3} kV, A4 = 3 kV
    roll, 5 kHz   sweep 0.01-180 Hz, 90 s, A1 = A2 = 700 V
                  78 sines of 3 s: 5..130 Hz in steps of 5 x A3 in {200, 350, 500} V, A4 = 700 V

The paper counts 900,000 and 1,170,000 samples: the cone's include 20 s of rest per sine (`rest_s=20`), the
roll's do not.
"""

from dataclasses import dataclass

import numpy as np

from .waveforms import Waveform, complex_trajectory, multisine, sine, steps, sweep, triangle

__all__ = [
    "Excitation",
    "complex_trajectory",
    "multisine",
    "protocol",
    "sine",
    "steps",
    "sweep",
    "triangle",
]


@dataclass(frozen=True)
class Excitation:
    """A voltage over time to be played on a rig.

    Attributes:
        name: for its record.
        time: sample times in s from 0, shape (T,).
        voltage: in V, shape (T,).
    """

    name: str
    time: np.ndarray
    voltage: np.ndarray

    @property
    def dt(self) -> float:
        """Return the sampling interval of the voltage, s."""
        return float(self.time[-1] / (len(self.time) - 1))


@dataclass(frozen=True)
class _Protocol:
    """The protocol of the paper's section III-C for one actuator, in V, Hz and s."""

    rate: float
    f_end: float
    sweep_s: float
    frequencies: tuple[float, ...]
    amplitudes: tuple[float, ...]
    offset: float
    sine_s: float
    test: tuple[tuple[float, float], ...]  # frequency and amplitude off the training grid


_PROTOCOLS = {
    "cone": _Protocol(
        rate=1e3,
        f_end=20.0,
        sweep_s=200.0,
        frequencies=tuple(float(f) for f in range(1, 11)),
        amplitudes=(1000.0, 2000.0, 3000.0),
        offset=3000.0,
        sine_s=10.0,
        test=(
            (0.7, 2600.0),
            (1.5, 1500.0),
            (2.7, 2600.0),
            (3.3, 1500.0),
            (5.5, 1500.0),
            (6.6, 2600.0),
            (9.3, 1500.0),
        ),
    ),
    "roll": _Protocol(
        rate=5e3,
        f_end=180.0,
        sweep_s=90.0,
        frequencies=tuple(float(f) for f in range(5, 131, 5)),
        amplitudes=(200.0, 350.0, 500.0),
        offset=700.0,
        sine_s=3.0,
        test=(
            (7, 300.0),
            (33, 300.0),
            (41, 450.0),
            (62, 300.0),
            (73, 450.0),
            (88, 300.0),
            (112, 300.0),
            (127, 300.0),
        ),
    ),
}
SETS = ("sweep", "train", "test")


def protocol(actuator: str, part: str = "train", *, rest_s: float = 0.0, rise: float = 0.0) -> tuple[Excitation, ...]:
    """Return the input voltages of the paper's protocol for one actuator: sweep, training sines or test signals.

    Args:
        actuator: `cone` or `roll`.
        part: `sweep` (one record), `train` (the sines: 30 or 78), or `test` (ours: sines off the grid, a
            triangle, a complex drive).
        rest_s: seconds of zero voltage appended to each.
        rise: seconds of smooth ramp at the start of each; eq. 14 itself starts at A4 - A3 with a jump.

    Returns:
        the excitations, named `sweep`, `sine_003Hz_2000V` (frequency and A3), `sine_000.7Hz_2600V`,
        `triangle`, `complex`.

    Raises:
        ValueError: unknown actuator or part.
    """
    if actuator not in _PROTOCOLS or part not in SETS:
        raise ValueError(
            f"there is no protocol {actuator!r} {part!r}; choose one of {tuple(_PROTOCOLS)} and one of {SETS}"
        )
    numbers = _PROTOCOLS[actuator]
    edges = {"rise": rise, "rest_s": rest_s}
    if part == "sweep":
        swing = numbers.offset
        drive = sweep(0.01, numbers.f_end, numbers.sweep_s, numbers.rate, swing, swing, **edges)
        return (Excitation("sweep", *drive),)
    grid, digits = numbers.test, "05.1f"
    if part == "train":
        grid, digits = [(f, a) for f in numbers.frequencies for a in numbers.amplitudes], "03.0f"
    sines = tuple(
        Excitation(f"sine_{f:{digits}}Hz_{a:.0f}V", *sine(f, numbers.sine_s, numbers.rate, a, numbers.offset, **edges))
        for f, a in grid
    )
    if part == "train":
        return sines
    middle = numbers.frequencies[len(numbers.frequencies) // 3]
    shape = (middle, numbers.sine_s, numbers.rate, 0.8 * numbers.amplitudes[-1], numbers.offset)
    others: tuple[tuple[str, Waveform], ...] = (
        ("triangle", triangle(*shape, **edges)),
        ("complex", complex_trajectory(0.5 * shape[0], *shape[1:], seed=18, **edges)),
    )
    return sines + tuple(Excitation(name, *drive) for name, drive in others)
