"""Print text about a model, for `identify`, `fit` and `info`."""

from ...common.numbers import finite
from ...common.quantity import Units
from ...common.units import from_base
from ...files.recordings.remarks import counted
from ...method.model.fitted import Fitted
from ...method.model.units import units_of
from ...method.signal.initial_state import Beginning
from ..compare.description import in_words, sensor_line
from .console import Table, number, print_table


def print_model(model: Fitted, summary: dict) -> None:
    """Print a model: its order, coefficients, modes, effects, and the sensor's offset and direction."""
    units = units_of(model)
    print(f"{summary['kind']} model of order {summary['order']}, input map {summary['input_map']}")
    if summary["fallback"]:
        print(summary["fallback"])
    for effect in summary["effects"]:
        print(f"with {in_words(effect)}")
    if summary["electrode_lag_s"]:
        print(f"learned lag of the electrode: {number(1e3 * summary['electrode_lag_s'], 3)} ms")
    if summary["kind"] == "trained":
        print("coefficients and modes of the linear model from which training started:")
    rows = zip(summary["coefficients"], summary["coefficients_stderr"], summary["coefficients_unit"], strict=True)
    table = [(f"a{i}", number(a, 6), number(e, 2), unit) for i, (a, e, unit) in enumerate(rows)]
    print_table(Table(("coefficient", "value", "std. error", "unit"), table))
    for mode in summary["modes"]:
        kind = "mode" if mode["oscillates"] else "real pole"
        print(f"{kind} at {number(mode['natural_hz'])} Hz, damping {number(mode['damping'], 3)}")
    holds = {"foh": "linear", "zoh": "held", "bandlimited": "band-limited"}
    hold = f"{holds[summary['hold']]} between samples (hold {summary['hold']})"
    steps = "one Runge-Kutta step" if summary["substeps"] == 1 else f"{summary['substeps']} Runge-Kutta steps"
    print(f"input {hold}; {steps} per sample of {number(summary['dt'])} s")
    print(sensor_line(model))
    print(
        f"{units.input_word} of the recordings: {units.input.range_text(*model.domain.voltage_range)}, "
        f"at most {units.input.rate_text(model.domain.slew)}"
    )
    if summary["identified_on"]:
        print(f"identified on {listed(summary['identified_on'])}")
    if summary["training"]:
        _print_training(summary)


def _print_training(summary: dict) -> None:
    training = summary["training"]
    cut = ", interrupted" if training.get("interrupted") else ""
    long = training.get("creep_held_to_s")
    held = f", creep also fitted to {number(long, 3)} s of the recordings of the nominal model" if long else ""
    hertz = training.get("second_mass_hz")
    mass = f", and a second mass at {number(hertz, 3)} Hz" if hertz else ""
    print(
        f"trained on {listed(training.get('records', []))} ({training.get('samples', '?')} samples) in "
        f"{number(training.get('seconds'), 3)} s{cut}{held}; encoder {summary['encoder']}, "
        f"{summary['memory_states']} memory states{mass}"
    )
    print_history(training.get("history", []))


def print_history(history) -> None:
    """Print the losses of each training stage, one line per entry."""
    for entry in history:
        parts = [f"{k} {_short(v)}" for k, v in entry.items() if k != "stage"]
        print(f"  stage {entry.get('stage', '?')}: {', '.join(parts)}")


def _short(value) -> str:
    if isinstance(value, (list, tuple)):
        return " to ".join(map(_short, value))
    return number(value) if isinstance(value, float) else str(value)


def print_beginnings(beginnings: dict[str, Beginning], units: Units) -> None:
    """Print which records do not start at rest, and which sensor offsets and directions are unusual."""
    for kind, line in (
        ("held", "start settled at a held input: {}"),
        ("moving", "start moving (initial state estimated): {}"),
    ):
        if names := [name for name, b in beginnings.items() if b.begins == kind]:
            print(line.format(listed(names)))
    if not any(b.begins == "rest" for b in beginnings.values()):
        print(
            f"No recording starts at rest at 0 {units.input.unit}: the sensor's reading there is extrapolated by the "
            "model."
        )
    print_sensors(beginnings, units)


def print_sensors(beginnings: dict[str, Beginning], units: Units) -> None:
    """Print which records have a reversed sensor, and the sensor offsets if they differ between records."""
    turned, unit = [name for name, b in beginnings.items() if b.direction < 0], units.output.unit
    if turned and units.squared:
        print(f"reversed sensor (its reading decreases as the actuator extends): {listed(turned)}")
    elif 0 < len(turned) < len(beginnings):
        print(f"output that decreases as the input increases: {listed(turned)}")
    if len({b.group for b in beginnings.values()}) > 1:
        rows = [(name, *(finite(from_base(v, unit)) for v in (b.zero, b.stderr))) for name, b in beginnings.items()]
        print("sensor offset of each recording:")
        print_table(Table(("record", f"zero ({unit})", "+-"), rows))


def listed(names, most: int = 4) -> str:
    """Write a count of records and the first names: `3 recordings (a, b, c)`."""
    shown = ", ".join(names[:most]) + (", ..." if len(names) > most else "")
    return f"{counted(len(names), 'recording')} ({shown})"
