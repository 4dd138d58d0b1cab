"""Choose the structure of a model (effects, networks, or both) by its error on excitations left out.

    physical   the nominal model, refitted, with at most three effects found by the search of a diagnosis
    encoder    the nominal model with networks, as `train` makes it
    both       the physical one with networks that are ten times as firm and fade outside the trained region

A structure is as good as the best one if the mean of the differences of log e_rms over the excitations is at most its
standard error. The one with the fewest parameters is chosen (docs/decisions/structure.md).
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ...common.errors import BadInput, ComputationFailed
from ..model.fitted import Fitted
from ..model.model import Model
from ..signal.initial_state import in_motion
from ..signal.record import Record
from ..train.cross_validation import HeldOut
from ..train.errors import Score, errors
from ..train.settings import Settings
from ..train.shapes import Shapes
from ..train.training import Training, train
from .left_out import Identify, errors_left_out, folds_of
from .physical import Physical, as_training, find_physical

_TIMES = 2  # of the encoder's training, as measured without networks beside effects (docs/decisions/structure.md)
STRUCTURES = ("physical", "encoder", "both")  # those with the fewest parameters first


@dataclass(frozen=True)
class Choice:
    """The chosen structure of a model, with the reason, its training, and the errors of all structures.

    Attributes:
        structure: "physical", "encoder" or "both".
        reason: why, one sentence.
        training: its training on all recordings.
        errors: of every structure on the excitations left out, e_rms in % of range, geometric mean; empty if not
            compared.
        held_out: of the chosen one, one entry per recording that moves; empty if not compared.
    """

    structure: str
    reason: str
    training: Training
    errors: dict[str, float] = field(default_factory=dict)
    held_out: tuple[HeldOut, ...] = ()


@dataclass(frozen=True)
class Fitting:
    """The data and settings with which all structures are fitted.

    Attributes:
        nominal: of all recordings.
        identify: returns the nominal model of some recordings.
        settings, key, progress: as for `train`.
        say: called with a line of progress.
    """

    nominal: Model | Fitted
    identify: Identify
    settings: Settings
    key: object
    progress: Callable = lambda _: None
    say: Callable[[str], None] = lambda _: None


def best_structure(
    found: dict[str, Float[np.ndarray, " excitations"]], constant: Float[np.ndarray, " excitations"]
) -> tuple[str, str]:
    """Return the structure with the fewest parameters that is as good as the best one, and the reason.

    Args:
        found: errors on the excitations left out, of the structures in the order of their parameters.
        constant: errors of a constant; a structure with a larger one is not chosen.
    """
    useful = [s for s, e in found.items() if (e < constant).all()]
    if not useful:
        return "encoder", "no structure predicts every excitation left out better than a constant"
    logs = {s: np.log(np.maximum(found[s], 1e-9)) for s in useful}
    best = min(logs, key=lambda s: float(logs[s].mean()))
    chosen = next(s for s, log in logs.items() if _as_good(log, logs[best]))
    if chosen == best:
        return best, f"lowest error on {len(constant)} excitations left out"
    return chosen, f"as good as {best} on {len(constant)} excitations left out, with fewer parameters"


def _as_good(log: Float[np.ndarray, " excitations"], best: Float[np.ndarray, " excitations"]) -> bool:
    """Return whether logarithms of errors exceed others by at most the standard error of the mean difference."""
    d = log - best
    return bool(d.mean() <= d.std(ddof=1) / np.sqrt(len(d)))


def choose(how: Fitting, records: Sequence[Record], encoder: Training) -> Choice:
    """Compare the three structures if there are few excitations; otherwise keep the trained encoder.

    Args:
        how: the fitting.
        records: the training recordings.
        encoder: trained on them, not interrupted.
    """
    moving, _ = in_motion(records)
    folds = folds_of(moving)
    count = len(folds.excitations)
    if not 2 <= count < how.settings.few:
        what = "one excitation, so none can be left out" if count < 2 else f"{count} distinct excitations"
        return Choice("encoder", what, encoder)
    seconds = float(encoder.notes.get("seconds", np.inf))
    how.say(f"comparing three structures on {count} excitations, each left out as a whole: about "
            f"{_TIMES * seconds:.0f} s (--structure encoder skips this)")  # fmt: skip
    try:
        return _compared(how, moving, folds, encoder)
    except KeyboardInterrupt:
        return Choice("encoder", "the comparison was interrupted", replace(encoder, interrupted=True))


def _compared(how: Fitting, moving: Sequence[Record], folds, encoder: Training) -> Choice:
    began = time.monotonic()
    physical = _searched(how, moving)
    every, grouped = {}, {}
    for structure in STRUCTURES:
        if structure == "both" and not _helps(grouped):
            continue
        every |= errors_left_out([structure], moving, folds, how.identify, physical, settings=how.settings, key=how.key,
                                 shapes=encoder.shapes, progress=how.progress)  # fmt: skip
        grouped[structure] = _by_excitation(_percent(every[structure]), folds.excitations)
    still = np.array([100 * np.nanstd(r.displacement) / r.span for r in moving])
    chosen, reason = best_structure(grouped, _by_excitation(still, folds.excitations))
    training = encoder
    if chosen != "encoder" and physical is not None:
        try:
            training = _trained(chosen, how, physical, moving, began, encoder.shapes)
        except (BadInput, ComputationFailed) as error:
            chosen, reason = "encoder", f"{chosen} cannot be fitted to all recordings: {error}"
    means = {s: float(np.exp(np.mean(np.log(e)))) for s, e in grouped.items()}
    return Choice(chosen, reason, training, means, _held_out(training, moving, every[chosen]))


def _helps(grouped: dict[str, np.ndarray]) -> bool:
    """Return whether the effects alone are as good as networks: networks beside worse physics are not trained."""
    physical, encoder = (np.log(np.clip(grouped[s], 1e-9, 1e9)) for s in ("physical", "encoder"))
    return bool(np.isfinite(grouped["physical"]).all()) and _as_good(physical, encoder)


def impose(structure: str, how: Fitting, records: Sequence[Record], cross_validate: bool = False) -> Choice:
    """Fit the structure "physical" or "both" without a comparison.

    Args:
        structure: to fit.
        how: the fitting.
        records: the training recordings.
        cross_validate: whether its errors on excitations left out are computed.

    Raises:
        ComputationFailed: the model with effects diverges.
        BadInput: the nominal model diverges, or there is one excitation to leave out.
    """
    moving, _ = in_motion(records)
    began = time.monotonic()
    physical = find_physical(how.nominal, moving, how.say)
    training = _trained(structure, how, physical, moving, began)
    held_out: tuple[HeldOut, ...] = ()
    if cross_validate:
        folds = folds_of(moving)
        if len(folds.excitations) < 2:
            raise BadInput("all recordings have the same excitation, so none can be left out")
        found = errors_left_out([structure], moving, folds, how.identify, physical, settings=how.settings, key=how.key,
                                shapes=training.shapes, progress=how.progress)  # fmt: skip
        held_out = _held_out(training, moving, found[structure])
    return Choice(structure, "given by --structure", training, held_out=held_out)


def _searched(how: Fitting, moving: Sequence[Record]) -> Physical | None:
    try:
        return find_physical(how.nominal, moving, how.say)
    except (BadInput, ComputationFailed) as error:
        how.say(f"no physical model: {error}")
        return None


def _trained(
    structure: str, how: Fitting, physical: Physical, moving: Sequence[Record], began: float,
    shapes: Shapes | None = None,
) -> Training:  # fmt: skip
    model = physical.model(moving)
    if structure == "physical":
        return as_training(model, how.nominal, moving, time.monotonic() - began)
    settings = replace(how.settings, remainder=True)
    return train(model, moving, settings=settings, shapes=shapes, key=how.key, progress=how.progress)


def _by_excitation(values: np.ndarray, excitations: Sequence[Sequence[int]]) -> np.ndarray:
    """Return the geometric mean of errors over the recordings of each excitation."""
    return np.array([np.exp(np.mean(np.log(np.maximum(values[list(e)], 1e-9)))) for e in excitations])


def _percent(found: Sequence[Score]) -> np.ndarray:
    return np.array([t.percent for t in found])


def _held_out(training: Training, moving: Sequence[Record], predicted: Sequence[Score]) -> tuple[HeldOut, ...]:
    """Return the fitted and the predicted error of each recording, in the order of the training's list."""
    fitted = dict(zip((r.name for r in moving), errors(training.model, moving).tolist(), strict=True))
    left_out = dict(zip((r.name for r in moving), predicted, strict=True))
    return tuple(
        HeldOut(e.name, fitted[e.name], left_out[e.name].percent, cells=left_out[e.name].cells) for e in training.errors
    )
