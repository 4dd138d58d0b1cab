"""`pitp export`: writes a model and its inverse as code for the rig: C99, an FMU or MATLAB functions."""

from dataclasses import asdict

from ...common.errors import refuse_if
from ...files.export.c99 import export_c, loop_text
from ...files.export.fmu import export_fmu
from ...files.export.matlab import export_matlab
from ...files.export.pi_gains import pi_gains
from ...files.model_file.model_file import load
from .console import number
from .outputs import check_outputs, write_json


def export(model, to, out, steps, precision, time_constant, fmi, name, json_file=None) -> None:
    """Export a model to a folder, and print what the folder holds.

    Args:
        model: model file.
        to: "c", "fmu" or "matlab".
        out: folder to make.
        steps: per second, or None for the model's own.
        precision: "single" or "double", or None.
        time_constant: of the closed loop of C's PI steps, s, or None.
        fmi: version of the FMU's interface, or None.
        name: of files and functions.
        json_file: where to write a description as JSON, or None.

    Raises:
        BadInput: with nothing written.
    """
    refuse_if(
        (fmi is not None and to != "fmu", f"--fmi {fmi} only works with --to fmu"),
        (
            time_constant is not None and to != "c",
            f"--time-constant {time_constant or 0:g} only works with --to c: FMU and MATLAB exports have no PI "
            "controller",
        ),
        (
            precision == "single" and to == "matlab",
            "--precision single only works with --to c and fmu: MATLAB computes in double precision",
        ),
    )
    check_outputs(json_file, inputs=[model])
    loaded, precise = load(model), {"precision": precision or "double"}
    # the function that exports, its own options, what it writes, and the command that checks it
    write, options, what, checked = {
        "c": (export_c, precise | {"time_constant": time_constant}, "C99", "`make`"),
        "fmu": (export_fmu, precise | {"fmi": fmi or 2}, f"FMU {fmi or 2}.0", "`python check.py`"),
        "matlab": (export_matlab, {}, "MATLAB functions", f"`pitp_{name}_check`"),
    }[to]
    cost, rate = write(loaded, out, name=name, rate=steps, **options), steps or 1 / loaded.dt
    print(f"pitp_{name}: {what} ({checked} there checks it), {number(rate)} steps a second, in {out}")
    gains = pi_gains(loaded, 1 / rate, time_constant) if to == "c" else None
    if gains is not None:
        print(f"PI on the force: {loop_text(gains)}")
    summary = {"to": to, "folder": str(out), "name": name, "rate_hz": rate, "rate_costs_e_rms_percent": cost}
    write_json(json_file, summary | {"pi": None if gains is None else asdict(gains)})
    if cost is not None:
        own = number(1 / loaded.dt)
        print(
            f"running at this rate instead of the model's {own} Hz changes its prediction by {number(cost, 2)} % of "
            "range (e_rms)"
        )
