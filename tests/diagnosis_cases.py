"""Hand-made diagnoses of every verdict, as a report may meet them."""

from dataclasses import replace

import numpy as np

from pitp_jax.method.diagnose.diagnosis import Diagnosis
from pitp_jax.method.diagnose.gap import Gap
from pitp_jax.method.diagnose.next_experiment import Experiment
from pitp_jax.method.diagnose.parts import Part, Parts
from pitp_jax.method.diagnose.result import Added, Ranked
from pitp_jax.method.diagnose.traces import Trace
from pitp_jax.method.effects import effect
from pitp_jax.method.model.fitted import Fitted, model_of
from pitp_jax.method.model.origin import Origin

T = np.arange(2000) / 500.0
NAMES = ("sweep<1>", "sine2", "sine&4")


def traces(error=2e-4):
    found = []
    for k, name in enumerate(NAMES):
        x = 1e-3 * np.sin(2 * np.pi * (1 + k) * T)
        off = error * (k + 1) / 3 * np.cos(2 * np.pi * (1 + k) * T) * (T > 2)
        measured = x.copy()
        measured[100:110] = np.nan
        voltage = 1000 * (1 - np.cos(2 * np.pi * (1 + k) * T))
        found.append(Trace(name, True, T + 10 * k, voltage, measured, x + off, x + off / 50))
    return tuple(found)


def where():
    def rows(key, edges, shares):
        pairs = zip(edges[:-1], edges[1:], shares, strict=True)
        return [{key: [float(a), float(b)], "share": float(s)} for a, b, s in pairs]

    tenths, last = np.linspace(0, 1, 11), [0.0] * 9 + [1.0]
    cells = [
        {"band_hz": [1.0, 4.0], "amplitude": [0.0, 5e-4], "share": 0.2, "flagged": False},
        {"band_hz": [1.0, 4.0], "amplitude": [5e-4, 1e-3], "share": 0.5, "flagged": True},
        {"band_hz": [4.0, 9.0], "amplitude": [5e-4, 1e-3], "share": 0.3, "flagged": True},
    ]
    return {
        "cells": cells,
        "records": dict(zip(NAMES, (0.1, 0.2, 0.7), strict=True)),
        "frequency": rows("band_hz", [0.0, 4.0, 9.0, 250.0], [0.1, 0.85, 0.05]),
        "time": rows("part", tenths, last),
        "displacement": rows("range", 1.2e-3 * tenths, last),
        "velocity": rows("range", 0.1 * tenths - 0.05, [0.1] * 10),
        "voltage": rows("range", 2000 * tenths, [0.1] * 10),
        "harmonics": {},
        "summary": "It stands out <here> & there.",
    }


def candidate(effect, form, parameters, closed):
    told = {name: {"value": value, "unit": unit, "stderr": e} for name, (value, unit, e) in parameters.items()}
    ci = None if closed is None else (closed - 0.02, closed + 0.01)
    return Ranked(effect, "family", form, told, 1.0, 1.5, closed, ci, 1.0)


def budget(*named):
    """Shares that add to one."""
    effects = {n: {"share": v, "ci95": [v - 0.05, v + 0.05], "probability": 0.97, "equivalent": []} for n, v in named}
    rest = 0.98 - sum(v for _, v in named)
    parts = {"nuisance": 0.01, "parameters": 0.0, "unnamed": 0.01, "unexplainable": rest}
    return {k: {"share": v, "ci95": [v - 0.01, v + 0.01]} for k, v in parts.items()} | {"effects": effects}


def part(effect, form, numbers, certainty="certain", **more):
    """A part of the model that is handed back; `numbers`: value, unit and interval by name."""
    told = {name: {"value": value, "unit": unit, "ci95": ci95} for name, (value, unit, ci95) in numbers.items()}
    return Part(effect, form, told, 0.9, 0.97, certainty, **more)


def explained(actuator):
    """An `explained` diagnosis by an electrode's lag, in mm."""
    model = replace(actuator, effects=(effect("electrode_rc", tau=0.012345),))
    return Diagnosis(
        verdict="explained", effects=("electrode_rc",), equivalent=(), probability={"electrode_rc": 0.97},
        added=(Added("electrode_rc", "one lag", {"tau": {"value": 0.012345, "unit": "s", "stderr": 2.1e-4}}),),
        budget=budget(("electrode_rc", 0.9)), handed_back=("electrode_rc",),
        parts=Parts((part("electrode_rc", "one lag", {"tau": (0.012345, "s", [0.01193, 0.01276])}),)),
        gap=Gap(8.0, 0.41, 8.0, 0.4, "a <band>", 0.995, (0.98, 1.0)),
        ranking=(
            candidate("electrode_rc", "one lag", {"tau": (0.012345, "s", 2.1e-4)}, 0.995),
            candidate("delay", "pure", {"time": (0.011, "s", 1e-3)}, 0.62),
            candidate("voltage_clip", "hard", {"inverse": (2e-4, "1/V", None)}, 0.3),
            candidate("drag", "quadratic", {"c": (4.2e7, "V^2 s^2/m^2", None)}, -0.4),
        ),
        where=where(), next_experiment=None, fitted=NAMES, heldout=NAMES, shift=np.ones(3), traces=traces(),
        folds=(*((name,) for name in NAMES), NAMES),
        model=Fitted(model_of(model), Origin(displacement_unit="mm")),
    )  # fmt: skip


def tied(found):
    """The same, not told from a delay, with an experiment that would."""
    experiment = Experiment(("electrode_rc", "delay"), "a sine of 5 Hz", T, 900 * np.sin(10 * np.pi * T), 12.3)
    return replace(found, equivalent=("delay",), next_experiment=experiment)


def no_gap(found):
    """The model's error is noise."""
    gap = Gap(0.41, 0.41, 0.41, 0.4, "a band", None, None)
    ranking = tuple(replace(r, closed_fraction=None, ci95=None) for r in found.ranking)
    model = replace(found.model, effects=())
    return replace(
        found,
        verdict="no_gap",
        effects=(),
        gap=gap,
        ranking=ranking,
        model=model,
        added=(),
        handed_back=(),
        parts=Parts(),
        budget=budget(),
    )


def unknown(found):
    """Nothing helps."""
    gap, model = Gap(8.0, 7.9, 8.0, 0.4, "a band", 0.01, (0.0, 0.02)), replace(found.model, effects=())
    ranking = tuple(replace(r, closed_fraction=0.01) for r in found.ranking)
    return replace(
        found,
        verdict="unknown",
        effects=(),
        gap=gap,
        ranking=ranking,
        model=model,
        added=(),
        handed_back=(),
        parts=Parts(),
        budget=budget(),
        reason="No effect in the catalogue improves the fit significantly.",
    )
