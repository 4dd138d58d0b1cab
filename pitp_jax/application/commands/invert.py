"""`pitp invert`: computes the voltage for a wanted motion, at the rate of the rig's DAQ."""

import numpy as np

from ...common.quantity import Quantity
from ...common.units import column_name, from_base
from ...files.model_file.model_file import load
from ...files.recordings.reading import read_target
from ...files.recordings.writing import write_csv
from ...method.invert.feedforward_plan import Feedforward, feedforward
from ...method.invert.playback import at_faster_rate
from ...method.invert.target import at_rate_of_model, at_slower_rate
from ...method.model.coverage import WORTH_A_LINE
from ...method.model.expected_error import expected_error
from ...method.model.fitted import Fitted
from ...method.model.units import units_of
from .amounts import in_base, limits_in_base, unit_of_kind, zero_in_base
from .console import number, say
from .outputs import check_outputs, staged
from .recordings import check_kind


def invert(
    model, target, out, max_voltage, max_slew, max_displacement, zero, start_input, rate, unit, input_scale, json_file,
    reading,
) -> None:  # fmt: skip
    """Compute the voltage for a wanted motion, write it, and print how much of the motion is out of reach.

    Args:
        model: model file.
        target: file with the wanted trajectory.
        out: CSV to write; its clock starts at 0.
        max_voltage, max_slew: limits of the input (`Amount`), or None for those of the model's recordings.
        max_displacement: limit from the position at 0 V, or None.
        zero: "rest", "sensor", or the target's value at 0 V, in its own unit.
        start_input: at the first and last sample, or None for 0.
        rate: at which the input is played, Hz, or None for the target's.
        unit: of the input written, or None for V or that of the model's records.
        input_scale: amplifier gain, by which the input is divided.
        json_file: where to write the counts as JSON, or None.
        reading: keyword arguments of `pitp.read_target`: columns, units, scale.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    check_outputs(out, json_file, inputs=[model, target])
    loaded = load(model)
    wanted = read_target(target, **reading)
    check_kind(loaded, model, wanted.displacement_unit, wanted.source)
    units, length = units_of(loaded), wanted.displacement_unit
    played = units.input if unit is None else Quantity(unit_of_kind(unit, f"--unit {unit}", units.input))
    limits = limits_in_base(units, max_voltage, max_slew, max_displacement) | {
        "zero": zero_in_base(zero, length),
        "start_input": in_base(start_input, "--start-input", units.input) or 0.0,
    }
    fine = at_rate_of_model(wanted, loaded.model.dt)
    slower = at_slower_rate(fine, rate)
    asked = slower is not fine
    planned = at_faster_rate(feedforward(loaded, slower if asked else wanted, resample=not asked, **limits), rate)
    for warning in planned.warnings:
        say(f"warning: {' '.join(warning.split())}")
    with staged(file=out, json_file=json_file, value=_counts(planned)) as stage:
        write_csv(stage, _columns(planned, played, length, input_scale))
    _summarise(planned, out, played, input_scale)
    _expect(loaded, planned)
    if planned.limits:
        print(f"limits: {planned.limits}")


def _counts(planned: Feedforward) -> dict:
    """Return the result's counts and errors for the JSON file."""
    own = np.flatnonzero(planned.target)
    return {
        "samples": len(planned.time),
        "infeasible": int(planned.infeasible.sum()),
        "saturated": int(planned.saturated.sum()),
        "target_start_s": float(planned.time[own[0]] - planned.time[0]),
        "target_end_s": float(planned.time[own[-1]] - planned.time[0]),
        "outside_training_share": float(planned.outside_training_share),
        "self_check_e_rms_percent": float(planned.self_check_e_rms_percent),
    }


def _columns(planned: Feedforward, played: Quantity, length: str, input_scale: float) -> dict[str, np.ndarray]:
    """Return the columns of the CSV: the input divided by the amplifier's gain, the target in the unit of its file."""
    return {
        "time_s": planned.time - planned.time[0],
        column_name("voltage", played.unit): played.shown(planned.voltage) / input_scale,
        f"target_{length.replace(' ', '')}": from_base(planned.wanted, length),
        "infeasible": planned.infeasible,
        "saturated": planned.saturated,
    }


def _expect(model: Fitted, planned: Feedforward) -> None:
    """Print the tracking error to expect, or that it is not known for this target."""
    if planned.outside_training_share > WORTH_A_LINE:
        print("expected tracking error: not known, because the model was not trained with such a motion")
    elif expected := expected_error(model, planned.wanted, float(planned.time[1] - planned.time[0])):
        # the model's error, and what its own simulation leaves of the target
        percent = float(np.hypot(expected.percent, planned.self_check_e_rms_percent))
        print(f"expected tracking error: {number(percent, 2)} % of range ({expected.source})")


def _summarise(planned: Feedforward, out: str, played: Quantity, input_scale: float) -> None:
    values = played.shown(planned.voltage)
    largest = number(float(values[np.argmax(np.abs(values))]))
    scaled = "" if input_scale == 1 else f" (divided by {number(input_scale)} in the file)"
    print(f"largest input {largest} {played.unit}{scaled}: {len(values)} samples in {out}")
    own = float(planned.time[np.argmax(planned.target)])
    print(f"in this file the target starts at {own - planned.time[0]:.6g} s, which is {own:.6g} s in the target's file")
    print(f"infeasible {int(planned.infeasible.sum())}, saturated {int(planned.saturated.sum())} samples")
    # an error below 0.01 % is rounding: it shows that the inversion is correct, not how well the rig will track
    if planned.self_check_e_rms_percent >= 0.01:
        print(
            f"self-check (the model simulated with this input; the rig may differ): error "
            f"{number(float(planned.self_check_e_rms_percent), 3)} % of range (e_rms); simply clipping the input "
            f"would give {number(float(planned.equation_e_rms_percent), 3)} %"
        )
