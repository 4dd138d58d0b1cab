"""Compare the nominal's free runs over whole recordings with its own error, before any search.

    e_r^2 = mean of (run - zero - y)^2 over recording r,    own_r^2 = M^2 + noise_r^2
    ratio = geometric mean over recordings of  max(e_r, own_r) / own_r

M is the nominal's error beyond noise on the recordings that it was made from (`own_misfit`). A quiet recording counts
as its own error, so that it does not hide the gap of another.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..model.fitted import fitted_of
from ..model.model import Model
from ..signal.initial_state import noise_of
from ..signal.record import Record
from .traces import Trace, traces_of

_FAR = 10.0  # ranges: the error assigned to a diverged run


@dataclass(frozen=True)
class OwnError:
    """Free runs of a nominal model beside recordings, with its own error.

    Attributes:
        traces: the runs; both outputs are the nominal's.
        own: the nominal's own error on each recording, its noise included, shape (records,), base unit.
        source: where that comes from, in words.
    """

    traces: tuple[Trace, ...]
    own: np.ndarray
    source: str

    @cached_property
    def residuals(self) -> list[np.ndarray]:
        """Return the errors of every run, nan where nothing was measured (base unit)."""
        return [residual(t.nominal, t) for t in self.traces]

    @property
    def spans(self) -> np.ndarray:
        """Return the measured range of every recording, shape (records,), base unit."""
        return np.array([t.span for t in self.traces])

    def ratio(self, residuals: Sequence[np.ndarray]) -> float:
        """Return errors over the nominal's own, the geometric mean over recordings; at least 1."""
        rms = np.sqrt([np.nanmean(e**2) for e in residuals])
        return geometric_mean(np.maximum(rms, self.own) / self.own)

    def percent(self, rms: np.ndarray) -> float:
        """Pool rms errors of the recordings, in % of their ranges."""
        return 100 * float(np.sqrt(np.mean((rms / self.spans) ** 2)))


def own_error(model: Model, records: Sequence[Record]) -> OwnError:
    """Simulate the nominal beside whole recordings, and look up its own error."""
    lacking, source = own_misfit(model, records)
    own = np.sqrt(lacking**2 + np.maximum(noise_of(records), 1e-300) ** 2)
    return OwnError(traces_of(model, model, records), own, source)


def residual(run: np.ndarray, trace: Trace) -> np.ndarray:
    """Return the error of a simulation: nan where nothing was measured, a large value where it diverged."""
    far = _FAR * trace.span
    error = np.nan_to_num(run - trace.measured, nan=far, posinf=far, neginf=-far)
    return np.where(np.isfinite(trace.measured), np.clip(error, -far, far), np.nan)


def own_misfit(model: Model, records: Sequence[Record]) -> tuple[float, str]:
    """Return the nominal's error beyond noise on the recordings that it was made from (base unit), and its source.

    M^2 = rms^2 - noise_0^2 = (misfit^2 - 1) noise_0^2;  a trained model keeps instead its error in % of range, which
    is applied to these recordings

    M does not grow with the noise of other records: a simulator without noise has a misfit of thousands, and its
    product with the robot's noise would hide any gap.
    """
    origin, noises = fitted_of(model).origin, noise_of(records)
    source = "its error on the recordings it was made from"
    if np.isfinite(origin.misfit):
        noise = origin.noise if origin.noise > 0 else geometric_mean(noises)
        return float(noise * np.sqrt(max(origin.misfit**2 - 1, 0.0))), source
    if np.isfinite(origin.level):
        rms = origin.level / 100 * geometric_mean(np.array([r.span for r in records]))
        return float(np.sqrt(max(rms**2 - geometric_mean(noises) ** 2, 0.0))), source
    return 0.0, "the sensor's noise, because the model file holds no error of its own"


def geometric_mean(values: np.ndarray) -> float:
    """Return the geometric mean of positive values, to which recordings of any size contribute equally."""
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-300)))))
