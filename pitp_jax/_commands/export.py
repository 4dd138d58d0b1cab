"""`pitp export`: a model and its inverse for the rig, as C99, as an FMU or as MATLAB functions."""

from .._errors import BadInput
from .._export import export_c, export_fmu, export_matlab
from .._model_file.model_file import load
from .console import number
from .outputs import check_files, write_json


def export(model, to, out, steps, precision, fmi, name, json_file=None) -> None:
    """Write the folder and say what is in it.

    Args:
        model: model file.
        to: "c", "fmu" or "matlab".
        out: folder to make.
        steps: per second, or None for the model's own.
        precision: "single" or "double", or None.
        fmi: version of the FMU's interface, or None.
        name: of files and functions.
        json_file: where to write what was made for machines, or None.

    Raises:
        BadInput: with nothing written.
    """
    if fmi is not None and to != "fmu":
        raise BadInput(f"--fmi {fmi} is for --to fmu")
    if precision == "single" and to == "matlab":
        raise BadInput("--precision single is for --to c and fmu: MATLAB computes in double")
    check_files(json_file, inputs=[model])
    loaded, options = load(model), {"name": name, "rate": steps}
    if to == "matlab":
        cost = export_matlab(loaded, out, **options)
    elif to == "fmu":
        cost = export_fmu(loaded, out, **options, precision=precision or "double", fmi=fmi or 2)
    else:
        cost = export_c(loaded, out, **options, precision=precision or "double")
    what = {"c": "C99 (`make` there checks it)", "fmu": f"FMU {fmi or 2}.0", "matlab": "MATLAB functions"}[to]
    rate = steps or 1 / loaded.dt
    print(f"pitp_{name}: {what}, {number(rate)} steps a second, in {out}")
    if json_file:
        told = {"to": to, "folder": str(out), "name": name, "rate_hz": rate, "rate_costs_e_rms_percent": cost}
        write_json(json_file, told)
    if cost is not None:
        own = number(1 / loaded.dt)
        print(f"at this rate instead of the model's {own} Hz it predicts {number(cost, 2)} % of range off (e_rms)")
