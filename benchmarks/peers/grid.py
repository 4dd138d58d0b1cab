"""A common coarse grid for the black boxes: every s-th sample, inputs and outputs of order one.

    s = f_sample / (25 f_top),    inputs_k = (u_k, u_k^2, u_{k+1}, u_{k+1}^2) scaled,    x_k = output_k / scale

The step from k to k + 1 sees the voltage at both its ends (piecewise linear in between), so nothing is delayed by
the grid. The output is low-passed without phase before it is thinned; a prediction returns by cubic interpolation.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import decimate


@dataclass(frozen=True)
class Grid:
    """Stride, step (s), scales (V, m) and the sensor's zero and direction."""

    stride: int
    dt: float
    volts: float
    metres: float
    output: object

    def voltage(self, record) -> np.ndarray:
        """Scaled voltage at the coarse samples, the last one at or behind the record's end, shape (K,)."""
        spare = -(record.samples - 1) % self.stride
        return np.pad(record.voltage, (0, spare), mode="edge")[:: self.stride] / self.volts

    def inputs(self, record) -> np.ndarray:
        """(u_k, u_k^2, u_{k+1}, u_{k+1}^2) of every step, shape (K - 1, 4), float32."""
        u = self.voltage(record)
        return np.stack([u[:-1], u[:-1] ** 2, u[1:], u[1:] ** 2], -1).astype(np.float32)

    def target(self, record) -> np.ndarray:
        """Scaled displacement at the coarse samples of whole steps, shape (K,)."""
        x = self.output.to_model(filled(record)) / self.metres
        thinned = decimate(x, self.stride, zero_phase=True) if self.stride > 1 else x
        return np.pad(thinned, (0, len(self.voltage(record)) - len(thinned)), mode="edge")

    def restore(self, record, x: np.ndarray) -> np.ndarray:
        """Scaled coarse displacement to the record's own samples and the rig's coordinates; nan if it diverged."""
        if not np.all(np.isfinite(x)):
            return np.full(record.samples, np.nan)
        spline = CubicSpline(self.stride * np.arange(len(x)), np.asarray(x, np.float64))
        return self.output.to_rig(self.metres * spline(np.arange(record.samples)))


def filled(record) -> np.ndarray:
    """Displacement with missing samples interpolated."""
    seen, index = record.observed, np.arange(record.samples)
    return np.interp(index, index[seen], record.displacement[seen])


def top_frequency(records) -> float:
    """Highest fundamental among the records' voltages, Hz."""
    spectra = [np.abs(np.fft.rfft(r.voltage - r.voltage.mean())) for r in records]
    return max(float(np.argmax(s)) / (r.samples * r.dt) for s, r in zip(spectra, records, strict=True))


def make_grid(nominal, records, per_period: float = 25.0) -> Grid:
    """A grid of `per_period` samples in the fastest record's period."""
    rate = 1 / records[0].dt
    stride = max(1, round(rate / (per_period * top_frequency(records))))
    volts = max(float(np.max(r.voltage)) for r in records)
    metres = max(float(np.ptp(filled(r))) for r in records)
    return Grid(stride, stride * records[0].dt, volts, metres, nominal.output)


def batch(grid: Grid, records) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs (R, K - 1, 4), targets (R, K) and loss weights 1 / range (R,), cut to the shortest record."""
    inputs, targets = [grid.inputs(r) for r in records], [grid.target(r) for r in records]
    size = min(len(i) for i in inputs)
    targets = np.stack([t[: size + 1] for t in targets])
    weights = 1 / np.ptp(targets, axis=1)
    return np.stack([i[:size] for i in inputs]), targets.astype(np.float32), weights.astype(np.float32)
