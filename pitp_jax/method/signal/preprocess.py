"""Filter and differentiate a record by eqs. 8 and 9 of the paper, as interpreted in docs/readings.md.

    f_max = frequency below which 99 % of the force's energy about its mean lies (pooled over the records)
    f_c   = min(2 f_max, 0.4 f_s)
    H(z)  = Butterworth of order 4, run forward and backward: zero phase, gain |H|^2, -6 dB at f_c   (eq. 9)
    x^(0) = H x,   x^(i) = d x^(i-1),   F = H f   (eq. 8)

Filter and difference commute, so x, every derivative and the force are filtered alike: an equation sum y_i x^(i) = F
that holds before holds after. (The paper's wording, filtering once more after each difference, would filter x^(n) n + 1
times and F never.) Filters run on contiguous stretches of observed samples. Near the ends of a stretch the filter has
not settled; those samples are marked and excluded from the loss.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ...common.errors import BadInput
from .derivative import DIFFERENCES, MIN_LENGTH
from .record import Record

ENERGY_FRACTION = 0.99  # of the force, below the frequency that sets the cut-off
BUTTERWORTH_ORDER = 4  # of one pass; the filter runs forwards and backwards
# Samples within 12 / (2 pi f_c) of an end are left out. For motion that fills the band, the rest is within
# 1 % of the RMS of x''' (0.02 % of x); a sine far below f_c keeps some per cent of its small x'''.
SETTLING = 12.0


@dataclass(frozen=True)
class StateRecord:
    """A record with its motion states: displacement and time derivatives, ready for the training loss.

    Attributes:
        name: of the record.
        time: sample times in s, shape (T,).
        force: filtered force (u^2 or u) in its given unit, shape (T,).
        states: [x, x', ..., x^(n)] in m / s^i (or V / s^i), shape (T, n + 1); finite everywhere: where
            nothing was filtered, x is interpolated linearly and the derivatives are zero.
        valid: True where a sample may enter the loss, shape (T,).
        cutoff_hz: filter cut-off in Hz.
        dt: sampling interval in s.
    """

    name: str
    time: np.ndarray
    force: np.ndarray
    states: np.ndarray
    valid: np.ndarray
    cutoff_hz: float
    dt: float


def force_band(forces: Sequence[np.ndarray], dt: float, share: float = ENERGY_FRACTION) -> float:
    """Return the frequency (Hz) below which a fraction of the input's energy lies, pooled over records, without means.

    Args:
        forces: one array per record, shapes (T_r,); each is taken about its own mean.
        dt: sampling interval in s.
        share: fraction of the energy.

    Raises:
        BadInput: no force ever changes.
    """
    frequencies, energies = [], []
    for force in forces:
        force = np.asarray(force, dtype=np.float64)
        # by length, so that the records pool by their energy (Parseval)
        energy = np.abs(np.asarray(scipy.fft.rfft(force - force.mean()))) ** 2 / len(force)
        energy[1 : (len(force) + 1) // 2] *= 2.0  # both signs of the frequency
        energy[0] = 0.0
        frequencies.append(scipy.fft.rfftfreq(len(force), dt))
        energies.append(energy)
    frequency, energy = np.concatenate(frequencies), np.concatenate(energies)
    scale = sum(float(np.sum(np.square(force, dtype=np.float64))) for force in forces)
    # rounding of a constant force leaves some energy
    if not energy.sum() > 1e-20 * scale:
        raise BadInput("the input never changes in these recordings; give recordings with an excitation")
    # records of other lengths have other frequencies: merged, then summed
    order = np.argsort(frequency, kind="stable")
    total = np.cumsum(energy[order])
    return float(frequency[order][np.searchsorted(total, share * total[-1])])


def cutoff(f_max: float, dt: float) -> float:
    """Return the cut-off frequency of the filter, min(2 f_max, 0.4 f_s), Hz.

    Args:
        f_max: from `force_band`, in Hz.
        dt: sampling interval in s.
    """
    return min(2.0 * f_max, 0.4 / dt)


def edge_samples(cutoff_hz: float, dt: float, order: int) -> int:
    """Return how many samples at each end of a stretch the filter and the differences distort.

    Args:
        cutoff_hz: filter cut-off in Hz.
        dt: sampling interval in s.
        order: highest derivative wanted.
    """
    return max(int(np.ceil(SETTLING / (2 * np.pi * cutoff_hz * dt))), 4 * order)


def preprocess(
    record: Record,
    order: int,
    cutoff_hz: float,
    force: np.ndarray,
    displacement: np.ndarray | None = None,
    difference: str = "stencil",
) -> StateRecord:
    """Filter a record and differentiate its output `order` times.

    Args:
        record: the measured record.
        order: n, the highest derivative.
        cutoff_hz: filter cut-off in Hz, from `cutoff`.
        force: input of the equation (u^2 or u), shape (T,).
        displacement: output already corrected for offset and polarity, shape (T,); None for the record's own.
        difference: `stencil` (8th order) or `central` (eq. 8).

    Returns:
        the states; `valid` is all False if no stretch of observed samples is longer than the filter's settling.
    """
    displacement = record.displacement if displacement is None else np.asarray(displacement, dtype=np.float64)
    force = np.asarray(force, dtype=np.float64)
    dt = record.dt
    # second-order sections, because polynomials of a low cut-off lose all their digits
    sos = np.asarray(scipy.signal.butter(BUTTERWORTH_ORDER, 2.0 * cutoff_hz * dt, output="sos"))
    edge = edge_samples(cutoff_hz, dt, order)
    states = np.zeros((record.samples, order + 1))
    known = np.zeros(record.samples, dtype=bool)
    valid = np.zeros(record.samples, dtype=bool)
    for start, stop in stretches(np.isfinite(displacement)):
        if stop - start <= max(2 * edge, MIN_LENGTH):
            continue
        values = _filtered(sos, displacement[start:stop], edge)
        for i in range(order + 1):
            states[start:stop, i] = values
            # eq. 8: each derivative from the one below it
            values = DIFFERENCES[difference](values, dt) if i < order else values
        known[start:stop] = True
        valid[start + edge : stop - edge] = True
    x = np.where(known, states[:, 0], displacement)
    usable = known if known.any() else np.isfinite(displacement)
    # memories follow x across gaps, although the loss ignores them
    states[:, 0] = np.interp(record.time, record.time[usable], x[usable])
    return StateRecord(record.name, record.time, _filtered(sos, force, edge), states, valid, float(cutoff_hz), dt)


def _filtered(sos: np.ndarray, values: np.ndarray, edge: int) -> np.ndarray:
    """Filter values without phase shift; both ends are extended by an odd reflection."""
    return scipy.signal.sosfiltfilt(sos, values, padlen=min(2 * edge, len(values) - 1))


def stretches(observed: np.ndarray) -> list[tuple[int, int]]:
    """Return the contiguous stretches of True as (start, stop) indices, stop excluded.

    Args:
        observed: shape (T,).
    """
    return [(run.start, run.stop) for (run,) in scipy.ndimage.find_objects(scipy.ndimage.label(observed)[0])]
