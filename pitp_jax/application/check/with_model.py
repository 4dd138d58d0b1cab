"""Compare records with a given model: how each record starts, and which of them the model does not explain.

    e_rms > 3 max(error on the model's own records, median of these)  and > 1 % of range,   or > 20 % of range

The error on its own records is known for an identified model (`misfit` noise deviations). A record's noise is no fault
of the model, so twice the noise is always allowed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...common.metrics import e_rms_percent
from ...method.model.fitted import Fitted
from ...method.signal.initial_state import Beginning, noise_std
from ...method.signal.record import Record
from ...method.simulate.prediction import predict
from .one_record import coloured_noise, drive_band

_TIMES, _LEAST, _MOST, _NOISES = 3.0, 1.0, 20.0, 2.0


@dataclass(frozen=True)
class Explained:
    """One record compared with a model: initial state, error (% of range; None if diverged), noise and problem.

    `not_excited`: the sentence on what the model was not trained with.
    """

    beginning: Beginning
    e_rms_percent: float | None
    coloured: float | None
    colour: str | None
    problem: str
    not_excited: str


def beside_model(model: Fitted, records: Sequence[Record]) -> dict[str, Explained]:
    """Simulate records of one rate with the model, and compare each with its measurement; return results by name."""
    runs = predict(model, records)
    errors = [
        float(e_rms_percent(p.displacement, r.displacement, p.scored)) for p, r in zip(runs, records, strict=True)
    ]
    floors = [100 * noise_std(r.displacement) / r.span for r in records]
    misfit = model.origin.misfit
    usual = float(np.median(np.nan_to_num(errors, nan=np.inf, posinf=np.inf)))
    resonance, square = model.natural_frequency / (2 * np.pi), model.input_map.name == "square"
    explained = {}
    for r, p, error, floor in zip(records, runs, errors, floors, strict=True):
        own = misfit * floor if np.isfinite(misfit) else 0.0
        bound = max(_LEAST, _NOISES * floor, _TIMES * max(own, min(usual, _MOST / _TIMES)))
        coloured = colour = None
        if not np.isfinite(error):
            problem = "the model diverges on it" if p.diverged else "it holds no samples to score"
        else:
            most = f" ({usual:.2g} % of most of these)" if usual < error / 2 else ""
            problem = f"the model does not explain it: error {error:.3g} % of range{most}" if error > bound else ""
            residual = np.where(r.observed & ~np.isnan(p.displacement), p.displacement - r.displacement, 0.0)
            top = drive_band(r)[1] * (2 if square else 1)
            coloured = coloured_noise(residual, r.observed, r.dt, top, resonance)
            colour = "white" if coloured is None else "coloured"
        begun = Beginning(p.begins, p.direction, p.zero, p.zero_stderr)
        explained[r.name] = Explained(begun, error if np.isfinite(error) else None, coloured, colour, problem,
                                     p.not_excited)  # fmt: skip
    return explained
