"""Estimate a trained model's expected held-out error by a Laplace approximation about its trained parameters.

    p | records ~ N(p^, s^2 (sum_r T_r M_r + rho sum_r T_r)^-1)       M_r: mean over time of J'J, errors in % of range
    s^2 = e^2 tau,   e: residual on its own records, %,   tau = dt sum_k c_k^2: Bartlett's time between
    independent samples of errors with autocorrelation c_k

rho: the prior of `refine`, which weights a record by its mean like M_r; T_r: seconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ...common.errors import BadInput
from ...common.metrics import rms
from ...method.fit.forward_sensitivity import Runs, run_slopes
from ...method.fit.parameters import parameters
from ...method.model.model import Model
from ...method.signal.initial_state import noise_of
from ...method.signal.record import Record
from ...method.signal.sets import alike
from ...method.simulate.beginnings import settled_states
from ...method.simulate.decoder import rest_state
from ...method.simulate.model_runs import model_runs, padded
from ...method.simulate.prediction import FAR, at_rate, predicted_pairs
from ...method.train.refine import prior_weights, thinning
from ...method.train.settings import Settings, firmness_of


def information(model: Model, voltages: Sequence[np.ndarray], dt: float, floor: float = 0.0) -> list[np.ndarray]:
    """Return the information of simulated motions on the model's parameters, (P, P) each; 0 if diverged or motionless.

    Args:
        model: with P trained parameters.
        voltages: V, from rest, or settled at the first value if there is an equilibrium.
        dt: sampling interval, s.
        floor: errors are in % of sqrt(range^2 + floor^2), m, because the noise does not shrink with the motion.
    """
    model, places = at_rate(model, dt), alike(voltages, len)
    found = [m for some in places for m in _together(model, [voltages[k] for k in some], dt, floor)]
    return [found[k] for k in np.argsort(np.concatenate(places))]


def _together(model: Model, voltages: Sequence[np.ndarray], dt: float, floor: float) -> list[np.ndarray]:
    """Compute `information` for voltages of similar length, padded to one length."""
    every, scale = thinning(model, dt), float(model.scales.state[0])
    drive = padded(voltages).astype(np.float32)
    inside = np.less(np.arange(drive.shape[1]), np.array([len(u) for u in voltages])[:, None])
    held = settled_states(model, drive[:, 0], dt, np.zeros(len(drive)))
    settled = (drive[:, :1] != 0) & np.isfinite(held).all(1, keepdims=True)
    start = np.where(settled, held, np.asarray(rest_state(model)))
    x = model_runs(model, drive, dt, start)[1]
    finite = np.all(np.isfinite(x) & (np.abs(x) < FAR) | ~inside, axis=1)
    # diverged and padded samples carry no information, and must not bring nan into the sums
    x = np.where(inside & finite[:, None], x, 0.0)
    span = np.ptp(np.where(inside, x, x[:, :1]), axis=1)
    tells = finite & (span > 1e-3 * span.max())  # a run that moves less carries no information
    # infinite, so that a diverged run has weight zero instead of nan
    against = np.where(tells, np.hypot(span, floor / scale), np.inf)
    # 1e4: squares of errors in percent of the range
    weight = inside * (1e4 / inside.sum(1) / against**2)[:, None]
    found = []
    for part, at, w in _batches(drive, start, weight.astype(np.float32)):
        runs = Runs(jnp.asarray(at, jnp.float32), jnp.asarray(part), jnp.zeros_like(w), jnp.asarray(w))
        rows = np.asarray(run_slopes(model, runs, dt, every), np.float64)
        found += [r.T @ r if np.isfinite(r).all() else np.zeros((r.shape[1],) * 2) for r in rows]
    return found[: len(voltages)]


def _batches(*arrays):
    """Yield arrays in batches of equal size, padded with copies of the last row, for one compiled program."""
    count, size = len(arrays[0]), 8  # the slopes of a run are (errors, parameters) each
    for first in range(0, count, size):
        part = np.minimum(np.arange(first, first + size), count - 1)
        yield tuple(a[part] for a in arrays)


@dataclass(frozen=True)
class Knowledge:
    """The information of the training records on a model: precision of the parameters, residual, noise floor.

    Attributes:
        precision: of the trained parameters, per unit of s^2, shape (P, P).
        unit: s^2 in %^2 s.
        error: residual of the model on its own records, % of range.
        floor: the range (m) of a motion for which noise alone gives that error.
    """

    precision: np.ndarray
    unit: float
    error: float
    floor: float


def knowledge(model: Model, records: Sequence[Record]) -> Knowledge:
    """Compute what the training records determine about the model's parameters.

    Raises:
        BadInput: a model without trained parameters, or one that diverges on every record.
    """
    start, sizes = parameters(model)
    if not len(start):
        raise BadInput("the model has no trained parameters; give a model that `pitp fit` wrote")
    dt = records[0].dt
    # a diverged run shows that the model fails there, but not by how much
    misses = [_miss(r, p) for r, p in predicted_pairs(model, records) if not p.diverged]
    if not misses:
        raise BadInput(
            "the model diverges on every recording; check that they are from this actuator, or train the model again"
        )
    errors, taus = np.array(misses).T
    error = rms(errors)
    # an input that hardly moves the actuator gives only noise, even if the model predicts it well
    floor = 100 * float(np.median(noise_of(records))) / error
    played = information(model, [r.voltage for r in records], dt, floor)
    seconds = np.array([r.samples * dt for r in records])
    rho = prior_weights(model, sizes, firmness_of(Settings(), model, len(records)))
    precision = sum(t * m for t, m in zip(seconds, played, strict=True)) + seconds.sum() * np.diag(rho)
    return Knowledge(precision, error**2 * float(taus.mean()), error, floor)


def _miss(record: Record, prediction) -> tuple[float, float]:
    """Return the rms error of a prediction, % of range, and the time between independent errors, s (Bartlett)."""
    seen = record.observed & prediction.scored
    e = np.where(seen, prediction.displacement - record.displacement, 0.0)
    e = e - seen * e[seen].mean()
    power = np.abs(np.fft.rfft(e, 2 * len(e))) ** 2  # twice the length: no correlation of the end with the start
    c = np.fft.irfft(power)[: len(e)]
    tau = record.dt * (2 * float(np.sum((c / c[0]) ** 2)) - 1) if c[0] > 0 else record.dt
    return 100 * rms(e[seen]) / float(np.ptp(record.displacement[seen])), tau
