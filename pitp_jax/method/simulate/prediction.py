"""Predict the displacement of recordings: simulate the model under their voltages.

    starts (at rest, or estimated from the first samples) -> rollout -> displacement in rig coordinates

A diverging rollout is a result, marked `diverged`, with nan after its divergence.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Array, Float

from ...common.errors import refuse_traced
from ...common.shown import Shown
from ..model.coverage import untrained, untrained_words
from ..model.dominant import has_spring
from ..model.encoder import ignores_position
from ..model.fitted import Fitted, fitted_of
from ..model.memory import FadingMemory, RingingMemory
from ..model.model import Model
from ..model.programs import on_device
from ..model.substeps import substeps
from ..signal.initial_state import Beginning, Begins, aligned
from ..signal.record import Record
from ..signal.sets import alike, check_set, session_clock
from . import ports
from .beginnings import beginnings
from .model_runs import evaluate, model_runs, padded
from .moving_start import initial_samples, still

_SLACK = 0.05  # fraction of a trained range by which a feature may exceed it
FAR = 1e4  # a run beyond this scaled displacement has diverged


def at_rate(model: Model, dt: float) -> Model:
    """Return the model with enough Runge-Kutta steps per sample for this sampling interval (s)."""
    count = max(model.substeps * max(1, round(dt / model.dt)), substeps(model.physical_coefficients, dt))
    return replace(model, substeps=count) if count > model.substeps else model


@dataclass(frozen=True)
class Prediction(Shown):
    """The simulated displacement of one record, with its initial state and its distance from the training data.

    Attributes:
        name: of the record.
        displacement: predicted output in rig coordinates (offset and polarity applied), base unit, shape (T,); nan from
            the sample where the rollout diverged.
        diverged: whether the rollout diverged.
        estimated_start: the record starts moving, so state and memory were estimated from its first samples.
        scored: samples that count, shape (T,): all except those used to estimate the initial state.
        outside_training_share: the larger of two fractions: of the samples, with a state outside the trained region;
            of the input's energy, at frequencies and amplitudes that the model was not trained with.
        outside_training: in which coordinates, by how much and when, in words; empty if inside.
        not_excited: the sentence on the input's energy, where it is more than a tenth; otherwise empty.
        begins: "rest", "held" or "moving".
        zero, zero_stderr, direction: the record's own sensor offset and direction: measured = direction * x + zero (m
            or V).
        start_certainty: probability of this start beside the others (`method.signal.start`).
    """

    name: str
    displacement: np.ndarray
    diverged: bool
    estimated_start: bool
    scored: np.ndarray
    outside_training_share: float
    begins: Begins = "rest"
    zero: float = 0.0
    zero_stderr: float = 0.0
    direction: float = 1.0
    outside_training: str = ""
    not_excited: str = ""
    start_certainty: float = 1.0

    def __repr__(self) -> str:
        """Return one line: the range of the prediction, and the assumed initial state of the record."""
        seen = self.displacement[np.isfinite(self.displacement)]
        range_ = f"{seen.min():.4g} to {seen.max():.4g}" if len(seen) else "nothing"
        state = "diverged" if self.diverged else f"{100 * self.outside_training_share:.3g} % outside the trained region"
        return (
            f"Prediction({self.name!r}: {range_} over {len(self.displacement)} samples, begins {self.begins}, zero "
            f"{self.zero:.4g}, direction {self.direction:+g}, {state})"
        )


def predict(model: Model | Fitted, records: Sequence[Record]) -> tuple[Prediction, ...]:
    """Simulate the model under the voltage of every record; all records have one sampling rate.

    Args:
        model: identified, trained, or with effects (`Fitted` or `Model`).
        records: as `pitp.read` gives them.

    Returns:
        one run per record, in the order given, in the rig's coordinates (m or V).

    Raises:
        BadInput: no records, of several rates, or something else than a model and records.

    Examples:
        >>> run = pitp.predict(model, records)[0]
        >>> run.displacement.shape == records[0].displacement.shape
        True
    """
    refuse_traced("predict", "free_run", model)
    fitted = fitted_of(model)
    check_set(records)
    return tuple(_beside_trained(fitted, *both) for both in zip(records, simulate(fitted.model, records), strict=True))


def predicted_pairs(model: Model | Fitted, records: Sequence[Record]) -> Iterator[tuple[Record, Prediction]]:
    """Return every record with its prediction (`predict`)."""
    return zip(records, predict(model, records), strict=True)


def simulate(model: Model, records: Sequence[Record], known: Sequence[Beginning] = ()) -> list[Prediction]:
    """Simulate the model under the voltage of every record, without a comparison of the inputs; `known` as `begin`."""
    model, runs = at_rate(model, records[0].dt), {}
    # initial states over the whole set, because a session's clock and reach span all lengths
    start, spent, begun = begin(model, records, known=known)
    # by length; otherwise one long record would pad all others
    for places in alike(records):
        voltage = padded([records[k].voltage for k in places])
        found = model_runs(model, voltage, records[0].dt, np.asarray(start)[places])
        for k, states, seen in zip(places, *found, strict=True):
            runs[k] = _prediction(model, records[k], states, seen, spent[k], begun[k])
    return [runs[k] for k in range(len(records))]


def _beside_trained(model: Fitted, record: Record, run: Prediction) -> Prediction:
    """Add to a prediction the fraction and the description of the input's untrained part."""
    part = untrained(model, "input", record.voltage, record.dt)
    share = max(run.outside_training_share, part.fraction)
    return replace(run, outside_training_share=share, not_excited=untrained_words(model, "input", part))


