"""A model in plain values: what it is, its numbers with units and standard errors, its modes and its effects."""

import math

import numpy as np

from .._effects.physical import physical
from .._model.encoder import ConstantEncoder, plain
from .._model.fitted import Fitted
from .._table.units import base_unit
from .numbers import number


def coefficient_units(model: Fitted) -> list[str]:
    """Units of a_0 ... a_n: force (V^2, or V for a linear input) times s^i over the output's."""
    output = base_unit(model.origin.displacement_unit)
    return [f"{model.input_map.unit}{('', ' s', f' s^{i}')[min(i, 2)]}/{output}" for i in range(model.order + 1)]


def modes(model: Fitted) -> list[dict]:
    """Every real pole and pole pair of the nominal: natural frequency in Hz and damping, ascending."""
    a = model.physical_coefficients
    roots = [complex(r) for r in np.roots(a[::-1]) if r.imag >= 0 and abs(r) > 0]
    return [
        {"natural_hz": abs(r) / (2 * math.pi), "damping": -r.real / abs(r), "oscillates": r.imag > 0}
        for r in sorted(roots, key=abs)
    ]


def describe(model: Fitted) -> dict:
    """A model in plain values, for `pitp info` and its JSON."""
    domain, origin = model.domain, model.origin
    return {
        "kind": "identified" if isinstance(plain(model.encoder), ConstantEncoder) else "trained",
        "order": model.order,
        "input_map": model.input_map.name,
        "encoder": type(plain(model.encoder)).__name__.removesuffix("Encoder").lower(),
        "memory_states": model.memory.size,
        "effects": [_described(model, effect) for effect in model.effects],
        "hold": model.hold,
        "substeps": model.substeps,
        "coefficients": model.physical_coefficients.tolist(),
        "coefficients_stderr": list(origin.stderr) or [None] * (model.order + 1),
        "coefficients_unit": coefficient_units(model),
        "modes": modes(model),
        "offset": float(model.output.offset),
        "polarity": float(model.output.polarity),
        "output_unit": base_unit(origin.displacement_unit),
        "dt": model.dt,
        "voltage_range": domain.voltage_range.tolist(),
        "max_slew": float(domain.slew),
        "identified_on": list(origin.identified_on),
        "training": origin.training,
        "fallback": fallback_line(origin.training),
    }


def fallback_line(training: dict | None) -> str | None:
    """Return the sentence that says what stands in for a failed training, or None where none failed."""
    if not training or not training.get("fallback"):
        return None
    if "itself" in training["fallback"]:
        return "Training failed: this file holds the linear model from which training started."
    return "Training failed in part: this file holds a model between the trained one and the linear model."


def _described(model: Fitted, effect) -> dict:
    """Name, form and numbers in physical units."""
    numbers = {p.name: physical(model, p, float(v)) for p, v in effect.numbers()}
    return {
        "effect": effect.name,
        "form": effect.form,
        "parameters": {name: {"value": value, "unit": unit} for name, (value, unit) in numbers.items()},
    }


def in_words(effect: dict) -> str:
    """An effect of `describe` in one line."""
    numbers = ", ".join(f"{k} {number(v['value'])} {v['unit']}" for k, v in effect["parameters"].items())
    return f"{effect['effect']} ({effect['form']}): {numbers}"
