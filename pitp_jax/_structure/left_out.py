"""Compute the error of each structure on excitations that were left out of its fit."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._errors import BadInput, ComputationFailed
from .._model.fitted import Fitted
from .._model.model import Model
from .._record.excited import distinct
from .._record.record import Record
from .._train.errors import Score, scores
from .._train.settings import Settings
from .._train.training import train
from .physical import Physical

_FOLDS = 3  # at most: more excitations are left out together, so that the cost is bounded
_STEPS = 12  # of free runs in a fold; after so many, errors on other excitations hardly fall
_STAGES = 2

Identify = Callable[[Sequence[Record]], Model | Fitted]


@dataclass(frozen=True)
class Folds:
    """Recordings grouped by excitation, and the groups that are left out together.

    Attributes:
        excitations: indices of the recordings of each distinct excitation.
        folds: indices of the recordings that are left out together.
    """

    excitations: tuple[tuple[int, ...], ...]
    folds: tuple[tuple[int, ...], ...]


def folds_of(records: Sequence[Record]) -> Folds:
    """Group recordings by their excitation, and the excitations into at most three folds."""
    groups = distinct([r.voltage for r in records], records[0].dt)
    together = (groups[k::_FOLDS] for k in range(min(_FOLDS, len(groups))))
    return Folds(groups, tuple(tuple(sorted(k for group in some for k in group)) for some in together))


def errors_left_out(
    structures: Sequence[str], records: Sequence[Record], folds: Folds, identify: Identify, physical: Physical | None,
    *, settings: Settings, key, progress=lambda _: None,
) -> dict[str, list[Score]]:  # fmt: skip
    """Return the errors of each recording, predicted by every structure fitted without its excitation.

    Args:
        structures: of "physical", "encoder" and "both".
        records: all of them move.
        folds: of these records.
        identify: returns the nominal model of some recordings.
        physical: the effects; None counts as a structure that cannot be fitted. Their names were found on all
            recordings; their parameters and the coefficients are fitted without the excitation.
        settings: of a training; in the folds its steps are limited.
        key, progress: as for `train`.
    """
    short = replace(settings, refine_steps=min(settings.refine_steps, _STEPS), starts=1,
                    stages=min(settings.stages, _STAGES))  # fmt: skip
    found = {s: [Score(np.inf, ())] * len(records) for s in structures}
    for fold in folds.folds:
        others = [r for k, r in enumerate(records) if k not in fold]
        left_out = [records[k] for k in fold]
        names = {r.name for r in left_out}
        for structure, model in _fitted(structures, others, names, identify, physical, short, key, progress):
            for k, errors in zip(fold, scores(model, left_out), strict=True):
                found[structure][k] = errors
    return found


def _fitted(
    structures: Sequence[str], others: Sequence[Record], names: set[str], identify: Identify,
    physical: Physical | None, settings: Settings, key, progress,
) -> Iterator[tuple[str, Model | Fitted]]:  # fmt: skip
    """Yield (structure, model) for every structure that can be fitted to the recordings `others`."""

    def trained(nominal, chosen: Settings):
        return train(nominal, others, settings=chosen, key=key, progress=progress).model

    base = None
    if physical is not None and {"physical", "both"} & {*structures}:
        base = _unless_failed(lambda: physical.without(others, names))
    makers: dict[str, Callable[[], Model | Fitted | None]] = {
        "physical": lambda: base,
        "encoder": lambda: trained(identify(others), settings),
        "both": lambda: None if base is None else trained(base, replace(settings, remainder=True)),
    }
    for structure in structures:
        if (model := _unless_failed(makers[structure])) is not None:
            yield structure, model


def _unless_failed(make: Callable[[], Model | Fitted | None]) -> Model | Fitted | None:
    """Return the model that `make` builds, or None if the recordings do not suffice for it."""
    try:
        return make()
    except (BadInput, ComputationFailed):
        return None
