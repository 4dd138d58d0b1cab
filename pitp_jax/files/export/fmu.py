"""Write an FMU (Functional Mock-up Interface 2.0 or 3.0) for co-simulation in fixed steps.

    voltage, held from t to t + DT   ->  displacement(t + DT)
    target, target_1, ... target_n   ->  command, flags            (`inverse_step`)

Beside the FMU stand a page, a run of it for cross checks (`_in.csv`, `_ref.csv`, `_ref.opt`) and `check.py`, which
plays it.
"""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from shutil import rmtree, which
from uuid import UUID, uuid5
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from ...common.errors import BadInput
from ...common.quantity import Quantity, per_second
from ...common.units import kind_of
from ...method.model.fitted import Fitted
from ...method.model.model import Model
from . import plan as planning
from .c99 import fill, filled, frame, substitutions, write_sources
from .plan import Plan, half_step, played, rate_error, whole_folder

_BASES = {  # powers of SI's base units, by kind of quantity
    "voltage": {"kg": 1, "m": 2, "s": -3, "A": -1}, "current": {"A": 1}, "length": {"m": 1}, "speed": {"m": 1, "s": -1},
    "acceleration": {"m": 1, "s": -2}, "force": {"kg": 1, "m": 1, "s": -2}, "torque": {"kg": 1, "m": 2, "s": -2},
    "pressure": {"kg": 1, "m": -1, "s": -2}, "angle": {"rad": 1}, "angular speed": {"rad": 1, "s": -1},
    "temperature": {"K": 1},
}  # fmt: skip
# Functions that an importer looks up in every FMU; they return an error, because this kind does not need them.
_MISSING = {
    2: "SetInteger GetBoolean SetBoolean GetString SetString GetDirectionalDerivative SetRealInputDerivatives "
    "GetRealOutputDerivatives CancelStep GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus",
    3: "EnterEventMode GetFloat32 GetInt8 GetUInt8 GetInt16 GetUInt16 GetUInt32 GetInt64 GetUInt64 GetBoolean "
    "GetString GetBinary GetClock SetFloat32 SetInt8 SetUInt8 SetInt16 SetUInt16 SetInt32 SetUInt32 SetInt64 "
    "SetUInt64 SetBoolean SetString SetBinary SetClock GetNumberOfVariableDependencies GetVariableDependencies "
    "GetDirectionalDerivative GetAdjointDerivative EnterConfigurationMode ExitConfigurationMode GetIntervalDecimal "
    "GetIntervalFraction GetShiftDecimal GetShiftFraction SetIntervalDecimal SetIntervalFraction SetShiftDecimal "
    "SetShiftFraction EvaluateDiscreteStates UpdateDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep "
    "SetTime SetContinuousStates GetContinuousStateDerivatives GetEventIndicators GetContinuousStates "
    "GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates EnterStepMode "
    "GetOutputDerivatives ActivateModelPartition",
}

_FINER = 16  # steps of the reference per step of the FMU


def export_fmu(
    model: Model | Fitted, folder: str | Path, *, name: str = "model", rate: float | None = None,
    precision: str = "double", fmi: int = 2,
) -> float | None:  # fmt: skip
    """Write `pitp_<name>.fmu` into a new folder: C sources, and a binary on Linux with a C compiler.

    Args:
        model: identified or trained, with any effects.
        folder: created; it must not exist.
        name: of the files, `pitp_<name>`.
        rate: steps per second; None: the model's own.
        precision: "double" or "single".
        fmi: version of the interface, 2 or 3.

    Returns:
        error due to a rate other than the model's, rms in % of the output's range; None at its own rate.

    Raises:
        BadInput: the folder exists, an invalid rate or precision, a model that it cannot export; nothing is written.

    Examples:
        >>> pitp.export_fmu(model, folder / "fmu", fmi=3)  # doctest: +SKIP
    """
    if fmi not in _MISSING:
        raise BadInput(f"--fmi {fmi}: is not 2 or 3")
    # A co-simulation sets an input at the start of a step and holds it; the next value is unknown.
    plan = planning.plan(model, name, rate, precision, np.inf, held=True)
    cost = rate_error(plan)
    with whole_folder(folder) as stage:
        inside = stage / "inside"
        (inside / "sources").mkdir(parents=True)
        values = _values(plan, fmi)
        write_sources(plan, inside / "sources")
        values["api"] = filled(f"fmi{fmi}.c", values)
        fill("fmu.c", values, inside / "sources" / "fmu.c")
        fill(f"fmi{fmi}.xml", values, inside / "modelDescription.xml")
        if fmi == 3:
            fill("build.xml", values, inside / "sources" / "buildDescription.xml")
        _build(inside, values["id"], fmi)
        with ZipFile(stage / f"{values['id']}.fmu", "w", ZIP_DEFLATED) as archive:
            for file in sorted(p for p in inside.rglob("*") if p.is_file()):  # in the same order on every file system
                archive.write(file, file.relative_to(inside).as_posix())
        rmtree(inside)
        _write_check(plan, stage, values | frame(plan, cost))
    return cost


