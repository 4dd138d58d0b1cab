"""Fit creep slower than the training records to the long record that the nominal model stores.

    r(t) = ( sigma_off + sum_i sigma_i x^(i) - F ) / a_0                 residual of the equation, as a displacement
    minimise   lambda  mean over windows w of  ( 100 mean_{t in w} p(t) r(t) / range )^2
    for p = 1  and  p = 3 (x - mean_w x) / std_w x;     range: of the whole record, since a window may stand still

Along measured motion the memories are known. A window's mean contains only the slow part, for which the equation is as
good as a free run, so no simulation is needed. Resonances outside the training records do not matter, because a window
counts only where the motion stays within the trained region. A mean does not show how the slow memories act at either
end of the stroke; the part of r proportional to x does, below the resonance (docs/decisions/creep.md).
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..fit.parameters import trainable
from ..model.equation import equation_force
from ..model.model import Model
from ..model.programs import jit
from ..signal.long_record import LongRecord
from ..signal.preprocess import cutoff, force_band, preprocess
from ..simulate.decoder import scaled_force

_WEIGHT = 0.1  # lambda, relative to a mean over records of squares of e_rms in %
_ENDS, _BELOW = 3.0, 0.7  # weight of the second moment; fraction of the resonance below which a window's motion must be
_FEWEST_WINDOWS = 10
OUTLASTS = 1.5  # times the longest training run


class _Series(eqx.Module):
    """One measured series: voltage (V), scaled displacement and states, and the weights of both window moments."""

    voltage: Float[Array, " time"]
    x: Float[Array, " time"]
    states: Float[Array, "windows size tokens"]
    weight: Float[Array, "windows moments size"]
    rest: bool
    dt: float
    step: int = eqx.field(static=True)

    def kept(self, along: Float[Array, "time ..."]) -> Float[Array, "windows size ..."]:
        """Return every `step`-th sample of a series, cut into windows, shape (windows, size, ...)."""
        rows = along[:: self.step]
        windows, _, size = self.weight.shape
        return rows[: windows * size].reshape(windows, size, *rows.shape[1:])


@dataclass(frozen=True)
class SlowBalance:
    """The windows of a long record, in the scaled units of one model.

    Attributes:
        series: the measured series.
        scale: per window, factor from a scaled force to 100 x / range; 0 if the window does not count.
        seconds: length of the record, s.
    """

    series: _Series
    scale: Float[np.ndarray, " windows"]
    seconds: float

    def errors(self, model: Model) -> Float[np.ndarray, " rows"]:
        """Compute the residuals of a model, two per window."""
        moments = np.asarray(_moments(model, self.series), np.float64)
        return (self._row_scale[:, None] * moments).ravel()

    def slopes(self, model: Model, count: int) -> Float[np.ndarray, "rows parameters"]:
        """Compute the residuals' derivatives by `count` parameters; by those of effects, which are ignored, zero."""
        slopes = np.asarray(_slopes(model, self.series), np.float64)
        slopes = np.pad(slopes, ((0, 0), (0, 0), (0, count - slopes.shape[-1])))
        return (self._row_scale[:, None, None] * slopes).reshape(-1, count)

    @property
    def _row_scale(self) -> np.ndarray:
        return self.scale * np.sqrt(_WEIGHT / np.count_nonzero(self.scale))  # squared and summed: lambda times a mean

    def features(self, model: Model) -> np.ndarray:
        """Return states and memories of all samples with weight, shape (samples, n + K)."""
        past = _past(model.memory, self.series)
        return np.concatenate([self.series.states[..., :-1], past], -1)[np.asarray(self.series.weight[:, 0]) > 0]


