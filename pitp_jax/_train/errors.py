"""Compare free runs on the training records: the trained model beside its nominal, as `predict` runs both.

    e_k = 100 rms(x - x_measured) / range_k,      s_k = 100 (standard deviation of the sensor's noise) / range_k
    a record is worse where    e_k(trained)^2 > (1.01 e_k(nominal))^2 + s_k^2

Both errors contain the noise, so the difference of their squares is what the trained model adds. An addition below the
noise does not reject a model whose mean error is smaller. The better of two models is worse on fewer records, then has
the smaller rms of e_k; a model that is worse on none but has the larger mean counts as worse on one.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .._metrics import e_rms_percent
from .._model.fitted import Fitted
from .._model.model import Model
from .._record.initial_state import noise_std
from .._record.record import Record
from .._simulate.prediction import predict

_ALIKE = 1.01  # e_k(trained) / e_k(nominal) up to which a record is not worse: what noise alone makes of a fit
_DIVERGED = 1e6  # %; what a diverged run counts: means and ratios stay numbers
_LITTLE = 1.0  # %; a mean error below that is no failure,
_CLOSED = 0.5  # nor one of at most that fraction of the nominal's


@dataclass(frozen=True)
class RecordError:
    """Error of one training record under the nominal and under the trained model, and the sensor's noise.

    All are e_rms in % of the record's range (infinite: diverged).
    """

    name: str
    nominal: float
    trained: float
    noise: float = 0.0

    @property
    def worse(self) -> bool:
        """Return whether training lost on this record."""
        # not <=, rather than >: infinite beside infinite is not a loss, an error that is not a number is one
        return not self.trained <= _allowed(self.nominal, self.noise)


def errors(model: Model | Fitted, records: Sequence[Record]) -> Float[np.ndarray, " records"]:
    """Compute e_rms of the free run of every record, %; infinite where it diverged, 0 where nothing can be counted."""
    runs = predict(model, records)
    values = [e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in zip(runs, records, strict=True)]
    return np.nan_to_num(np.array(values), nan=0.0, posinf=np.inf)


@dataclass(frozen=True)
class Candidate:
    """A model that training could hand back; errors of the nominal, its own, and the sensor's noise, % of range."""

    model: Model
    names: tuple[str, ...]
    nominal: Float[np.ndarray, " records"]
    trained: Float[np.ndarray, " records"]
    noise: Float[np.ndarray, " records"]

    @property
    def mean(self) -> float:
        """Root of the mean square over records, %."""
        return _mean(self.trained)

    @property
    def worse(self) -> Float[np.ndarray, " records"]:
        """Return the error over the largest one that is not worse, shape (records,)."""
        return np.minimum(self.trained, _DIVERGED) / np.clip(_allowed(self.nominal, self.noise), 1e-12, _DIVERGED)

    @property
    def rank(self) -> tuple[int, float]:
        """Number of records that are worse, then the mean error: the smaller the better."""
        worse = int((self.worse > 1).sum())
        return worse or int(self.mean > _ALIKE * _mean(self.nominal)), self.mean

    @property
    def converged(self) -> bool:
        """Whether no record is worse than under the nominal, and the error beyond noise is small or half closed."""
        return self.rank[0] == 0 and self._small

    @property
    def nearly(self) -> bool:
        """Whether the mean error is small, but some record is worse than under the nominal."""
        return self.rank[0] > 0 and self._small

    @property
    def _small(self) -> bool:
        # without the noise, which no model can close: a noisy set would else never count as converged
        after, before = (_mean(np.sqrt(np.maximum(e**2 - self.noise**2, 0))) for e in (self.trained, self.nominal))
        return after <= max(_LITTLE, _CLOSED * before)

    @property
    def errors(self) -> tuple[RecordError, ...]:
        """Both errors of every record."""
        columns = (self.nominal.tolist(), self.trained.tolist(), self.noise.tolist())
        return tuple(RecordError(n, *e) for n, *e in zip(self.names, *columns, strict=True))


@dataclass(frozen=True)
class Judge:
    """fn(model): a candidate, from its free runs on these records beside the nominal's."""

    records: Sequence[Record]
    nominal: Float[np.ndarray, " records"]
    noise: Float[np.ndarray, " records"]

    def __call__(self, model: Model) -> Candidate:
        """Run the model freely on all records."""
        names = tuple(r.name for r in self.records)
        return Candidate(model, names, self.nominal, errors(model, self.records), self.noise)


def judge(nominal: Model | Fitted, records: Sequence[Record]) -> Judge:
    """Build the judge of models trained from this nominal on these records."""
    noise = [100 * noise_std(r.displacement) / max(r.span, 1e-30) for r in records]
    return Judge(records, errors(nominal, records), np.array(noise))


def kept(
    best: Candidate, compare: Judge, between: Callable[[Model], Iterable[Model]]
) -> tuple[Candidate, list[str], str | None]:
    """Choose what to hand back, worse on no record; lines that say what failed; what stands in for `best`, or None.

    `between`: models from this one towards the nominal, which comes last.
    """
    chosen = best
    if best.rank[0]:
        tried = [compare(m) for m in between(best.model)]
        # the nominal, last, is worse than itself nowhere: there is always something to hand back
        good = [c for c in tried[:-1] if c.rank[0] == 0]
        chosen = min(good, key=lambda c: c.mean) if good else tried[-1]
        lost = ", ".join(
            f"{e.name} ({e.trained:.3g} % of range instead of {e.nominal:.3g})" for e in best.errors if e.worse
        )
        lost = lost or f"average ({best.mean:.3g} % of range instead of {_mean(best.nominal):.3g})"
        what = "a model between it and the nominal" if good else "the nominal itself"
        return chosen, [f"training failed: the best start is worse than the nominal on {lost}; {what} is handed back; "
                        "look at these records with `pitp check`, or leave them out"], what  # fmt: skip
    if not chosen.converged:
        both = f"{chosen.mean:.3g} % of range is left on average, {_mean(chosen.nominal):.3g} % by the nominal"
        return chosen, [f"not converged: {both}; `pitp diagnose` looks for what this model lacks"], None
    return chosen, [], None


def _allowed(nominal, noise):
    """Return the largest error that is not worse than the nominal's, in the shape of both."""
    return np.hypot(_ALIKE * np.asarray(nominal), noise)


def _mean(errors) -> float:
    return float(np.sqrt(np.mean(np.minimum(errors, _DIVERGED) ** 2)))
