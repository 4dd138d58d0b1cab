"""Write a model and its inverse as MATLAB functions without toolboxes, which also run in GNU Octave.

[y, s] = pitp_<name>_predict(u, s)        [u, s, flags] = pitp_<name>_inverse([y y' ... y^(n)], s)
"""

from pathlib import Path

import numpy as np

from ...method.model.fitted import Fitted
from ...method.model.model import Model
from . import plan as planning
from .c99 import fill, frame, substitutions
from .plan import Plan, Written, rate_error, whole_folder
from .writing import Writer


def export_matlab(
    model: Model | Fitted, folder: str | Path, *, name: str = "model", rate: float | None = None
) -> float | None:
    """Write a model and its inverse as two MATLAB functions into a new folder, in double precision.

    Args:
        model: as for `export_c`; folder, name and rate likewise.

    Returns:
        error due to a rate other than the model's, rms in % of the output's range; None at its own rate.

    Raises:
        BadInput: the folder exists, an invalid rate or precision, a model that it cannot export; nothing is written.

    Examples:
        >>> pitp.export_matlab(model, folder / "matlab")  # doctest: +SKIP
    """
    plan = planning.plan(model, name, rate, "double", np.inf)
    cost = rate_error(plan)
    with whole_folder(folder) as stage:
        for way, written, outputs in (("predict", plan.predict, 1), ("inverse", plan.inverse, 2)):
            values = {**substitutions(plan), "functions": functions(written, outputs)}
            fill(f"{way}.m", values, stage / f"pitp_{plan.name}_{way}.m")
        _write_check(plan, stage, frame(plan, cost))
    return cost


def _write_check(plan: Plan, folder: Path, values: dict[str, str]) -> None:
    """Write a README, and a MATLAB function that checks the functions with the test vector."""
    test, power = plan.test, " .^ 2" if plan.model.input_map.one_sided else ""
    rows = slice(test.every - 1, None, test.every)
    columns = {"voltage": test.voltage, "displacement": test.displacement, "planned": test.planned}
    values |= {name: ";\n".join(map(repr, column[rows].tolist())) for name, column in columns.items()}
    values["targets"] = ";\n".join(" ".join(map(repr, row)) for row in test.motion[rows].tolist())
    values["force_error"] = f"u{power} - planned{power}"
    fill("check.m", values, folder / f"pitp_{plan.name}_check.m")
    fill("README_matlab.md", values, folder / "README.md")


def functions(written: Written, outputs: int) -> str:
    """Write the MATLAB functions `start` and `step`, and the bodies of their loops, as text."""
    # local functions of the file: MATLAB exposes only the first one
    writer = Writer("matlab")
    text = writer.function("start", written.start, 0, 0) + writer.function("step", written.run, written.states, outputs)
    return text + "\n".join(writer.beside)
