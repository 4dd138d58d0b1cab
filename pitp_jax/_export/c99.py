"""C99: one header, one source, a test vector, a Makefile, a loop and a page that says how to use them.

init(state, y0, u0)     predict_step(state, u) -> y     inverse_step(state, [y, y', ..., y^(n)]) -> u, flags
"""

from pathlib import Path

import numpy as np

from .._invert.pi_control import KV_PER_MM
from .._model.fitted import Fitted
from .._model.model import Model
from . import plan as planning
from . import steps
from .plan import Plan, rate_error, whole_folder
from .writing import Writer

TEMPLATES = Path(__file__).parent / "templates"


def export_c(
    model: Model | Fitted,
    folder: str | Path,
    *,
    name: str = "model",
    rate: float | None = None,
    precision: str = "double",
) -> float | None:
    """Write a model and its inverse as C99 into a new folder.

    Args:
        model: identified or trained, with any effects.
        folder: made; it must not exist.
        name: of the files and functions, `pitp_<name>`.
        rate: steps per second; None: the model's own.
        precision: "double" or "single".

    Returns:
        What another rate than the model's costs, e_rms in %; None at its own rate.

    Raises:
        BadInput: with nothing written.

    Examples:
        >>> pitp.export_c(model, folder / "c")  # doctest: +SKIP
    """
    plan = planning.plan(model, name, rate, precision)
    cost = rate_error(plan)
    with whole_folder(folder) as stage:
        write_sources(plan, stage)
        write_frame(plan, stage, cost)
    return cost


def write_sources(plan: Plan, folder: Path) -> None:
    """`pitp_<name>.h` and `pitp_<name>.c`."""
    values = substitutions(plan)
    (folder / f"{values['id']}.h").write_text(filled("model.h", values), encoding="utf-8")
    writer = Writer("c", plan.single)
    functions = "\n".join(
        writer.function(f"{what}_{part}", code, states, outputs)
        for what, written, count in (("predict", plan.predict, 1), ("inverse", plan.inverse, 2))
        for part, code, states, outputs in (
            ("start", written.start, 0, 0),
            ("core", written.run, written.states, count),
        )
    )
    values["functions"], values["beside"] = functions, "\n".join(writer.beside)
    values["helpers"] = writer.helpers(functions + values["beside"])
    values["weights"] = table(writer, plan.weights())
    (folder / f"{values['id']}.c").write_text(filled("model.c", values), encoding="utf-8")


def write_frame(plan: Plan, folder: Path, cost: float | None) -> None:
    """What stands around the sources: test vector, Makefile, loop, README."""
    values, writer, test = substitutions(plan), Writer("c", plan.single), plan.test
    precision = "single" if plan.single else "double"
    square = plan.model.input_map.one_sided
    values |= {
        "count": str(planning.SAMPLES), "what": test.what, "voltage": table(writer, test.voltage),
        "displacement": table(writer, test.displacement), "targets": table(writer, test.motion),
        "planned": table(writer, test.planned), "range": repr(float(np.ptp(test.displacement))),
        "force_error": "(u * u) - ((double)planned[k] * (double)planned[k])" if square else "u - (double)planned[k]",
        "force_range": repr(float(np.abs(test.planned).max() ** (2 if square else 1))),
        "tolerance": repr(planning._PREDICTED[precision]), "force_tolerance": repr(planning._PLANNED[precision]),
        "rest_number": repr(float(plan.model.output.offset)),
        "stroke": repr(float(plan.model.output.polarity) * float(np.ptp(test.motion[:, 0]))),
        "rate_note": "" if cost is None else f"Its own rate is {1 / plan.model.dt:g} Hz; at this one its "
        f"predictions are {cost:.2g} % of the range away (e_rms).\n",
        "period": f"{1e6 * plan.dt:.0f}_us", "hz": f"{1 / plan.dt:g}", "precision": precision,
        "ahead_ms": f"{1e3 * plan.look_ahead * plan.dt:.0f}_ms",
    }  # fmt: skip
    for template in ("main.c", "Makefile", "loop.c", "teensy.ino", "README.md"):
        (folder / template).write_text(filled(template, values), encoding="utf-8")


def substitutions(plan: Plan) -> dict[str, str]:
    """What the header says, as text."""
    writer, model = Writer("c", plan.single), plan.model
    low, high, slew = plan.voltages
    bottom, top = plan.displacements
    numbers = {
        "dt_number": plan.dt, "low": low, "high": high, "slew": slew, "bottom": bottom, "top": top, "ahead": plan.late,
        "rest": float(model.output.offset), "zero": 0.0, "p": 0.1 * KV_PER_MM, "i": 0.3 * KV_PER_MM,
    }  # fmt: skip
    identifier = f"pitp_{plan.name}"
    return {key: writer.number(value) for key, value in numbers.items()} | {
        "id": identifier, "UP": identifier.upper(), "real": "float" if plan.single else "double",
        "dt": f"{plan.dt:g}", "order": str(model.order), "tokens": str(model.order + 1),
        "model_states": str(plan.predict.states), "plan_states": str(plan.inverse.states),
        "window": str(plan.weights().shape[1]), "watchdog": str(plan.silent), "look_ahead": str(plan.look_ahead),
        "late": str(steps.predict(model, plan.dt).late),
        "title": f"{identifier}: written by pitp_jax; do not edit, write it again.",
    }  # fmt: skip


def table(writer: Writer, values: np.ndarray) -> str:
    """Initialisers of an array, six numbers to a line."""
    values = np.asarray(values, np.float64)
    if values.ndim > 1:
        return ",\n".join("    {" + table(writer, row).strip() + "}" for row in values)
    words = [writer.number(v) for v in values]
    return ",\n".join("    " + ", ".join(words[k : k + 6]) for k in range(0, len(words), 6))


def filled(template: str, values: dict[str, str]) -> str:
    """A template with every @key@ replaced."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    for key, value in values.items():
        text = text.replace(f"@{key}@", value)
    return text