def slow_balance(model: Model, long: LongRecord, region) -> SlowBalance | None:
    """Cut the long record into windows within the trained `region`; None if fewer than ten remain."""
    record = long.record()
    force = np.asarray(model.input_map.force(jnp.asarray(record.voltage)), np.float64)
    motion = preprocess(record, model.order, cutoff(force_band([force], long.dt), long.dt), force,
                        displacement=model.output.to_model(record.displacement))  # fmt: skip
    states, valid = motion.states / model.scales.state, motion.valid[:: long.step]
    low, high = np.asarray(region)[: model.order].T
    # at least six kept samples each, 1.5 periods of the fastest input: a short record has fewer windows
    windows = min(100, len(valid) // 6)
    if windows < _FEWEST_WINDOWS:
        return None
    shape = windows, len(valid) // windows
    count = shape[0] * shape[1]
    rows = states[:: long.step][:count].reshape(*shape, -1)
    inside = valid[:count].reshape(shape) & ((rows[..., :-1] >= low) & (rows[..., :-1] <= high)).all(-1)
    # a window that leaves the region includes motion (a resonance) that training never covered
    inside &= inside.mean(1, keepdims=True) >= 0.9
    used = inside.any(1)
    if used.sum() < _FEWEST_WINDOWS:
        return None
    scale = used * 100 / np.ptp(rows[..., 0]) / float(model.coefficients[0])  # over a_0: a force as a displacement
    mean = inside / np.maximum(inside.sum(1, keepdims=True), 1)
    apart = rows[..., 0] - (mean * rows[..., 0]).sum(1, keepdims=True)
    apart /= np.sqrt(np.maximum((mean * apart**2).sum(1, keepdims=True), 1e-12))  # 0 where a window stands still
    weight = np.stack([mean, _ENDS * mean * apart * _below(model, rows, mean)[:, None]], 1)
    voltage, x, rows, weight = (jnp.asarray(a, jnp.float32) for a in (record.voltage, states[:, 0], rows, weight))
    return SlowBalance(_Series(voltage, x, rows, weight, long.rest, long.dt, long.step), scale, long.seconds)


def _below(model: Model, rows: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Mark windows with motion slower than the resonance; in faster ones inertia matters."""
    swing, speed = (
        np.sqrt(np.maximum((mean * v**2).sum(1) - (mean * v).sum(1) ** 2, 0)) for v in np.moveaxis(rows[..., :2], -1, 0)
    )
    # for a sine, speed = w swing; a mix of frequencies is judged by its fast part, the critical one
    return float(model.scales.rates[0]) * speed < _BELOW * model.natural_frequency * swing


def _past(memory, series: _Series):
    start = memory.initial(jnp.where(series.rest, 0.0, series.x[0]))
    return series.kept(memory.trajectory(series.x, series.dt, start))


def _force(model: Model, drive, series: _Series):
    film = drive.film(series.voltage, series.dt, jnp.asarray(series.rest))
    return series.kept(scaled_force(model, film))


def _balance(model: Model, encoder, past, state):
    """Compute the scaled force that the equation of motion needs at one instant."""
    return equation_force(model, list(encoder(jnp.concatenate([state[:-1], past]))), list(state))[0]


@jit
def _moments(model: Model, series: _Series) -> Float[Array, "windows moments"]:
    """Compute two weighted means of the equation's residual (a scaled force) in every window."""
    along = jax.vmap(jax.vmap(lambda past, state: _balance(model, model.encoder, past, state)))
    residual = along(_past(model.memory, series), series.states) - _force(model, model.drive, series)
    return jnp.einsum("wmt,wt->wm", series.weight, residual)


@jit
def _slopes(model: Model, series: _Series) -> Float[Array, "windows moments parameters"]:
    """Differentiate `_moments` with respect to the parameters of encoder, memory and drive."""
    params, static = eqx.partition(model, trainable(model))
    encoder, build_encoder = ravel_pytree(params.encoder)
    memory, build_memory = ravel_pytree(params.memory)
    drive, build_drive = ravel_pytree(params.drive)

    def past(q):
        return _past(eqx.combine(build_memory(q), static.memory), series)

    def force(r):
        return _force(model, eqx.combine(build_drive(r), static.drive), series)

    def balance(p, past, state):
        return _balance(model, eqx.combine(build_encoder(p), static.encoder), past, state)

    def window(item):
        state, past, past_by, force_by, weight = item
        # one output of many weights: reverse mode, instant by instant
        by_encoder, by_past = jax.vmap(jax.grad(balance, (0, 1)), (None, 0, 0))(encoder, past, state)
        by_memory = jnp.einsum("tk,tkq->tq", by_past, past_by)
        return weight @ jnp.concatenate([by_encoder, by_memory, -force_by], 1)

    # whole series of a few time constants: forward mode
    slopes = jax.jacfwd(past)(memory), jax.jacfwd(force)(drive)
    # window by window, because the encoder's slopes of all samples would not fit the cache
    return jax.lax.map(window, (series.states, past(memory), *slopes, series.weight))
