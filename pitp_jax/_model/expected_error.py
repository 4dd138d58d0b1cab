"""Predict the error on a recording that was not used for training, e_rms in % of range.

After a cross-validation it is the median error of the recordings that were left out. For an identified model it is the
ratio of the rms of error and output over the parts left out, times the standard deviation of a motion over its range.
"""

from typing import NamedTuple

import numpy as np

from .fitted import Fitted


class Expected(NamedTuple):
    """The error to expect on a new recording, e_rms in % of range, and its source in words."""

    percent: float
    source: str


def expected_error(model: Fitted, displacement: np.ndarray) -> Expected | None:
    """Return the expected error for a motion (base unit, shape (time,)); None if no recording was held out."""
    origin, x = model.origin, displacement[np.isfinite(displacement)]
    step = origin.lineage[-1].get("step") if origin.lineage else None
    if step == "fit":
        errors = [v for v in ((origin.training or {}).get("left_out_errors") or {}).values() if v is not None]
        if not errors:
            return None
        source = (
            f"median of {len(errors)} recordings, each left out of a training: {min(errors):.2g} to {max(errors):.2g} %"
        )
        return Expected(float(np.median(errors)), source)
    # a diagnosis or an adaptation changes the error, so the stored one no longer holds
    bands = origin.out_of_fold if step == "identify" else None
    output = float(np.sum(np.square(bands.output))) if bands is not None else 0.0
    if bands is None or not output > 0 or not len(x) or not np.ptp(x) > 0:
        return None
    ratio = np.sqrt(float(np.sum(np.square(bands.error))) / output)
    return Expected(float(100 * ratio * np.std(x) / np.ptp(x)), "from parts of the recordings that were left out")
