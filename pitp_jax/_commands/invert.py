"""`pitp invert`: a wanted trajectory to the voltage that makes it, as the rig's DAQ plays it."""

import numpy as np

from .._errors import BadInput
from .._invert.feedforward_plan import Feedforward, feedforward
from .._invert.playback import at_faster_rate, at_slower_rate
from .._model_file.model_file import load
from .._record.reading import read_target
from .._record.writing import write_csv
from .._table.units import from_base, to_base
from .compatibility import check_kind
from .console import number, say
from .outputs import check_outputs, staged

_UNITS = {"V": 1.0, "kV": 1e-3}
_ROUNDING = 0.01  # % of range: what a rollout in single precision and a plan by the same model agree to


def invert(
    model, target, out, max_voltage, max_slew, max_displacement, zero, start_input, rate, unit, input_scale, json_file,
    reading,
) -> None:  # fmt: skip
    """Invert, write the voltage, and print how much of the target is out of reach.

    Args:
        model: model file.
        target: file with the wanted trajectory.
        out: CSV to write; its clock starts at 0.
        max_voltage: limit in V, or None for what the model was trained on.
        max_slew: limit in V/s, or None for what the model was trained on.
        max_displacement: limit in mm from the displacement at 0 V, or None.
        zero: "rest", "sensor", or what the target is at 0 V, in its own unit.
        start_input: V at the first and last sample.
        rate: at which the voltage is played, Hz, or None for the target's.
        unit: of the voltage written, V or kV.
        input_scale: what the amplifier makes of one unit played; the voltage is divided by it.
        json_file: where to write the counts for machines, or None.
        reading: keyword arguments of `pitp.read_target`: columns, units, scale.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(out, json_file, inputs=[model, target])
    loaded = load(model)
    wanted = read_target(target, **reading)
    check_kind(loaded, model, wanted.displacement_unit, wanted.source)
    length = wanted.displacement_unit
    zero = zero if isinstance(zero, str) else float(to_base(zero, length))
    limits = {"max_voltage": max_voltage, "max_slew": max_slew, "zero": zero, "start_input": start_input}
    if max_displacement is not None:
        if wanted.displacement_unit in ("V", "mV"):
            raise BadInput(f"{target}: --max-displacement is in mm, and this output is in {wanted.displacement_unit}")
        limits["max_displacement"] = 1e-3 * max_displacement
    planned = at_faster_rate(feedforward(loaded, at_slower_rate(wanted, rate), **limits), rate)
    for warning in planned.warnings:
        say(f"warning: {' '.join(warning.split())}")
    result = {
        "samples": len(planned.time),
        "infeasible": int(planned.infeasible.sum()),
        "saturated": int(planned.saturated.sum()),
        "target_start_s": float(planned.time[np.flatnonzero(planned.target)[0]] - planned.time[0]),
        "target_end_s": float(planned.time[np.flatnonzero(planned.target)[-1]] - planned.time[0]),
        "outside_training_share": float(planned.outside_training_share),
        "self_check_e_rms_percent": float(planned.self_check_e_rms_percent),
    }
    columns = {
        "time_s": planned.time - planned.time[0],
        f"voltage_{unit}": planned.voltage * (_UNITS[unit] / input_scale),
        f"target_{length}": from_base(planned.wanted, length),
        "infeasible": planned.infeasible,
        "saturated": planned.saturated,
    }
    with staged(file=out, json_file=json_file, value=result) as stage:
        write_csv(stage, columns)
    _summarise(planned, out, input_scale)


def _summarise(planned: Feedforward, out: str, input_scale: float) -> None:
    low, high = float(planned.voltage.min()), float(planned.voltage.max())
    scaled = "" if input_scale == 1 else f" (divided by {number(input_scale)} in the file)"
    print(f"{len(planned.time)} samples of voltage, {number(low)} to {number(high)} V{scaled}, in {out}")
    own = float(planned.time[np.argmax(planned.target)])
    print(f"its clock starts at 0; the target begins at {own - planned.time[0]:.6g} s there, at {own:.6g} s of its own")
    print(f"infeasible {int(planned.infeasible.sum())}, saturated {int(planned.saturated.sum())} samples")
    if (
        planned.self_check_e_rms_percent >= _ROUNDING
    ):  # below, it says that the inversion inverts, not how far it tracks
        print(
            f"self-check (the model's own rollout, not a prediction of tracking): e_rms "
            f"{number(float(planned.self_check_e_rms_percent), 3)} %, by eq. 13 cut at the limits "
            f"{number(float(planned.equation_e_rms_percent), 3)} %"
        )
