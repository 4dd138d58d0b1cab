"""Compare the trained model with the nominal one by their simulation errors on the training records.

    e_k = 100 rms(x - x_measured) / range_k,      s_k = 100 (standard deviation of the sensor's noise) / range_k
    a record is worse where    e_k(trained)^2 > (1.01 e_k(nominal))^2 + s_k^2

Both errors contain the noise, so the difference of their squares is the error that training added. A worse record is
named, and decides nothing: the better of two models has the better pooled log score, mean ln e_k, of all samples and
of blocks held out of its fit (the worse of both scores counts). No error counts below the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...common.metrics import e_rms_percent, rms
from ..fit.sensor_offset import with_offset
from ..model.expected_error import error_table
from ..model.fitted import Fitted, fitted_of
from ..model.model import Hold, Model
from ..signal.excited import Table
from ..signal.initial_state import noise_std
from ..signal.record import Record
from ..simulate.prediction import Prediction, predicted_pairs

_ALIKE = 1.01  # e_k(trained) / e_k(nominal) up to which a record is not worse: the effect of noise on a fit
_DIVERGED = 1e6  # %; the value of a diverged run, so that means and ratios stay finite


@dataclass(frozen=True)
class RecordError:
    """The errors of one training record with the nominal and the trained model, and the sensor's noise.

    All are e_rms in % of the record's range (infinite: diverged).
    """

    name: str
    nominal: float
    trained: float
    noise: float = 0.0

    @property
    def worse(self) -> bool:
        """Return whether training increased the error of this record beyond the effect of noise."""
        # not <= instead of >: two infinite errors are not a loss, nan is one
        return not self.trained <= np.hypot(_ALIKE * self.nominal, self.noise)


@dataclass(frozen=True)
class Score:
    """The error of one simulated record: e_rms in % of range, and by frequency and amplitude (`error_table`)."""

    percent: float
    cells: Table


def errors(model: Model | Fitted, records: Sequence[Record]) -> Float[np.ndarray, " records"]:
    """Compute e_rms (%) of the simulation of every record; infinite if it diverges, 0 if nothing can be scored."""
    return np.array([percent_of(p, r) for r, p in predicted_pairs(model, records)])


def scores(model: Model | Fitted, records: Sequence[Record]) -> list[Score]:
    """Simulate every record, and return its errors; the cells are empty if it diverges."""
    results = []
    for r, p in predicted_pairs(model, records):
        error = np.where(p.scored, p.displacement - r.displacement, np.nan)
        cells = () if p.diverged else error_table([p.displacement], [error], r.dt)
        results.append(Score(percent_of(p, r), cells))
    return results


def percent_of(run: Prediction, record: Record) -> float:
    """Return e_rms (%) of one simulated record; infinite if it diverged, 0 if nothing can be scored."""
    value = e_rms_percent(run.displacement, record.displacement, run.scored)
    return float(np.nan_to_num(value, nan=0.0, posinf=np.inf))


@dataclass(frozen=True)
class Candidate:
    """A possible result of training: its errors, those of the nominal model, and the sensor's noise, % of range.

    `held_out`: the gain on blocks held out of a fit; infinite where there was none.
    """

    model: Model
    names: tuple[str, ...]
    nominal: Float[np.ndarray, " records"]
    trained: Float[np.ndarray, " records"]
    noise: Float[np.ndarray, " records"]
    held_out: float = np.inf

    @property
    def mean(self) -> float:
        """Return the rms over records of the trained model's errors, % of range."""
        return _mean(self.trained)

    @property
    def converged(self) -> bool:
        """Return whether training succeeded: it is better than the nominal, and the error is at most 1 % or halved."""
        # without noise, which no model can reduce; otherwise a noisy set would never count as converged
        after, before = (_mean(np.sqrt(np.maximum(e**2 - self.noise**2, 0))) for e in (self.trained, self.nominal))
        return self.gain >= 0 and after <= max(1.0, before / 2)

    @property
    def gain(self) -> float:
        """Return the pooled log score over the nominal's: the lower one of all samples and of held-out blocks.

        It is the mean log ratio of errors, none below the noise.
        """
        before, after = (np.clip(np.maximum(e, self.noise), 1e-12, _DIVERGED) for e in (self.nominal, self.trained))
        return min(float(np.mean(np.log(before / after))), self.held_out)

    @property
    def errors(self) -> tuple[RecordError, ...]:
        """Return the errors of both models on every record."""
        columns = (self.nominal.tolist(), self.trained.tolist(), self.noise.tolist())
        return tuple(RecordError(n, *e) for n, *e in zip(self.names, *columns, strict=True))


@dataclass(frozen=True)
class Judge:
    """A function that compares a model with the nominal model by simulation errors on the training records.

    Models of averaged records are simulated at the records' own rate, where they will be used.
    """

    records: Sequence[Record]
    nominal: Float[np.ndarray, " records"]
    noise: Float[np.ndarray, " records"]
    hold: Hold = "foh"

    def __call__(self, model: Model, held_out: float = np.inf) -> Candidate:
        """Simulate the model on all records, and return it as a candidate with its offset and its errors."""
        names = tuple(r.name for r in self.records)
        averaged = any(r.dt != model.dt for r in self.records)
        there = model.sampled(self.records[0].dt, self.hold) if averaged else model
        there = with_offset(there, self.records)
        model = replace(model, output=there.output)
        return Candidate(model, names, self.nominal, errors(there, self.records), self.noise, held_out)


def judge(nominal: Model | Fitted, records: Sequence[Record]) -> Judge:
    """Build the function that compares trained models with this nominal model on these records."""
    noise = [100 * noise_std(r.displacement) / max(r.span, 1e-30) for r in records]
    return Judge(records, errors(nominal, records), np.array(noise), fitted_of(nominal).hold)


def kept(best: Candidate, compare: Judge, nominal: Model) -> tuple[Candidate, list[str], str | None]:
    """Choose the trained model if its pooled log score is not worse than the nominal's; otherwise the nominal.

    Return it, lines on records that are worse and on failures, and the name of a replacement.

    `nominal`: in the form of a trained model.
    """
    lost = ", ".join(
        f"{e.name} ({e.trained:.3g} % of range instead of {e.nominal:.3g})" for e in best.errors if e.worse
    )
    where, ratio = f"worse than the nominal model on {lost or 'held-out blocks'}", f"{np.exp(-best.gain):.2g}"
    if not best.gain >= -np.log(_ALIKE):
        return compare(nominal), [
            f"training failed: the best start is {where}, and over all recordings and held-out blocks its error is "
            f"{ratio} times the nominal's (geometric mean), so the nominal itself is returned. Run `pitp diagnose` to "
            "find the missing effect"
        ], "the nominal itself"  # fmt: skip
    if lost:
        return best, [
            f"the trained model is {where}, and better over all recordings (a geometric mean of {ratio} times its "
            "error): it is returned"
        ], None  # fmt: skip
    if not best.converged:
        both = f"the mean error is {best.mean:.3g} % of range, the nominal's {_mean(best.nominal):.3g} %"
        return best, [f"training did not converge: {both}. Run `pitp diagnose` to find the missing effect"], None
    return best, [], None


def _mean(errors) -> float:
    return rms(np.minimum(errors, _DIVERGED))
