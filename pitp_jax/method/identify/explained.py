"""Judge whether a linear model explains the output at all, and report the likely reason if not.

feedback:  var(u_t | earlier u, y up to t) / var(u_t | earlier u)      least squares on the last samples of both
"""

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..numerics.coloured_noise import project
from ..signal.initial_state import noise_std
from .heldout import Candidate
from .output_error import Problem

NOTHING, LITTLE = 0.9, 0.5  # fraction of the output's rms, held out: residual of a model that explains nothing, little
CHECK = "Check --input-column and --output-column, and whether another input moves the output"
_LAGS = 8  # samples


def explains(chosen: Candidate, candidates: Sequence[Candidate], problem: Problem) -> tuple[bool, str | None]:
    """Return whether the model explains the output, and a warning if it explains little or hardly more than noise."""
    least = min(c.heldout.score for c in candidates)
    left = f"{100 * chosen.heldout.score:.0f} % of the output's rms remains unexplained on held-out blocks"
    if chosen.heldout.score > 0.1 and is_noise(problem):
        if _fed_back(problem):
            return False, (
                f"The model explains only the sensor's noise, which a controller feeds back into the input ({left}). "
                "Such recordings determine no model; add a test signal to the reference"
            )
        return least < NOTHING, (
            f"{left}, and most of the output is sensor noise. Such recordings determine no model; record with a "
            "larger excitation"
        )
    if least >= NOTHING:
        return False, f"The model explains nothing: {left}, at any order. {_reason(problem)}"
    if chosen.heldout.score >= LITTLE:
        return True, f"{left}: the model explains only a part. {_reason(problem)}"
    return True, None


def _reason(problem: Problem) -> str:
    if _fed_back(problem):
        return (
            "The input follows from the output, so a controller closes the loop. Use its reference as the input, or "
            "add a test signal to the reference"
        )
    return CHECK


def _fed_back(problem: Problem) -> bool:
    """Return whether the output predicts the input better than the earlier input does, as in a closed loop."""
    alone = beside = 0.0
    for drive, output, weight in zip(problem.drive, problem.output, problem.weight, strict=True):
        y = np.where(weight > 0, output, output[weight > 0].mean())
        past, outputs = (sliding_window_view(series, _LAGS + 1) for series in (drive, y))
        inputs = np.column_stack([past[:, :-1], np.ones(len(past))])
        rest, less = (project(drive[_LAGS:], c)[1] for c in (inputs, np.column_stack([inputs, outputs])))
        alone, beside = alone + float(rest @ rest), beside + float(less @ less)
    moved = sum(float(np.sum((drive - drive.mean()) ** 2)) for drive in problem.drive)
    # an input that its own past predicts to 0.1 % of its variance needs no output
    return beside < 0.1 * alone and alone > 1e-3 * moved


def is_noise(problem: Problem) -> bool:
    """Return whether the sensor's noise makes up over half of the output's standard deviation, pooled over records."""
    noise = moved = 0.0
    for output, weight in zip(problem.output, problem.weight, strict=True):
        y, count = np.where(weight > 0, output, np.nan), float(weight.sum())
        noise, moved = noise + count * float(noise_std(y)) ** 2, moved + count * float(np.nanvar(y))
    return bool(noise > 0.5**2 * moved)
