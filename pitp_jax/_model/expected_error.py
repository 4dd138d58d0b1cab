"""The error to expect of a recording that no training used, e_rms in % of range.

Trained with cross-validation: the median of the errors of the recordings left out. Identified: the ratio of the rms of
error and output over the parts left out, times the standard deviation of a motion over its range.
"""

from typing import NamedTuple

import numpy as np

from .fitted import Fitted


class Expected(NamedTuple):
    """An error to expect, e_rms in % of range, and its source in words."""

    percent: float
    source: str


def expected_error(model: Fitted, displacement: np.ndarray) -> Expected | None:
    """Return the error to expect of a motion (base unit, shape (time,)); None where nothing was left out."""
    origin, x = model.origin, displacement[np.isfinite(displacement)]
    step = origin.lineage[-1].get("step") if origin.lineage else None
    if step == "fit":
        errors = [v for v in ((origin.training or {}).get("left_out_errors") or {}).values() if v is not None]
        if not errors:
            return None
        source = (
            f"median of {len(errors)} recordings left out of the training, {min(errors):.2g} to {max(errors):.2g} %"
        )
        return Expected(float(np.median(errors)), source)
    # effects that were found since, or another day, changed the error: no figure is known then
    bands = origin.out_of_fold if step == "identify" else None
    output = float(np.sum(np.square(bands.output))) if bands is not None else 0.0
    if bands is None or not output > 0 or not len(x) or not np.ptp(x) > 0:
        return None
    ratio = np.sqrt(float(np.sum(np.square(bands.error))) / output)
    return Expected(float(100 * ratio * np.std(x) / np.ptp(x)), "from parts of the recordings left out")