def begin(
    model: Model, records: Sequence[Record], aged: bool | None = None, known: Sequence[Beginning] = ()
) -> tuple[Float[Array, "records state"], tuple[int, ...], list[Beginning]]:
    """Return the initial states, the samples used for each, and how each record starts, with offset and direction.

    `known`: per record, how it begins by another model with this sensor; one at rest is not estimated again.
    """
    aged = session_clock(records) if aged is None else aged
    ages = np.array([model.domain.age(r.time[0]) if aged else 0.0 for r in records])
    unknown = [k for k in range(len(records)) if not known or known[k].begins != "rest"]
    begun, starts = dict(enumerate(known)), evaluate(still, model, 0.0, 0.0, ages)
    if unknown:
        found, starts[unknown] = beginnings(model, [records[k] for k in unknown], ages[unknown].tolist())
        begun |= zip(unknown, found, strict=True)
    begun = [begun[k] for k in range(len(records))]
    spent = tuple(initial_samples(model, r) if b.begins == "moving" else 0 for r, b in zip(records, begun, strict=True))
    if aged and model.effects:
        # stretch by earlier records of the session remains (Mullins)
        turned = [aligned(r, b, model.output) for r, b in zip(records, begun, strict=True)]
        far = reaches(model, turned)
        starts = evaluate(_resumed, model, far, *np.transpose(starts))
    return on_device(starts, model.coefficients.dtype), spent, begun


def _resumed(model: Model, row: Float[Array, " numbers"], *_) -> tuple[Array, Array]:
    return row, ports.resumed(model, row[1:], row[0])


def reaches(model: Model, records: Sequence[Record]) -> list[float]:
    """Return the largest scaled |x| of the session before each record, without sensor offset and direction."""
    scale = model.scales.state[0]
    far = [float(np.nanmax(np.abs(model.output.to_model(r.displacement)))) / scale for r in records]
    begins = [r.time[0] for r in records]
    return [max((f for f, b in zip(far, begins, strict=True) if b < own), default=0.0) for own in begins]


def outside_fraction(model: Model, features: np.ndarray) -> float:
    """Return the fraction of samples whose features (S, then memories, scaled) lie outside the trained region.

    The box is widened by 5 % of its size, or of the displacement's range, on each side (slow memories barely move
    in short records). A model without a region (identified only) returns 0.
    """
    if not len(model.domain.region) or len(features) == 0:
        return 0.0
    return float((_beyond(model, features) > _SLACK).any(-1).mean())


def _beyond(model: Model, features: np.ndarray) -> np.ndarray:
    """Return how far each feature lies outside its trained range, relative to this range; negative inside."""
    low, high = np.asarray(model.domain.region).T
    beyond = np.maximum(low - features, features - high) / np.maximum(high - low, high[0] - low[0])
    if ignores_position(model.encoder) and not has_spring(model.physical_coefficients):
        beyond[:, 0] = -1.0
    return beyond


def outside_words(model: Model, features: np.ndarray, time: np.ndarray) -> str:
    """Describe which features leave the trained region, by how much and when; empty if none does.

    Args:
        model: its region is the box.
        features: S then memory, scaled, shape (T, features).
        time: of the rows, s, shape (T,).
    """
    if outside_fraction(model, features) == 0:
        return ""
    beyond = _beyond(model, features)
    memory = model.memory
    mass = ["second mass", "speed of the second mass"] if isinstance(memory, RingingMemory) else []
    lags = np.exp(np.asarray(memory.log_tau)) if isinstance(memory, FadingMemory | RingingMemory) else []
    fading = [f"memory with time constant {tau:.2g} s" for tau in lags]
    names = ["stroke", "speed", *(f"derivative {k}" for k in range(2, model.order))][: model.order]
    names += [*mass, *fading, *["memory"] * (memory.size - len(mass) - len(fading))]
    worst = [k for k in np.argsort(-beyond.max(0)) if beyond[:, k].max() > _SLACK][:2]
    return " and ".join(
        f"{names[k]} by up to {100 * beyond[:, k].max():.0f} % of its trained range, first at "
        f"{time[np.argmax(beyond[:, k] > _SLACK)]:.4g} s"
        for k in worst
    )


def _prediction(
    model: Model, record: Record, states: np.ndarray, seen: np.ndarray, spent: int, begun: Beginning
) -> Prediction:
    """Build the prediction of one record from its scaled states and readings, cut at a divergence."""
    states = states[: record.samples]
    lost = ~(np.isfinite(states).all(-1) & (np.abs(states[:, 0]) < FAR))
    # after divergence nothing counts, even if the run returns
    first = int(np.argmax(lost)) if lost.any() else record.samples
    x = np.full(record.samples, np.nan)
    # the record's own offset and direction, because a session may have remounted the sensor
    x[:first] = begun.direction * seen[:first] * model.scales.state[0] + begun.zero
    scored = np.arange(record.samples) >= spent
    features = states[:first, : model.order + model.memory.size]
    outside = 1.0 if first == 0 else outside_fraction(model, features)
    words = outside_words(model, features, record.time[:first] - record.time[0])
    own = begun.begins, begun.zero, begun.stderr, begun.direction
    return Prediction(record.name, x, bool(lost.any()), spent > 0, scored, outside, *own, words,
                      start_certainty=begun.certainty)  # fmt: skip
