"""Write a model and its inverse as C99: header, source, test vector, Makefile, example loop and README.

init(state, y0, u0)     predict_step(state, u) -> y     inverse_step(state, [y, y', ..., y^(n)]) -> u, flags
                        pi_step(state, [y, ..., y^(n)], measured), pi_target_step(state, y, measured) -> u, flags
"""

from pathlib import Path

import numpy as np

from ... import __version__
from ...common.quantity import grouped, per_second
from ...method.invert import steps
from ...method.model.coordinate import direction, sign
from ...method.model.coverage import trained_words
from ...method.model.fitted import Fitted
from ...method.model.model import Model
from . import plan as planning
from .differentiator import ALLOWED, BLOCKS
from .pi_gains import PIGains
from .plan import Plan, rate_error, whole_folder
from .writing import Writer

TEMPLATES = Path(__file__).parent / "templates"
_FORCES = {  # expressions of C by whether the force is the square of the voltage
    False: {
        "force_of": "u", "force_error": "u - (double)planned[k]", "target_error": "got - right",
        "target_force": "right",
    },
    True: {
        "force_of": "u * u", "force_error": "(u * u) - ((double)planned[k] * (double)planned[k])",
        "target_error": "(got * got) - (right * right)", "target_force": "right * right",
    },
}  # fmt: skip


def export_c(
    model: Model | Fitted, folder: str | Path, *, name: str = "model", rate: float | None = None,
    precision: str = "double", time_constant: float | None = None,
) -> float | None:  # fmt: skip
    """Write a model and its inverse as C99 into a new folder.

    Args:
        model: identified or trained, with any effects.
        folder: created; it must not exist.
        name: of the files and functions, `pitp_<name>`.
        rate: steps per second; None: the model's own.
        precision: "double" or "single".
        time_constant: of the closed loop of the PI steps, s; None: the default of `pi_gains`.

    Returns:
        Error due to a rate other than the model's, rms in % of the output's range; None at its own rate.

    Raises:
        BadInput: the folder exists, an invalid rate or precision, a model that it cannot export; nothing is written.

    Examples:
        >>> pitp.export_c(model, folder / "c")  # doctest: +SKIP
    """
    plan = planning.plan(model, name, rate, precision, time_constant)
    cost = rate_error(plan)
    with whole_folder(folder) as stage:
        write_sources(plan, stage)
        write_frame(plan, stage, cost)
    return cost


def write_sources(plan: Plan, folder: Path) -> None:
    """Write the C sources `pitp_<name>.h` and `pitp_<name>.c` into a folder."""
    values = substitutions(plan)
    fill("model.h", values, folder / f"{values['id']}.h")
    writer = Writer("c", plan.single)
    # written first, because helpers and tables that precede them in the file are known only afterwards
    written = []
    for what, step, outputs in (("predict", plan.predict, 1), ("inverse", plan.inverse, 2)):
        written.append(writer.function(f"{what}_start", step.start, 0, 0))
        written.append(writer.function(f"{what}_core", step.run, step.states, outputs))
    functions = "\n".join(written)
    values["functions"], values["beside"] = functions, "\n".join(writer.beside)
    values["helpers"] = writer.helpers(functions + values["beside"])
    square, n = plan.model.input_map.one_sided, plan.model.order
    values |= {
        "weights": table(writer, plan.differentiator.weights), "onward": table(writer, plan.reference()),
        "units": table(writer, plan.reference_time ** -np.arange(n + 1.0)).strip(),
        "sign": writer.number(float(sign(plan.model))), "sensor": writer.number(float(direction(plan.model))),
        "voltage_of": writer.call("sqrt", ["kept"]) if square else "kept", **_FORCES[square],
    }  # fmt: skip
    fill("model.c", values, folder / f"{values['id']}.c")


def write_frame(plan: Plan, folder: Path, cost: float | None) -> None:
    """Write the files beside the C sources: test vector, Makefile, example loop and README."""
    values, writer, test = frame(plan, cost), Writer("c", plan.single), plan.test
    rows = slice(test.every - 1, None, test.every)
    values |= _FORCES[plan.model.input_map.one_sided] | {
        "voltage": table(writer, test.voltage[rows]), "displacement": table(writer, test.displacement[rows]),
        "targets": table(writer, test.motion[rows]), "planned": table(writer, test.planned[rows]),
        "stroke": repr(float(test.motion[np.argmax(np.abs(test.motion[:, 0])), 0])),
        "slow": repr(plan.model.natural_frequency / 2), "target_tolerance": repr(ALLOWED),
        "period": f"{1e6 * plan.dt:.0f}_us", "hz": f"{1 / plan.dt:g}",
        "ahead_ms": f"{1e3 * plan.differentiator.look_ahead * plan.dt:.0f}_ms",
        "loop": loop_text(plan.gains), **sizes(plan),
    }  # fmt: skip
    for template in ("main.c", "Makefile", "loop.c", "teensy.ino", "README.md"):
        fill(template, values, folder / template)