def _values(plan: Plan, fmi: int) -> dict[str, str]:
    values, n, units = substitutions(plan), plan.model.order, plan.units
    drive, motion = units.input.unit, units.si.unit
    named = [("target", motion, f"wanted {units.output_word}, {values['meaning']}")]
    named += [(f"target_{i}", per_second(motion, i), f"derivative {i} of the target") for i in range(1, n + 1)]
    starts = [0.0, 0.0, 0.0, *[0.0] * n, 0.0, 0.0, 0.0]
    rows = [("voltage", drive, f"{units.input_word}, held over a step", "input", 0.0)]
    rows += [(*row, "input", 0.0) for row in named]
    rows += [("displacement", motion, f"{units.output_word}, {values['meaning']}", "output", None)]
    rows += [("command", drive, f"{units.input_word} for the target, within the limits", "output", None)]
    variables = ""
    for k, (word, unit, text, causality, start) in enumerate(rows, start=1):
        begin = "" if start is None else f' start="{start!r}"'
        fields = {"name": word, "unit": unit, "text": text, "causality": causality, "start": begin, "vr": str(k)}
        variables += filled(f"fmi{fmi}_variable.xml", fields)
    bases = [(drive, _base(units.input)), ("s", 's="1"')]
    bases += [(row[1], _base(units.si, i)) for i, row in enumerate(named)]
    units = "".join(f'    <Unit name="{unit}"><BaseUnit {base}/></Unit>\n' for unit, base in dict.fromkeys(bases))
    # the token must change with anything an importer compiled against, and with nothing else
    text = "".join((filled("fmu.c", {}), *values.values(), str(fmi)))
    stubs = "".join(
        f"EXPORT int fmi{fmi}{missing}(void *m) {{ return (void)m, ERROR; }}\n" for missing in _MISSING[fmi].split()
    )
    return values | {
        "fmi": f"{fmi}.0", "stubs": stubs, "variables": variables, "units": units, "tokens_end": str(n + 2),
        "starts": ", ".join(map(repr, starts)), "token": f"{{{uuid5(UUID(int=0), text)}}}",
        "flags": str(n + 5), "out_first": str(n + 4), "step": repr(plan.dt), "vr_y": str(n + 3), "vr_u": str(n + 4),
        "stop": repr(len(plan.test.voltage) * plan.dt), "index_y": str(n + 4), "index_u": str(n + 5),
        "index_f": str(n + 6),
    }  # fmt: skip


def _base(quantity: Quantity, times: int = 0) -> str:
    """Return the base unit of a quantity's time derivative (order `times`), as attributes of a model description."""
    powers = dict(_BASES.get(kind_of(quantity.unit) or "", {}))
    powers["s"] = powers.get("s", 0) - times
    words = [f'{unit}="{power}"' for unit, power in powers.items() if power]
    return " ".join(words + ([f'factor="{quantity.factor!r}"'] if quantity.factor != 1 else []))


def _build(inside: Path, name: str, fmi: int) -> None:
    """Compile the Linux binary if this machine can; other systems compile the sources on import."""
    compiler = which("cc") or which("gcc") or which("clang")
    if not sys.platform.startswith("linux") or compiler is None or sys.maxsize < 2**32:
        return
    place = inside / "binaries" / ("linux64" if fmi == 2 else "x86_64-linux")
    place.mkdir(parents=True)
    command = [compiler, "-O2", "-std=c99", "-shared", "-fPIC", "-fvisibility=hidden", "-o", place / f"{name}.so"]
    sources = [f"{name}.c", "fmu.c"]
    subprocess.run([*command, *sources, "-lm"], cwd=inside / "sources", check=True, capture_output=True)


def _write_check(plan: Plan, folder: Path, values: dict[str, str]) -> None:
    """Write the test vector as FMI cross-check files, a README, and a script that checks the FMU."""
    test, name = plan.test, values["id"]
    time = np.arange(len(test.voltage)) * plan.dt
    power = "**2" if plan.model.input_map.one_sided else ""
    values |= {"force_error": f"u{power} - planned{power}"}
    fill("check_fmu.txt", values, folder / "check.py")
    words = ["target", *(f"target_{i}" for i in range(1, plan.model.order + 1))]
    _csv(folder / f"{name}_in.csv", ["time", "voltage", *words], [time, test.voltage, *test.motion.T])
    (y,) = played(plan.predict_step(held=True), test.voltage, 0.0)
    # the same held voltage, integrated separately in steps of a sixteenth
    fine = replace(plan, dt=plan.dt / _FINER).predict_step(held=True)
    (held,) = played(fine, np.repeat(test.voltage, _FINER), 0.0)
    rows = [np.append(time, time[-1] + plan.dt)[1:], y, test.planned, held[_FINER - 1 :: _FINER]]
    _csv(folder / f"{name}_ref.csv", ["time", "displacement", "command", "held"], rows)  # at the end of their step
    values |= {"half_ms": f"{500 * plan.dt:.3g}", "half_percent": f"{100 * half_step(plan):.2g}"}
    fill("README_fmu.md", values, folder / "README.md")
    options = {"StartTime": 0.0, "StopTime": len(time) * plan.dt, "StepSize": plan.dt, "RelTol": 0.0}
    (folder / f"{name}_ref.opt").write_text("".join(f"{k},{v!r}\n" for k, v in options.items()), encoding="utf-8")


def _csv(file: Path, header: list[str], columns: list[np.ndarray]) -> None:
    rows = (",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True))
    file.write_text("\n".join([",".join(header), *rows]) + "\n", encoding="utf-8")
