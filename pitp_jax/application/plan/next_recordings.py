"""Choose the next recordings for a trained model, among candidate inputs.

    chosen one after another, each the one that lowers v most, until the improvement is too small to see:
    1 - sqrt((v_after + e^2) / (v_before + e^2)) < 1 %

v: mean variance of the predictions (`information`), e: residual of the model on its own records, with noise; both in %
of a recording's range. Refinement of a fit stops at the same fraction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput
from ...method.model.model import Model
from ...method.signal.record import Record
from .drives import Planned, space_filling
from .expected_error import Knowledge, Motions, knowledge, motions
from .first_session import FEWEST, POINTS, default_duration, drive
from .information import choose
from .limits import Limits
from .strokes import strokes

_CANDIDATES, _PREDICTED = 48, 16  # candidate inputs, and inputs to be predicted
_SEEN = 0.01


@dataclass(frozen=True)
class Next:
    """The chosen recordings, the expected error (%) before and after each, how many are worthwhile, and notes."""

    recordings: tuple[Planned, ...]
    expected: tuple[float, ...]
    worth: int
    notes: tuple[str, ...] = ()


def bearable(model: Model, drives: Sequence[Planned], limits: Limits) -> tuple[list[Planned], tuple[str, ...]]:
    """Keep the inputs whose predicted stroke stays below the limit, also at half the damping; add a note on the others.

    Raises:
        BadInput: none is allowed.
    """
    reached = strokes(model, [d.voltage for d in drives], 1 / limits.rate)
    kept = [
        replace(d, stroke=float(own), stroke_half_damped=float(half))
        for d, (own, half) in zip(drives, reached, strict=True)
        if np.isfinite(own) and max(own, half) <= limits.farthest
    ]
    if not kept:
        raise BadInput(
            f"{limits.units.max_output} {limits.units.limit.text(limits.farthest)}: every planned input is predicted "
            f"to exceed it (the smallest reaches {limits.units.limit.text(reached.max(1).min(), 3)} with half the "
            f"damping); lower {limits.units.max_input}"
        )
    out = len(drives) - len(kept)
    return kept, (
        f"{out} of {len(drives)} inputs left out, because their predicted stroke exceeds the limit",
    ) if out else ()


def following(model: Model, records: Sequence[Record], limits: Limits, length: float, seed: int) -> Next:
    """Choose the inputs (over frequency, swing and bias) that lower the model's expected error most.

    Raises:
        BadInput: a length shorter than one recording, or no input within the allowed stroke.
    """
    # of one length, so that the gains of candidates can be compared
    one = max(limits.shortest, min(length, default_duration(limits, fresh=False) / FEWEST))
    count = int(length / one * (1 + 1e-9))
    if count < 1:
        raise BadInput(f"--duration {length:g} s is too short; one recording takes {limits.shortest:.3g} s")
    points = space_filling(_CANDIDATES * POINTS, limits, seed)
    tried = [drive(points[k::_CANDIDATES], one, limits) for k in range(_CANDIDATES)]
    tried, notes = bearable(model, tried, limits)
    # other points than the candidates', which would predict themselves best
    wanted = [drive(p[None], one, limits) for p in space_filling(_PREDICTED, limits, seed + 1)]
    known = knowledge(model, records)
    offered, predicted = (
        motions(model, [d.voltage for d in some], 1 / limits.rate, floor=known.floor) for some in (tried, wanted)
    )
    places, expected, worth = greedy(known, offered, predicted, np.full(len(tried), one), count)
    chosen = [
        replace(tried[k], purpose=f"{tried[k].purpose.split(':')[0]}: {_lowered(expected, j)}")
        for j, k in enumerate(places)
    ]
    return Next(tuple(chosen), expected, worth, notes)


def _lowered(expected: Sequence[float], j: int) -> str:
    return f"lowers the expected error from {expected[j]:.3g} to {expected[j + 1]:.3g} %"


def greedy(
    known: Knowledge, offered: Motions, predicted: Motions, seconds: np.ndarray, count: int
) -> tuple[list[int], tuple[float, ...], int]:
    """Choose `count` candidates one by one; return indices, expected errors (%), and how many are worthwhile."""
    g = np.mean([m for m, ok in zip(predicted.information, predicted.finite, strict=True) if ok], axis=0)
    moved = [t * m for t, m in zip(seconds, offered.information, strict=True)]
    taken, variances = choose(known.precision, moved, g, count)
    v = known.unit * np.array(variances)
    # compared with the model's residual: a variance below it cannot be seen in any measured error
    seen = 1 - np.sqrt((v[1:] + known.error**2) / (v[:-1] + known.error**2)) >= _SEEN
    worth = len(taken) if seen.all() else int(np.argmin(seen))
    return taken, tuple(map(float, np.sqrt(v))), worth
