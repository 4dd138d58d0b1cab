"""Choose the next recordings for a trained model, among candidate inputs.

    Lambda = sum_r M_r,   M_r = J_r' J_r,        J: derivatives of a free run by the parameters, in units of its error
    v(c)   = tr[(Lambda + M_c)^-1 G],            G: mean of J_t' J_t over the inputs to be predicted
    next   = argmin_c v(c), then Lambda <- Lambda + M_next                     (greedy, Laplace, V-optimal)
    until the improvement is too small to see:   1 - sqrt((v_after + e^2) / (v_before + e^2)) < 1 %

v: mean variance of the predictions; the prior enters Lambda as one more recording. e: residual of the model on its own
records, with noise; both in % of a recording's range. Refinement of a fit stops at the same fraction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...common.errors import BadInput
from ...method.model.model import Model
from ...method.signal.record import Record
from .drives import Planned, space_filling
from .expected_error import Knowledge, information, knowledge
from .first_session import FEWEST, POINTS, default_duration, drive
from .limits import Limits
from .strokes import strokes


@dataclass(frozen=True)
class Next:
    """The chosen recordings, the expected error (%) before and after each, how many are worthwhile, and notes."""

    recordings: tuple[Planned, ...]
    expected: tuple[float, ...]
    worth: int
    notes: tuple[str, ...]


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
    if not out:
        return kept, ()
    return kept, (f"{out} of {len(drives)} inputs left out, because their predicted stroke exceeds the limit",)


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
    candidates = 48
    points = space_filling(candidates * POINTS, limits, seed)
    tried = [drive(points[k::candidates], one, limits) for k in range(candidates)]
    tried, notes = bearable(model, tried, limits)
    # other points than the candidates', which would predict themselves best
    wanted = [drive(p[None], one, limits) for p in space_filling(16, limits, seed + 1)]
    known = knowledge(model, records)
    offered, predicted = (
        information(model, [d.voltage for d in some], 1 / limits.rate, known.floor) for some in (tried, wanted)
    )
    places, expected, worth = greedy(known, offered, predicted, one, count)
    chosen = [
        replace(
            tried[k], purpose=f"{tried[k].purpose.split(':')[0]}: lowers the expected error from {a:.3g} to {b:.3g} %"
        )
        for k, a, b in zip(places, expected[:-1], expected[1:], strict=True)
    ]
    return Next(tuple(chosen), expected, worth, notes)


def greedy(
    known: Knowledge, offered: Sequence[np.ndarray], predicted: Sequence[np.ndarray], seconds: float, count: int
) -> tuple[list[int], tuple[float, ...], int]:
    """Choose `count` candidates one by one; return indices, expected errors (%), and how many are worthwhile."""
    judged = np.mean([m for m in predicted if m.any()], axis=0)  # not of runs that diverged
    taken, variances = choose(known.precision, [seconds * m for m in offered], judged, count)
    v = known.unit * np.array(variances)
    # compared with the model's residual: a variance below it cannot be seen in any measured error
    seen = 1 - np.sqrt((v[1:] + known.error**2) / (v[:-1] + known.error**2)) >= 0.01
    worth = len(taken) if seen.all() else int(np.argmin(seen))
    return taken, tuple(map(float, np.sqrt(v))), worth


def variance(precision: np.ndarray, predicted: np.ndarray) -> float:
    """Return the mean variance of predictions, tr(Lambda^-1 G), for precision Lambda and predictions G, both (P, P)."""
    # float32 slopes leave a matrix barely singular
    regular = precision + 1e-9 * np.trace(precision) / len(precision) * np.eye(len(precision))
    return float(np.trace(cho_solve(cho_factor(regular), predicted)))


def choose(
    precision: np.ndarray, candidates: Sequence[np.ndarray], predicted: np.ndarray, count: int
) -> tuple[list[int], list[float]]:
    """Choose `count` candidates one by one, each the one that lowers the mean variance of predictions most.

    Args:
        precision: Lambda before, shape (P, P).
        candidates: M_c, shape (P, P) each.
        predicted: G, shape (P, P).
        count: number of recordings, at most all.

    Returns:
        their places, and the mean variance before the first and after each of them.
    """
    # One at a time: subsets of 48 would be too many, and two candidates with the same information are not both chosen.
    taken, variances = [], [variance(precision, predicted)]
    while len(taken) < min(count, len(candidates)):
        remaining = [k for k in range(len(candidates)) if k not in taken]
        after = [variance(precision + candidates[k], predicted) for k in remaining]
        best = int(np.argmin(after))
        taken.append(remaining[best])
        variances.append(after[best])
        precision = precision + candidates[remaining[best]]
    return taken, variances
