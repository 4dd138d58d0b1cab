"""Compute for each recording the signal that, added to the simulator's input, reproduces the robot's output.

    f_{k+1} = f_k + G+ (y - y_sim(F + f_k)),    G+ = conj(G) / (|G|^2 + eps |G(0)|^2),    G(s) = e^{-s T} / sum a_i s^i

Iterative learning on whole recordings: G is the linear part of the simulator's model, y_sim its free run with all its
effects. `eps` = 0.01 bounds the noise that passes: almost nothing is corrected above the frequency where |G| is a tenth
of its static value.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...method.model.fitted import Fitted
from ...method.model.model import Model
from ...method.signal.record import Record
from ...method.simulate.prediction import predict


def corrections(nominal: Model | Fitted, records: Sequence[Record]) -> list[np.ndarray]:
    """Return for each recording the signal to add to the simulator's input (base unit), shape (T,).

    Args:
        nominal: the simulator's model.
        records: the robot's recordings.
    """
    forces = [np.zeros(r.samples) for r in records]
    for _ in range(5):
        played = [replace(r, voltage=_input(nominal, r.voltage, f)) for r, f in zip(records, forces, strict=True)]
        for k, run in enumerate(predict(nominal, played)):
            error = run.direction * (records[k].displacement - run.displacement)
            forces[k] = forces[k] + _regularised_inverse(nominal, replace(records[k], displacement=error))
    return [_input(nominal, r.voltage, f) - r.voltage for r, f in zip(records, forces, strict=True)]


def _input(model: Model | Fitted, voltage: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Add a force in input units (V^2, or V for a linear input) to a voltage; return the resulting voltage."""
    if model.input_map.name == "linear":
        return voltage + force
    return np.where(voltage < 0, -1.0, 1.0) * np.sqrt(np.maximum(voltage**2 + force, 0.0))


def _regularised_inverse(model: Model | Fitted, error: Record) -> np.ndarray:
    """Return the input (V^2, or V if linear) that causes an error signal, by a regularised inverse in frequency."""
    a = model.physical_coefficients
    mirrored = np.concatenate([error.filled, error.filled[::-1]])
    s = 2j * np.pi * np.fft.rfftfreq(len(mirrored), error.dt)
    late = sum(float(v) for e in model.effects if e.name == "delay" for p, v in e.numbers() if p.name == "time")
    gain = np.exp(-s * late) / np.polyval(a[::-1], s)
    inverse = np.conj(gain) / (np.abs(gain) ** 2 + 0.01 / a[0] ** 2)
    return np.fft.irfft(np.fft.rfft(mirrored) * inverse, len(mirrored))[: error.samples]
