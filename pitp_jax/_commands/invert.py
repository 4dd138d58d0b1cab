"""`pitp invert`: a wanted trajectory to the voltage that makes it."""

from .._invert.feedforward_plan import feedforward
from .._model_file.model_file import load
from .._record.reading import read_target
from .._record.writing import write_csv
from .compatibility import check_kind
from .console import number, say
from .outputs import check_files, staged_files, write_json


def invert(model, target, out, max_voltage, max_slew, json_file, reading) -> None:
    """Invert, write the voltage, and print how much of the target is out of reach.

    Args:
        model: model file.
        target: file with the wanted trajectory.
        out: CSV to write.
        max_voltage: limit in V, or None for what the model was trained on.
        max_slew: limit in V/s, or None for what the model was trained on.
        json_file: where to write the counts for machines, or None.
        reading: keyword arguments of `pitp.read_target`: columns, units, scale.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_files(out, json_file, inputs=[model, target])
    loaded = load(model)
    wanted = read_target(target, **reading)
    check_kind(loaded, model, wanted.displacement_unit, wanted.source)
    found = feedforward(loaded, wanted, max_voltage=max_voltage, max_slew=max_slew)
    for warning in found.warnings:
        say(f"warning: {' '.join(warning.split())}")
    result = {
        "samples": len(found.time),
        "infeasible": int(found.infeasible.sum()),
        "saturated": int(found.saturated.sum()),
        "outside_training_share": float(found.outside_training_share),
        "self_check_e_rms_percent": float(found.self_check_e_rms_percent),
    }
    columns = {
        "time_s": found.time,
        "voltage_V": found.voltage,
        "infeasible": found.infeasible,
        "saturated": found.saturated,
    }
    with staged_files(out, json_file) as (out_stage, json_stage):
        write_csv(out_stage, columns)
        if json_file:
            write_json(json_stage, result)
    low, high = float(found.voltage.min()), float(found.voltage.max())
    print(f"{result['samples']} samples of voltage, {number(low)} to {number(high)} V, in {out}")
    print(f"infeasible {result['infeasible']}, saturated {result['saturated']} samples")
    print(f"outside the trained region: {number(100 * result['outside_training_share'], 3)} % of the target")
    print(
        f"self-check (the model's own rollout, not a prediction of tracking): e_rms "
        f"{number(result['self_check_e_rms_percent'], 3)} %, by eq. 13 alone "
        f"{number(float(found.equation_e_rms_percent), 3)} %"
    )
