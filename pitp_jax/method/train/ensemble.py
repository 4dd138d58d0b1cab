"""Estimate the uncertainty of a prediction from models that were trained with different random keys.

    x(t) = mean_k x_k(t),    band = x(t) +- sqrt( t_{K-1}(p)^2 (1 + 1/K) var_k x_k(t) + b(p)^2 )
    b(p) = range Q(p) t_R(p) / z(p)       p: level;  t, z: Student's and the normal quantile of |.|

The spread cannot show an error common to all members, so b is added: Q are the quantiles of the mean's |error| / range
on the R training records. Errors of free runs are not normal: most are small, and a few are large. Student's factor
accounts for the R records behind Q (docs/decisions/training.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from ...common.errors import BadInput
from ...common.shown import Shown
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit
from ..signal.record import Record
from ..signal.sets import check_set
from ..simulate import ports
from ..simulate.decoder import rollout
from ..simulate.prediction import FAR, at_rate, begin

_LEVELS = 201  # quantiles of the errors, every half percent


@dataclass(frozen=True, repr=False)
class Ensemble(Shown):
    """Several models of one structure with different trained parameters, and the error of their mean.

    Attributes:
        models: K models, each usable alone.
        error: rms error of the mean on the training records, over the range of each.
        errors: quantiles of |error| / range on those records, at evenly spaced levels from 0 to 1. Empty: `error` times
            Student's quantile of K - 1 is used.
        records: number R of those records.

    Raises:
        ValueError: fewer than 2 members, or members that differ in their parts, scales or output.
    """

    models: tuple[Model | Fitted, ...]
    error: float
    errors: tuple[float, ...] = ()
    records: int = 1

    @staticmethod
    def calibrated(models: Sequence[Model | Fitted], records: Sequence[Record]) -> "Ensemble":
        """Build an ensemble of trained models, with the error of their mean on these training records."""
        bands = predict_band(Ensemble(tuple(models), 0.0), records)
        errors = [_relative(b, r) for b, r in zip(bands, records, strict=True)]
        # quantiles per record first, so that a long record counts as much as a short one
        pooled = np.concatenate([np.quantile(np.abs(e), np.linspace(0, 1, _LEVELS)) for e in errors])
        quantiles = np.quantile(pooled, np.linspace(0, 1, _LEVELS))
        rms = float(np.sqrt(np.mean([np.mean(e**2) for e in errors])))
        return Ensemble(tuple(models), rms, tuple(quantiles.tolist()), len(records))

    def floor(self, level: float) -> float:
        """Return the error that all members share at this confidence level, divided by the range."""
        quantile = 0.5 + level / 2
        if not self.errors:
            return self.error * float(scipy.stats.t.ppf(quantile, len(self.models) - 1))
        known = float(np.interp(level, np.linspace(0, 1, len(self.errors)), self.errors))
        return known * float(scipy.stats.t.ppf(quantile, self.records) / scipy.stats.norm.ppf(quantile))

    def __post_init__(self):
        """Refuse a single member, and members of different structure."""
        check_members(len(self.models))
        first, *others = (_make(model_of(m)) for m in self.models)
        if any(other != first for other in others):
            raise ValueError("members differ in their parts, scales or output; train them from one nominal model")


@dataclass(frozen=True, repr=False)
class Band(Shown):
    """The prediction of an ensemble for one record: mean, and half the width of the band around it.

    The band reaches from `displacement - half_width` to `displacement + half_width`. It should hold the fraction
    `level` of the samples that `predict_band` was called with.

    Attributes:
        name: of the record.
        displacement, half_width: mean and half the band, rig coordinates (m or V), shape (T,); nan from the sample
            where a member diverged.
        diverged: whether a member diverged.
        scored: samples that count, shape (T,), as for `Prediction`.
    """

    name: str
    displacement: np.ndarray
    half_width: np.ndarray
    diverged: bool
    scored: np.ndarray


def predict_band(ensemble: Ensemble, records: Sequence[Record], *, level: float = 0.95) -> tuple[Band, ...]:
    """Predict mean and uncertainty band of every record, with all members at once.

    Args:
        ensemble: of `train_ensemble`.
        records: of one sampling rate.
        level: fraction of samples that the band should cover.

    Returns:
        mean and half width per record.

    Raises:
        ValueError: a level outside 0 to 1.
        BadInput: not an ensemble, or not a list of records of one sampling rate.

    Examples:
        >>> pitp.predict_band(pitp.Ensemble((model, model), error=0.01), records)[0].half_width.shape
        (2000,)
    """
    if not 0 < level < 1:
        raise ValueError(f"level {level} is not between 0 and 1; give 0.95 to cover 95 %")
    if not isinstance(ensemble, Ensemble):
        raise BadInput(f"a {type(ensemble).__name__} is not an ensemble: give what train_ensemble returns")
    check_set(records)
    models = [at_rate(model_of(m), records[0].dt) for m in ensemble.models]
    finest = max(m.substeps for m in models)  # one program runs all members, with the steps of the one that needs most
    stack = _stacked([replace(m, substeps=finest) for m in models])
    # K members estimate their spread with K - 1 degrees of freedom
    quantile = float(scipy.stats.t.ppf(0.5 + level / 2, len(models) - 1))
    bands = []
    for r in records:
        first, spent, begun = zip(*[begin(m, [r]) for m in models], strict=True)
        states = _run(stack, jnp.asarray(r.voltage, first[0].dtype), r.dt, jnp.concatenate(first))
        x = np.asarray(states, np.float64)
        # the band ends where a member diverges, because a mean over fewer members would jump
        lost = np.logical_or.accumulate(~(np.isfinite(x) & (np.abs(x) < FAR)).all(0))
        # each member's own offset and direction of this record, as in its own prediction
        turned, zeros = (np.array([[getattr(b, n)] for (b,) in begun]) for n in ("direction", "zero"))
        x = turned * np.where(lost, np.nan, x) * models[0].scales.state[0] + zeros
        spread = quantile * np.sqrt(1 + 1 / len(x)) * x.std(0, ddof=1)  # 1 / K: the mean itself is uncertain
        half = np.hypot(spread, ensemble.floor(level) * r.span)
        scored = np.arange(r.samples) >= spent[0][0]
        bands.append(Band(r.name, x.mean(0), half, bool(lost.any()), scored))
    return tuple(bands)


def check_members(members: int) -> None:
    """Refuse fewer than two members, which have no spread."""
    if members < 2:
        raise ValueError(f"an ensemble needs at least 2 members, not {members}")


def _stacked(models: Sequence[Model]) -> Model:
    """Stack several models into one, whose arrays have a leading axis for the models."""
    # a user's own encoder may hold functions, which are the same in all
    return jax.tree.map(lambda *leaves: leaves[0] if callable(leaves[0]) else jnp.stack(leaves), *models)


def _make(model: Model) -> tuple:
    """Return the properties that all members must share: structure, shapes and scales."""
    shapes, structure = jax.tree.flatten(jax.tree.map(lambda a: a if callable(a) else jnp.shape(a), model))
    return structure, shapes, [np.asarray(a).tolist() for a in jax.tree.leaves(model.scales)]


@jit
def _run(stack: Model, voltage, dt: float, start):
    return eqx.filter_vmap(lambda m, s: ports.readings(m, rollout(m, voltage, dt, s)))(stack, start)


def _relative(band: Band, record: Record) -> Float[np.ndarray, " counted"]:
    """Return the error of the ensemble's mean, divided by the record's range, at the samples that count."""
    keep = band.scored & record.observed
    return (band.displacement - record.displacement)[keep] / record.span
