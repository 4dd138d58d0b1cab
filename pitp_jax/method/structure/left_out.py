"""Compute the error of each structure on excitations that were left out of its fit.

Copies of other recordings take the places of those left out, so that every fold has the shapes of the fit to all
recordings (`Shapes`) and runs the same compiled programs.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput, ComputationFailed
from ..model.fitted import Fitted
from ..model.model import Model
from ..signal.excited import distinct
from ..signal.record import Record
from ..train.errors import Score, scores
from ..train.settings import Settings
from ..train.shapes import Shapes
from ..train.training import train
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


def with_stand_ins(records: Sequence[Record], fold: Sequence[int]) -> list[Record]:
    """Return the recordings with copies of others in the places of a fold, as long as those and under other names.

    A copy that is too short ends with missing samples.
    """
    filled, donors = list(records), [k for k in range(len(records)) if k not in fold]
    uses = dict.fromkeys(donors, 0)
    for k in fold:
        # of equal length if possible; otherwise the one copied least, so that no recording dominates
        donor = min(donors, key=lambda d: (uses[d], abs(records[d].samples - records[k].samples)))
        uses[donor] += 1
        filled[k] = _as_long(records[donor], records[k])
    return filled


def _as_long(record: Record, other: Record) -> Record:
    """Return a copy of a record with the times of another one."""
    size, missing = other.samples, max(other.samples - record.samples, 0)
    voltage = np.pad(record.voltage[:size], (0, missing), mode="edge")
    displacement = np.pad(record.displacement[:size], (0, missing), constant_values=np.nan)
    return replace(other, name=f"{other.name} (stand-in)", voltage=voltage, displacement=displacement)


@dataclass(frozen=True)
class _Part:
    """The recordings of a fit without one fold: the remaining ones, and these with stand-ins."""

    fold: tuple[int, ...]
    others: list[Record]
    filled: list[Record]


def errors_left_out(
    structures: Sequence[str], records: Sequence[Record], folds: Folds, identify: Identify, physical: Physical | None,
    *, settings: Settings, shapes: Shapes | None, key, progress=lambda _: None,
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
        shapes: of a training on all recordings.
        key, progress: as for `train`.
    """
    short = replace(settings, refine_steps=min(settings.refine_steps, _STEPS), starts=1,
                    stages=min(settings.stages, _STAGES))  # fmt: skip
    found = {s: [Score(np.inf, ())] * len(records) for s in structures}
    for fold in folds.folds:
        part = _Part(fold, [r for k, r in enumerate(records) if k not in fold], with_stand_ins(records, fold))

        def trained(nominal, chosen: Settings, part=part):
            return train(nominal, part.filled, settings=chosen, shapes=shapes, key=key, progress=progress).model

        names = {records[k].name for k in fold}
        for structure, model in _fitted(structures, part, names, identify, physical, short, trained):
            every = scores(model, records)  # all of them have the shapes of the fit
            for k in fold:
                found[structure][k] = every[k]
    return found


def _fitted(
    structures: Sequence[str], part: _Part, names: set[str], identify: Identify, physical: Physical | None,
    settings: Settings, trained: Callable,
) -> Iterator[tuple[str, Model | Fitted]]:  # fmt: skip
    """Yield (structure, model) for every structure that can be fitted to a part of the recordings."""
    base = None
    if physical is not None and {"physical", "both"} & {*structures}:
        base = _unless_failed(lambda: physical.without(part.filled, names))
    makers: dict[str, Callable[[], Model | Fitted | None]] = {
        "physical": lambda: base,
        "encoder": lambda: trained(identify(part.others), settings),
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
