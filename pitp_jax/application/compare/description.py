"""Describe a model in plain values: kind, coefficients with units and standard errors, modes and effects."""

import math

import numpy as np

from ...common.numbers import number
from ...common.quantity import Units
from ...method.effects.physical import physical
from ...method.model.drive import ElectrodeLag
from ...method.model.encoder import ConstantEncoder, plain
from ...method.model.fitted import Fitted
from ...method.model.units import units_of


def modes(model: Fitted) -> list[dict]:
    """Return every real pole and pole pair of the nominal model: natural frequency in Hz and damping, ascending."""
    a = model.physical_coefficients
    roots = [complex(r) for r in np.roots(a[::-1]) if r.imag >= 0 and abs(r) > 0]
    return [
        {"natural_hz": abs(r) / (2 * math.pi), "damping": -r.real / abs(r), "oscillates": r.imag > 0}
        for r in sorted(roots, key=abs)
    ]


def describe(model: Fitted, units: Units | None = None) -> dict:
    """Describe a model as a dict, for `pitp info` and its JSON, in the model's units or in others."""
    domain, origin, units = model.domain, model.origin, units or units_of(model)
    factors, names = zip(*(units.coefficient(i) for i in range(model.order + 1)), strict=True)
    return {
        "kind": "identified" if isinstance(plain(model.encoder), ConstantEncoder) else "trained",
        "order": model.order,
        "input_map": model.input_map.name,
        "encoder": type(plain(model.encoder)).__name__.removesuffix("Encoder").lower(),
        "memory_states": model.memory.size,
        "effects": [_described(model, effect, units) for effect in model.effects],
        "electrode_lag_s": math.exp(float(model.drive.log_tau)) if isinstance(model.drive, ElectrodeLag) else None,
        "hold": model.hold,
        "substeps": model.substeps,
        "coefficients": (model.physical_coefficients * factors).tolist(),
        "coefficients_stderr": (np.array(origin.stderr) * factors).tolist() if origin.stderr else [None] * len(names),
        "coefficients_unit": list(names),
        "modes": modes(model),
        "offset": float(units.si.shown(model.output.offset)),
        "polarity": float(model.output.polarity),
        "output_unit": units.si.unit,
        "dt": model.dt,
        "voltage_range": units.input.shown(np.array(domain.voltage_range)).tolist(),
        "max_slew": float(units.input.shown(domain.slew)),
        "input_unit": units.input.unit,
        "identified_on": list(origin.identified_on),
        "training": origin.training,
        "fallback": fallback_line(origin.training),
    }


def fallback_line(training: dict | None) -> str | None:
    """Write which model replaces a failed training; None if the training did not fail."""
    if not training or not training.get("fallback"):
        return None
    if "itself" in training["fallback"]:
        return "Training failed: this file holds the linear model from which training started."
    return "Training failed in part: this file holds a model between the trained one and the linear model."


def _described(model: Fitted, effect, units: Units) -> dict:
    """Return name, form and parameters of an effect in the given units."""
    numbers = {p.name: physical(model, p, float(v), units) for p, v in effect.numbers()}
    parameters = {name: {"value": value, "unit": unit} for name, (value, unit) in numbers.items()}
    return {"effect": effect.name, "form": effect.form, "parameters": parameters}


def in_words(effect: dict) -> str:
    """Write an effect, as `describe` returns it, in one line."""
    numbers = ", ".join(f"{k} {number(v['value'])} {v['unit']}" for k, v in effect["parameters"].items())
    return f"{effect['effect']} ({effect['form']}): {numbers}"


def sensor_line(model: Fitted) -> str:
    """Write what the sensor reads at zero input, and whether it is reversed."""
    units = units_of(model)
    line = f"The sensor reads {units.output.text(float(model.output.offset))} at 0 {units.input.unit}"
    if model.output.polarity > 0:
        return f"{line}."
    # behind a linear input the sign of the gain is a matter of wiring
    how = "the actuator extends (reversed sensor)" if units.squared else f"the {units.input_word} increases"
    return f"{line} and decreases as {how}."