def frame(plan: Plan, cost: float | None) -> dict[str, str]:
    """Return the values that README and check of any language contain, as text."""
    test, bounds = plan.test, plan.numbers
    full = max(float(np.ptp(test.displacement)), plan.stroke)
    # a reading far from zero is rounded, in float by more than the bound
    rounding = float(np.spacing(bounds.kind(np.abs(test.displacement).max()))) / full
    return substitutions(plan) | {
        "excited": trained_words(Fitted(plan.model, plan.origin)),
        "count": str(planning.SAMPLES), "every": str(test.every), "what": test.what, "range": repr(full),
        "force_range": repr(float(np.abs(test.planned).max() ** (2 if plan.model.input_map.one_sided else 1))),
        "tolerance": repr(bounds.predicted + rounding),
        "force_tolerance": repr(bounds.planned),
        "rate_note": "" if cost is None else f"Its own rate is {1 / plan.model.dt:g} Hz; running at this one changes "
        f"its predictions by {cost:.2g} % of range (e_rms).\n", "precision": plan.precision,
    }  # fmt: skip


def substitutions(plan: Plan) -> dict[str, str]:
    """Return the values that the C header contains, as text."""
    writer, model, units = Writer("c", plan.single), plan.model, plan.units
    per, stiffness = units.coefficient(0)
    low, high, slew = plan.voltages
    bottom, top = plan.displacements
    differentiates = plan.differentiator
    numbers = {
        "dt_number": plan.dt, "low": low, "high": high, "slew": slew, "bottom": bottom, "top": top, "ahead": plan.late,
        "rest": float(units.si.shown(model.output.offset)), "zero": 0.0, "p": per * plan.gains.p,
        "i": per * plan.gains.i,
        "track": 1 / plan.gains.time_constant, "smooth": plan.gains.smoothing,
        "dead": float(units.si.shown(plan.gains.tolerance)),
    }  # fmt: skip
    identifier = f"pitp_{plan.name}"
    return {key: writer.number(value) for key, value in numbers.items()} | {
        "id": identifier, "UP": identifier.upper(), "real": plan.numbers.real,
        "dt": f"{plan.dt:g}", "order": str(model.order), "tokens": str(model.order + 1),
        "model_states": str(plan.predict.states), "plan_states": str(plan.inverse.states),
        "blocks": str(BLOCKS), "block": str(differentiates.block), "window": str(BLOCKS * differentiates.block),
        "watchdog": str(plan.silent), "look_ahead": str(differentiates.look_ahead),
        "force_unit": units.force, "gain_unit": stiffness, "integral_unit": per_second(stiffness),
        "in": units.input.unit, "slew_unit": units.input.rate, "out": units.si.unit, "meaning": _meaning(plan),
        "derivative_unit": f"{grouped(units.si.unit)}/s^i", "reference_order": str(model.order + 1),
        "reference_ms": f"{1e3 * plan.reference_time:.3g}",
        "late": str(steps.predict(model, plan.dt).late),
        "title": f"{identifier}: written by pitp_jax {__version__}; do not edit, write it again.",
    }  # fmt: skip


def _meaning(plan: Plan) -> str:
    """Describe the origin and the direction of a displacement, in the words of headers and pages."""
    units, line = plan.units, f"0 at 0 {plan.units.input.unit}"
    if units.squared:
        return f"{line}, growing as the actuator extends whatever the sensor's direction"
    return f"{line}, with the sensor's sign"


def loop_text(gains: PIGains) -> str:
    """Describe the closed loop of the PI controller in one line."""
    if np.isinf(gains.time_constant):
        return "no controller, feedforward only"
    margins = f"gain margin {gains.gain_margin:.3g}, maximum sensitivity {gains.max_sensitivity:.3g}"
    return f"closed-loop time constant {gains.time_constant:.3g} s, {margins}"


def sizes(plan: Plan) -> dict[str, str]:
    """Estimate the load on a controller: RAM and constants (bytes), and operations per call."""
    width, n, block = plan.numbers.kind().itemsize, plan.model.order, plan.differentiator.block
    reals = 2 * plan.predict.states + plan.inverse.states + (BLOCKS + 1) * block + (n + 1) + 10
    predict, inverse = plan.predict.run.operations(), plan.inverse.run.operations()
    window = (2 * BLOCKS + 1) * (n + 1) + block
    tables = width * ((n + 2) * BLOCKS + (n + 1) * (n + 2)) + sum(
        width * one.run.constants() for one in (plan.predict, plan.inverse)
    )
    # a multiplication with its loads is about 10 bytes of Thumb-2 code; the frame of the steps takes 2 kB
    flash = tables + 10 * (predict + inverse) + 2048
    return {
        "ram": f"{width * reals + 16}", "flash": f"{flash / 1024:.0f}", "predict_operations": f"{predict}",
        "inverse_operations": f"{inverse}", "pi_operations": f"{inverse + predict}",
        "target_operations": f"{inverse + window}",
    }  # fmt: skip


def table(writer: Writer, values: np.ndarray) -> str:
    """Write the initialisers of an array as text, six numbers per line."""
    values = np.asarray(values, np.float64)
    if values.ndim > 1:
        return ",\n".join("    {" + table(writer, row).strip() + "}" for row in values)
    words = [writer.number(v) for v in values]
    return ",\n".join("    " + ", ".join(words[k : k + 6]) for k in range(0, len(words), 6))


def fill(template: str, values: dict[str, str], file: Path) -> None:
    """Write a template with its keys replaced into a file."""
    file.write_text(filled(template, values), encoding="utf-8")


def filled(template: str, values: dict[str, str]) -> str:
    """Read a template and replace every @key@ by its value."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text
