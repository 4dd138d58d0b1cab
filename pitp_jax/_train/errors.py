"""Errors of free runs on the training records: the trained model beside its nominal, as `predict` runs both.

    e_k = 100 rms(x - x_measured) / range_k,      a record is worse where e_k(trained) > 1.01 e_k(nominal)

The better of two models is worse on fewer records, then has the smaller rms of e_k.
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
_MOST = 1e6  # %; what a diverged run counts
_LITTLE = 1.0  # %; a mean error below that is no failure,
_CLOSED = 0.5  # nor one of at most that share of the nominal's


@dataclass(frozen=True)
class RecordError:
    """Error of one training record under the nominal and under the trained model, e_rms in % (infinite: diverged)."""

    name: str
    nominal: float
    trained: float

    @property
    def worse(self) -> bool:
        """Whether training lost on this record."""
        return not self.trained <= _ALIKE * self.nominal


def errors(model: Model | Fitted, records: Sequence[Record]) -> Float[np.ndarray, " records"]:
    """e_rms of the free run of every record, %; infinite where it diverged, 0 where nothing can be counted."""
    runs = predict(model, records)
    found = [e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in zip(runs, records, strict=True)]
    return np.nan_to_num(np.array(found), nan=0.0, posinf=np.inf)


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
        """By how much every record is worse than under the nominal; at most 1: it is not."""
        return np.minimum(self.trained, _MOST) / np.clip(self.nominal, 1e-12, _MOST)

    @property
    def rank(self) -> tuple[int, float]:
        """The smaller the better."""
        return int((self.worse > _ALIKE).sum()), self.mean

    @property
    def converged(self) -> bool:
        """No record is worse than under the nominal; the error beyond noise is small, or beside the nominal's."""
        return self.rank[0] == 0 and self._small

    @property
    def nearly(self) -> bool:
        """The mean error is small, but some record is worse than under the nominal."""
        return self.rank[0] > 0 and self._small

    @property
    def _small(self) -> bool:
        left, before = (_mean(np.sqrt(np.maximum(e**2 - self.noise**2, 0))) for e in (self.trained, self.nominal))
        return left <= max(_LITTLE, _CLOSED * before)

    @property
    def errors(self) -> tuple[RecordError, ...]:
        """One for every record."""
        return tuple(
            RecordError(n, *e) for n, *e in zip(self.names, self.nominal.tolist(), self.trained.tolist(), strict=True)
        )


@dataclass(frozen=True)
class Judge:
    """fn(model): how it does on these records beside the nominal."""

    records: Sequence[Record]
    nominal: Float[np.ndarray, " records"]
    noise: Float[np.ndarray, " records"]

    def __call__(self, model: Model) -> Candidate:
        """Free runs of all records."""
        names, found = tuple(r.name for r in self.records), errors(model, self.records)
        return Candidate(model, names, self.nominal, found, self.noise)


def judge(nominal: Model | Fitted, records: Sequence[Record]) -> Judge:
    """The judge of models trained from this nominal on these records."""
    noise = [100 * noise_std(r.displacement) / max(float(np.ptp(r.displacement[r.observed])), 1e-30) for r in records]
    return Judge(records, errors(nominal, records), np.array(noise))


def kept(
    best: Candidate, judged: Judge, between: Callable[[Model], Iterable[Model]]
) -> tuple[Candidate, list[str], str | None]:
    """The candidate to hand back, worse on no record; lines that say what failed; what stands in for `best`, or None.

    `between`: models from this one towards the nominal, which comes last.
    """
    chosen = best
    if best.rank[0]:
        tried = [judged(m) for m in between(best.model)]
        good = [c for c in tried[:-1] if c.rank[0] == 0]
        chosen = min(good, key=lambda c: c.mean) if good else tried[-1]
        lost = ", ".join(
            f"{e.name} ({e.trained:.3g} % of range instead of {e.nominal:.3g})" for e in best.errors if e.worse
        )
        what = "a model between it and the nominal" if good else "the nominal itself"
        return chosen, [f"training failed: the best start is worse than the nominal on {lost}; {what} is handed back; "
                        "look at these records with `pitp check`, or leave them out"], what  # fmt: skip
    if not chosen.converged:
        left = f"{chosen.mean:.3g} % of range is left on average, {_mean(chosen.nominal):.3g} % by the nominal"
        return chosen, [f"not converged: {left}; `pitp diagnose` looks for what this model lacks"], None
    return chosen, [], None


def _mean(errors) -> float:
    return float(np.sqrt(np.mean(np.minimum(errors, _MOST) ** 2)))
