"""A simulator's numbers and the robot's, in the names and units of MuJoCo, PhysX and URDF.

    a_2 q'' + a_1 q' + a_0 q + Fc sgn(q') = c(t - T)                        c: position command, same unit as q
    J = Kp a_2,  D = Kp a_1,  frictionloss = Kp Fc,  gain = 1 / a_0           Kp: of the simulator's position controller

A command is held from its time stamp to the next: where the model takes it as a line between samples, half a sample
of each log is taken off its delay. From position commands alone only these ratios to Kp are known; with a torque or
force as input the a_i are J, D, K themselves. D holds the controller's own damping, J the link's inertia: it is the
difference that is to be added.

Names: MuJoCo XML reference (joint, actuator); PhysxJointAxisAPI; Isaac Lab's actuator configurations; URDF <joint>.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from .._effects.physical import physical
from .._model.fitted import Fitted
from .._model.model import Model
from .._record.record import Record
from .._table.units import base_unit


@runtime_checkable
class Answer(Protocol):
    """What is read off a `Diagnosis` here."""

    @property
    def model(self) -> Model | Fitted: ...
    @property
    def effects(self) -> tuple[str, ...]: ...
    @property
    def added(self) -> Sequence: ...
    @property
    def ranking(self) -> Sequence: ...


@dataclass(frozen=True)
class Names:
    """What a quantity is called in plain words and in three programs; a dash where one has no such number."""

    words: str
    mujoco: str = "-"
    physx: str = "-"
    urdf: str = "-"


_NAMES = {
    "gain": Names("steady output per command", "scale of ctrl", "scale of the target"),
    "stiffness": Names("spring", "joint stiffness", "-", "-"),
    "damping": Names("viscous damping", "joint damping", "viscousFrictionCoefficient", "dynamics damping"),
    "inertia": Names("inertia", "joint armature", "armature", "-"),
    ("coulomb_friction", "level"): Names(
        "dry friction", "joint frictionloss", "dynamicFrictionEffort", "dynamics friction"
    ),
    ("coulomb_friction", "rise"): Names(
        "static over dry friction, less 1", "-", "staticFrictionEffort: dry friction (1 + it)"
    ),
    ("coulomb_friction", "speed"): Names("speed over which static friction falls"),
    ("delay", "time"): Names("delay of the command", "shift ctrl by it", "DelayedPDActuatorCfg max_delay (steps)"),
    ("backlash", "width"): Names(
        "backlash, whole width", "extra hinge, range +- half", "extra joint, limits +- half", "extra joint, limits"
    ),
    ("end_stop", "place"): Names("place of the stop", "joint range", "joint limits", "limit lower/upper"),
    ("electrode_rc", "tau"): Names("lag of the drive", 'actuator dyntype="filter" dynprm', "-"),
    ("sensor_lag", "tau"): Names("lag of the sensor"),
    ("slew_limit", "inverse"): Names("largest rate of the command", "rate of ctrl", "velocity limit", "limit velocity"),
    ("voltage_clip", "inverse"): Names("largest command", "actuator ctrlrange", "clip of the target"),
    ("dead_zone", "level"): Names("dead zone of the command"),
}


@dataclass(frozen=True)
class Parameter:
    """One number of the simulator and of the robot.

    Attributes:
        name, words: short and plain.
        simulator, robot, difference: robot less simulator; in `unit`.
        stderr: of the difference; None where it is not known.
        mujoco, physx, urdf: what it is called there.
        certain: whether the diagnosis says the effect by name, or fitted coefficients belong to its answer.
    """

    name: str
    words: str
    simulator: float
    robot: float
    difference: float
    stderr: float | None
    unit: str
    mujoco: str
    physx: str
    urdf: str
    certain: bool


@dataclass(frozen=True)
class Units:
    """Units of coefficients and forces, and what a value is to be multiplied by.

    `of[i]`: unit of a_i; `force`: of a force; `factor`: Kp where it is given, else 1.
    """

    of: tuple[str, ...]
    force: str
    factor: float
    command: str
    output: str
    position: bool


def units(record: Record, order: int, position_gain: float | None) -> Units:
    """Units of the coefficients under this input; after position commands multiples of Kp, or its units where given."""
    command, output = base_unit(record.voltage_unit), base_unit(record.displacement_unit)
    powers = ("", " s", *(f" s^{i}" for i in range(2, order + 1)))
    position = command == output
    if position and position_gain is not None:
        rotary = output != "m"
        force = "N m" if rotary else "N"
        per = f"{force}{{}}/{output}"
        known = (per.format(""), per.format(" s"), "kg m^2" if rotary else "kg")
        return Units((*known, *(per.format(p) for p in powers[3:])), force, position_gain, command, output, True)
    if position:
        return Units(tuple(f"Kp{p}" for p in powers), f"Kp {output}", 1.0, command, output, True)
    return Units(tuple(f"{command}{p}/{output}" for p in powers), command, 1.0, command, output, False)


def parameters(
    nominal: Model | Fitted, robot: Answer, records: Sequence[Record], position_gain: float | None
) -> tuple[Parameter, ...]:
    """Every number that the simulator's model or the robot's has.

    Args:
        nominal: the simulator's model, with the simulator's own effects.
        robot: diagnosis of the robot's records under that model.
        records: the robot's.
        position_gain: Kp of the simulator, or None.
    """
    of = units(records[0], nominal.order, position_gain)
    held = (0.0, 0.0) if nominal.hold == "zoh" else (0.5 * nominal.dt, 0.5 * records[0].dt)
    return (*_coefficients(nominal, robot, of), *_effects(nominal, robot, of, held))


def _coefficients(nominal: Model | Fitted, robot: Answer, of: Units) -> list[Parameter]:
    sim, real = nominal.physical_coefficients, robot.model.physical_coefficients
    # the robot's coefficients are known as factors on the simulator's: that of the simulator's own fit cancels
    relative = _factor_errors(robot, len(sim))
    errors = [None if e is None else abs(float(s)) * e for s, e in zip(sim, relative, strict=True)]
    moved = "parameter_change" in robot.effects
    rows = []
    if of.position:
        change = 1 / real[0] - 1 / sim[0]
        error = None if errors[0] is None else errors[0] / sim[0] ** 2
        rows.append(_row("gain", 1 / sim[0], 1 / real[0], change, error, "", _NAMES["gain"], moved))
    start = 1 if of.position else 0
    for i in range(start, len(sim)):
        key = ("stiffness", "damping", "inertia")[i] if i < 3 else f"a{i}"
        names = _NAMES.get(key, Names(f"coefficient a{i}"))
        k, error = of.factor, errors[i]
        scaled = None if error is None else k * error
        rows.append(_row(key, k * sim[i], k * real[i], k * (real[i] - sim[i]), scaled, of.of[i], names, moved))
    return rows


def _factor_errors(robot: Answer, count: int) -> list[float | None]:
    """Relative standard errors of refitted coefficients, where the diagnosis has them."""
    told = next((r.parameters for r in robot.ranking if r.effect == "parameter_change"), {})
    rows = [told.get(f"a_{i} over given") for i in range(count)]
    return [None if r is None or r["stderr"] is None else float(r["stderr"]) for r in rows]


def _effects(nominal: Model | Fitted, robot: Answer, of: Units, held: tuple[float, float]) -> list[Parameter]:
    sides = [_numbers(m) for m in (nominal, robot.model)]
    fitted = {a.effect: a.parameters for a in robot.added}
    rows = []
    for key in dict.fromkeys([*sides[0], *sides[1]]):
        sim, real = (side[key][0] if key in side else 0.0 for side in sides)
        _, unit, force = sides[1].get(key) or sides[0][key]
        stderr = (fitted.get(key[0], {}).get(key[1]) or {}).get("stderr")
        if key == ("delay", "time"):
            sim, real = max(sim - held[0], 0.0), max(real - held[1], 0.0)
        if key[1] == "inverse":  # stored so that 0 is "no limit"; told as the limit
            stderr = None if stderr is None or not real else stderr / real**2
            sim, real = (1 / v if v else float("inf") for v in (sim, real))
            unit = of.command + ("/s" if unit.startswith("s") else "")
        elif force:  # not by its unit: a backlash in rad is no command in rad
            sim, real, unit = of.factor * sim, of.factor * real, of.force
            stderr = None if stderr is None else of.factor * stderr
        names = _NAMES.get(key, Names(f"{key[0]}: {key[1]}"))
        difference = real - sim if abs(sim) != float("inf") else real
        certain = key[0] in robot.effects or key[0] in {e.name for e in nominal.effects}
        rows.append(_row(f"{key[0]} {key[1]}", sim, real, difference, stderr, unit, names, certain))
    return rows


def _numbers(model: Model | Fitted) -> dict[tuple[str, str], tuple[float, str, bool]]:
    """Physical numbers of a model's effects by (effect, parameter), and which are forces; two of one name add up."""
    table: dict[tuple[str, str], tuple[float, str, bool]] = {}
    for effect in model.effects:
        for p, value in effect.numbers():
            number, unit = physical(model, p, float(value))
            key = effect.name, p.name
            table[key] = (number + (table[key][0] if key in table else 0.0), unit, p.force == 1)
    return table


def _row(name, sim, real, difference, stderr, unit, names: Names, certain: bool) -> Parameter:
    error = None if stderr is None else float(stderr)
    return Parameter(
        name, names.words, float(sim), float(real), float(difference), error, unit.replace("1", "", unit == "1"),
        names.mujoco, names.physx, names.urdf, certain,
    )  # fmt: skip


def as_rows(told: Sequence[Parameter]) -> list[dict[str, Any]]:
    """As the JSON has them."""
    return [vars(p) for p in told]
