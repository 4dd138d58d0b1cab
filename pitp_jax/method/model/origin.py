"""The origin of a model: its data and history as typed fields, which no compiled program contains."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from ..signal.excited import Table
from ..signal.long_record import LongRecord


@dataclass(frozen=True)
class OutOfFold:
    """Cross-validation errors of a nominal model on its identification records, by octaves of frequency.

    Attributes:
        edges_hz: of the bands, one more than those.
        error, output: rms of the residual, and of the output about its mean, in each band (output's base unit).
    """

    edges_hz: tuple[float, ...]
    error: tuple[float, ...]
    output: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Origin:
    """The data and the history from which a model was made.

    Attributes:
        displacement_unit, voltage_unit: units of the user's files.
        covariance: of ln a_0 ... ln a_n as identified, shape (n + 1, n + 1); empty if unknown or outdated.
        stderr: of a_0 ... a_n as identified; empty likewise.
        misfit: rms residual of the nominal on its records over their noise; infinite if unknown.
        noise: sensor noise of the identification records (rms, base unit); nan if unknown.
        level: e_rms of free runs of its own records, % of their range; nan if unknown.
        out_of_fold: errors of those records in fits without them, by band.
        remarks: open questions after those records, one sentence each.
        identified_on: names of those records.
        long_record: the longest of them, to which training fits slow creep.
        training: summary of the training, JSON values.
        adapted: one entry for every `adapt`: its records and the changed parameters.
        lineage: one entry for every step that made the model (`method.model.lineage`), oldest first.
        excited_input, excited_output: what excited the model (`signal.excited`), base units; empty where not known.
        errors: by frequency and amplitude (`expected_error.error_table`), base unit; empty where not known.
    """

    displacement_unit: str = "m"
    voltage_unit: str = "V"
    covariance: Float[np.ndarray, "tokens tokens"] = field(default_factory=lambda: np.zeros((0, 0)))
    stderr: tuple[float, ...] = ()
    misfit: float = float("inf")
    noise: float = float("nan")
    level: float = float("nan")
    out_of_fold: OutOfFold | None = None
    remarks: tuple[str, ...] = ()
    identified_on: tuple[str, ...] = ()
    long_record: LongRecord | None = None
    training: dict[str, Any] | None = None
    adapted: tuple[dict[str, Any], ...] = ()
    lineage: tuple[dict[str, Any], ...] = ()
    excited_input: Table = ()
    excited_output: Table = ()
    errors: Table = ()

    def of_other_coefficients(self) -> "Origin":
        """Return the origin without the standard errors, which belong to the coefficients as identified."""
        return replace(self, covariance=np.zeros((0, 0)), stderr=())
