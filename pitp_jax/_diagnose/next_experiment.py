"""The next experiment: the excitation under which two tied explanations differ most.

    maximise over excitations  rms_t (y_a - y_b) / sigma     within the voltages and slews already played

Both explanations are rolled out under sines (low, through the resonance, high), steps, and, where voltages of either
sign were played, a carrier of either sign stepped through frequency, which parts what lags before the square from what
lags behind it. Each starts from zero volts and goes back there.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from .._record.record import Record
from .._simulate import ports
from .batched_rollouts import Lanes
from .case import Case, Series
from .fit import lane_of
from .noise import Noise

if TYPE_CHECKING:
    from .evaluation import Judged


@dataclass(frozen=True)
class Experiment:
    """A playable excitation.

    Attributes:
        separates: the two names.
        excitation: what it is, in words.
        time, voltage: s and V, shape (T,).
        difference: predicted rms difference of the outputs over the noise.
    """

    separates: tuple[str, str]
    excitation: str
    time: np.ndarray
    voltage: np.ndarray
    difference: float


def excitations(case: Case) -> dict[str, np.ndarray]:
    """Voltages by what they are, within what was played; each about sixty natural periods long, and the ramps."""
    hz, dt = case.surroundings.omega / (2 * np.pi), case.dt
    t = np.arange(int(np.clip(60 / hz / dt, 2000, 20000))) * dt
    low = min(float(s.record.voltage.min()) for s in case.series)
    top, slew = max(float(s.record.voltage.max()) for s in case.series), case.surroundings.slew
    found = {}
    for m in (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 2.5):
        swing = min((top - low) / 2 * 0.95, slew / (2 * np.pi * m * hz))
        found[f"sine of {m * hz:.3g} Hz"] = (top + low) / 2 - swing * np.cos(2 * np.pi * m * hz * t)
        carrier = min(0.95 * top, -0.95 * low, slew / (2 * np.pi * m * hz))
        if carrier > 0:
            found[f"sine of {m * hz:.3g} Hz about zero volts"] = carrier * np.sin(2 * np.pi * m * hz * t)
    level = low + np.repeat([0.2, 0.9, 0.5, 1.0, 0.1, 0.7], -(-len(t) // 6))[: len(t)] * (top - low)
    rise = max(int((top - low) / slew / dt), 1)
    found["steps of six levels"] = np.convolve(np.pad(level, (rise, 0), mode="edge"), np.ones(rise) / rise, "valid")[
        : len(t)
    ]
    return {name: _from_zero(u, slew * dt) for name, u in found.items()}


def _from_zero(voltage: np.ndarray, step: float) -> np.ndarray:
    """With a ramp from zero volts before it and one back behind it, of half the largest step a sample."""
    up, down = (np.linspace(0.0, v, int(np.ceil(2 * abs(v) / step)) + 1)[:-1] for v in (voltage[0], voltage[-1]))
    return np.concatenate([up, voltage, down[::-1]])


def separate(case: Case, a: "Judged", b: "Judged", noise: Noise) -> Experiment:
    """The best of `excitations`."""
    tried = excitations(case)
    model, n = case.model, case.model.order
    series = []
    for voltage in tried.values():
        time = np.arange(len(voltage)) * case.dt
        late = ports.delayed(model, jnp.asarray(voltage, jnp.float32), case.dt, True)
        film = np.asarray(model.drive.film(late, case.dt, jnp.asarray(True)), np.float64)
        blank = np.zeros(len(voltage))
        motion = np.zeros((len(voltage), n + 1))
        record = Record("next", time, voltage, blank)
        start = np.asarray(case.series[0].start)
        start = np.zeros_like(start) if not case.series[0].rest else start
        series.append(
            Series(record, False, film, blank, motion, motion, blank, blank, blank, blank, True, start, 0.0, 0.0, 1.0)
        )
    imagined = replace(case, series=tuple(series))
    lanes = Lanes(imagined, [(*a.candidate.forms, *b.candidate.forms)])
    first, second = (lanes.run([lane_of(j.candidate, k) for k in range(len(series))]) for j in (a, b))
    gains = []
    for x, y in zip(first, second, strict=True):
        d = x.astype(float) - y
        gains.append(float(np.sqrt(np.mean(d**2)) / max(noise.sigma, 1e-12)) if np.isfinite(d).all() else -1.0)
    best = int(np.argmax(gains))
    name = list(tried)[best]
    record = series[best].record
    rival = next(n for n in b.names if n not in a.names[1:])
    return Experiment((a.names[0], rival), name, record.time, record.voltage, gains[best])
