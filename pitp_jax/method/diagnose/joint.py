"""Tabulate parameters of a simulator and a robot as users enter them: units, names in three programs, differences.

    a_0 q + a_1 q' + a_2 q'' = c        c: position command, same unit as q
    J = Kp a_2,  D = Kp a_1,  spring = Kp (a_0 - 1),  frictionloss = Kp Fc      Kp: of the position controller
    weight on an arm   m g l = K c^2 where the spring is K sin(c q) / c, and the remaining spring K - m g l
    second body        spring kappa K,  inertia kappa K / omega^2,  damper 2 zeta kappa K / omega

A command is held from its time stamp to the next: if the model interpolates it linearly, half a sample of each log is
subtracted from the delay. From position commands alone only these ratios to Kp are known; with a torque or force as
input the a_i are J, D, K themselves. D holds the controller's own damping, J the link's inertia: only their difference
is added to the simulator.

Names: MuJoCo XML reference (joint, actuator); PhysxJointAxisAPI; Isaac Lab's actuator configurations; URDF <joint>.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ...common.quantity import grouped
from ...common.units import base_unit
from ..effects.effect import Effect
from ..effects.physical import physical
from ..model.fitted import Fitted
from ..model.model import Model
from ..model.units import base_units, units_of
from ..signal.record import Record


@runtime_checkable
class Answer(Protocol):
    """The attributes of a `Diagnosis` that this module reads."""

    @property
    def model(self) -> Model | Fitted:  # noqa: D102
        ...
    @property
    def effects(self) -> tuple[str, ...]:  # noqa: D102
        ...
    @property
    def added(self) -> Sequence:  # noqa: D102
        ...


@dataclass(frozen=True)
class Names:
    """The name of a parameter in plain words, in MuJoCo, PhysX and URDF; a dash if a program lacks it.

    `substitute`: the nearest way to enter it in MuJoCo, if no attribute holds it.
    """

    words: str
    mujoco: str = "-"
    physx: str = "-"
    urdf: str = "-"
    substitute: str = "none"


_ALIKE = 0.05  # of a coefficient: changes that differ by less, beyond two errors, are one change of the gain
_LEVEL = 0.1  # friction that changes by less over the recorded speeds is one level there
_MOTOR = "actuator <dcmotor> with a friction model"
_SCALED_BY_GAIN = ("damping", "inertia")

NAMES = {
    "gain": Names("steady output per command"),
    "position gain": Names("position gain of the controller", "actuator kp", "stiffness of the drive", "-"),
    "stiffness": Names("spring", "joint stiffness"),
    "damping": Names("viscous damping", "joint damping", "viscousFrictionCoefficient", "dynamics damping"),
    "inertia": Names("inertia", "joint armature", "armature"),
    "softening weight": Names(
        "weight on the arm, m g l",
        "mass of the body",
        "mass of the link",
        "inertial mass",
        "mass of the body, or pos of its inertial: m g l must rise by the difference",
    ),
    "coulomb_friction level": Names("dry friction", "joint frictionloss", "dynamicFrictionEffort", "dynamics friction"),
    "coulomb_friction rise": Names(
        "static over dry friction, minus 1",
        "-",
        "staticFrictionEffort: dry friction (1 + it)",
        substitute=f"{_MOTOR}; frictionloss has one level",
    ),
    "coulomb_friction speed": Names(
        "speed over which dry friction changes", substitute=f"{_MOTOR}; frictionloss has one level"
    ),
    "coulomb_friction give": Names(
        "distance that the contact gives before it slides", substitute=f"{_MOTOR}, or solreffriction"
    ),
    "coulomb_friction mu": Names(
        "dry friction over the spring force", substitute="none, because frictionloss does not grow with the load"
    ),
    "delay time": Names("delay of the command", "actuator delay", "DelayedPDActuatorCfg max_delay (steps)"),
    "backlash width": Names(
        "backlash, whole width",
        "extra hinge, range +- half",
        "extra joint, limits +- half",
        "extra joint, limits",
        "a second hinge in series with a range of +- half of it (one more body, a smaller timestep)",
    ),
    "backlash rate": Names(
        "rate at which the load slows within it",
        "extra hinge damping over its inertia",
        substitute="damping of that second hinge over its inertia",
    ),
    "end_stop place": Names("place of the stops", "joint range", "joint limits", "limit lower/upper"),
    "end_stop place, above": Names("place of the upper stop", "joint range", "joint limits", "limit upper"),
    "end_stop place, below": Names("place of the lower stop, from 0", "joint range", "joint limits", "limit lower"),
    "second_mode inertia": Names(
        "second body on a spring: inertia",
        "extra body",
        "extra link",
        "extra link",
        "a second body on a hinge with stiffness and damping",
    ),
    "second_mode spring": Names(
        "its spring", "extra hinge stiffness", "extra joint stiffness", substitute="stiffness of that second hinge"
    ),
    "second_mode damper": Names(
        "its damper", "extra hinge damping", "extra joint damping", "dynamics damping", "damping of that second hinge"
    ),
    "electrode_rc tau": Names("lag of the drive", 'actuator dyntype="filter" dynprm'),
    # with a linear joint the two lags are equivalent: either may be entered
    "sensor_lag tau": Names(
        "lag of the sensor, or of the drive",
        'actuator dyntype="filter" dynprm',
        substitute="none on the sensor; filter qpos in your control loop",
    ),
    "slew_limit inverse": Names(
        "largest rate of the command",
        "rate of ctrl",
        "velocity limit",
        "limit velocity",
        "limit the rate of ctrl in your control loop; or actuator <pid> slewmax",
    ),
    "force_limit inverse": Names("largest force of the drive", "actuator forcerange", "max effort", "limit effort"),
    "voltage_clip inverse": Names("largest command", "actuator ctrlrange", "clip of the target"),
    "dead_zone level": Names("dead zone of the command", substitute="subtract it from ctrl in your control loop"),
}


@dataclass(frozen=True)
class Parameter:
    """One parameter in the simulator and in the robot, with the difference and its standard error.

    Attributes:
        name, words: short and plain.
        simulator, robot, difference: robot less simulator; in `unit`.
        stderr: of the difference; None if unknown.
        mujoco, physx, urdf: its names there.
        certain: whether the diagnosis reports the effect, or the refitted coefficients.
        determined: False where the diagnosis says that the recordings do not determine it.
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
    determined: bool = True


@dataclass(frozen=True)
class Units:
    """Units of the coefficients a_i and of forces, and the factor by which values are multiplied.

    `of[i]`: unit of a_i; `force`: of a force; `factor`: Kp where it is given, else 1.
    """

    of: tuple[str, ...]
    force: str
    factor: float
    command: str
    output: str
    position: bool


def units(record: Record, order: int, position_gain: float | None) -> Units:
    """Return the units of the coefficients for a record's input and output.

    For position commands they are multiples of the position gain Kp, or torques if Kp is given.
    """
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
    return Units(tuple(f"{command}{p}/{grouped(output)}" for p in powers), command, 1.0, command, output, False)


def parameters(
    nominal: Model | Fitted, robot: Answer, records: Sequence[Record], position_gain: float | None
) -> tuple[Parameter, ...]:
    """Return every parameter that the model of the simulator or of the robot has.

    Args:
        nominal: the simulator's model, with the simulator's own effects.
        robot: diagnosis of the robot's records under that model.
        records: the robot's.
        position_gain: Kp of the simulator, or None.
    """
    of = units(records[0], nominal.order, position_gain)
    held = (0.0, 0.0) if nominal.hold == "zoh" else (0.5 * nominal.dt, 0.5 * records[0].dt)
    fitted = {a.effect: a.parameters for a in robot.added}
    speeds = _speeds(records, nominal.natural_frequency)
    first, second = _side(nominal, of, held[0], {}, speeds), _side(robot.model, of, held[1], fitted, speeds)
    said, rows = {*robot.effects, *(e.name for e in nominal.effects)}, []
    gain = position_gain_factor(nominal, robot.model, of)
    if gain is not None:
        value, names = of.factor, NAMES["position gain"]
        unit = f"{of.force}/{of.output}" if position_gain is not None else "Kp"
        rows.append(Parameter(
            "position gain", names.words, value, value * gain, value * (gain - 1), None, unit, names.mujoco,
            names.physx, names.urdf, bool(said & {"parameter_change", "added_mass"}),
        ))  # fmt: skip
    for key in dict.fromkeys([*first, *second]):
        it = second.get(key) or first[key]
        absent = np.inf if key.endswith("inverse") else 0.0  # a limit that does not exist
        sim, real = (side[key].value if key in side else absent for side in (first, second))
        names = NAMES.get(key) or Names(key.replace(" ", ": ", 1).replace("_", " "))
        if gain is not None and key in _SCALED_BY_GAIN:
            names = replace(names, words=f"{names.words}, if the position gain is the simulator's")
        rows.append(Parameter(
            key, names.words, float(sim), float(real), float(real - sim if np.isfinite(sim) else real), it.stderr,
            "" if it.unit == "1" else it.unit, names.mujoco, names.physx, names.urdf, bool(said & it.causes),
            _is_determined(key, it, getattr(robot, "parts", ())),
        ))  # fmt: skip
    return tuple(rows)


def _is_determined(key: str, number: "_Number", parts: Iterable[Any]) -> bool:
    """Return whether the diagnosis gives an interval for every parameter that this number is made of."""
    for part in parts:
        if part.effect not in number.causes:
            continue
        if number.at_speeds:  # a combination of parameters: known where the effect is
            return part.certainty != "none"
        coefficient = {"stiffness": "a_0", "damping": "a_1", "inertia": "a_2"}.get(key, key.replace("a", "a_"))
        own = {key.removeprefix(f"{part.effect} ").split(",")[0], f"{coefficient} over given"}
        entries = [n for name, n in part.parameters.items() if name in own] or list(part.parameters.values())
        if part.effect == "parameter_change" and not own & set(part.parameters):
            continue
        if any(n["ci95"] is None for n in entries):
            return False
    return True


def _speeds(records: Sequence[Record], frequency: float) -> tuple[float, float]:
    """Return the speeds (base unit/s) that a tenth and nine tenths of the moving samples stay below.

    Speeds are differences over a twentieth of a period, so that they are not the sensor's noise.
    """
    speeds = [np.zeros(0)]
    for r in records:
        step = max(round(0.05 * 2 * np.pi / frequency / r.dt), 1)
        v = np.abs(r.displacement[step:] - r.displacement[:-step]) / (step * r.dt)
        v = v[np.isfinite(v)]
        speeds.append(v[v > 0.05 * v.max(initial=0.0)])
    every = np.concatenate(speeds)
    return (float(np.quantile(every, 0.1)), float(np.quantile(every, 0.9))) if len(every) else (0.0, np.inf)


def position_gain_factor(nominal: Model | Fitted, robot: Model | Fitted, of: Units) -> float | None:
    """Return the robot's position gain over the simulator's if that alone explains all changed coefficients, or None.

    Kp q + D q' + J q'' = Kp c: Kp times g keeps the steady output and divides D / Kp and J / Kp by g. Recordings of
    commands and angles cannot separate this from a smaller damping and inertia.
    """
    a, b = nominal.physical_coefficients, robot.physical_coefficients
    if not of.position or len(a) != len(b) or min(*a, *b) <= 0:
        return None
    ratios = b / a
    return gain_factor(ratios[1:]) if np.abs(np.log(ratios[0])) < _ALIKE else None


def gain_factor(ratios: Sequence[float] | np.ndarray, error: float = 0.0) -> float | None:
    """Return the factor on the gain that alone explains these ratios of coefficients (robot / simulator), or None.

    `error`: standard error of the logarithm of their ratio.
    """
    logs = np.log(np.asarray(ratios, float))
    size = -float(np.mean(logs))
    return float(np.exp(size)) if np.ptp(logs) < _ALIKE + 2 * error and abs(size) > _ALIKE else None


@dataclass(frozen=True)
class _Number:
    """One parameter value in the reported unit, with its standard error and the effects that contribute to it."""

    value: float
    unit: str
    causes: frozenset[str]
    stderr: float | None = None
    at_speeds: bool = False


def _side(
    model: Model | Fitted, of: Units, held: float, fitted: Mapping[str, Mapping], speeds: tuple[float, float]
) -> dict[str, _Number]:
    """Return the parameters of one model, by name; contributions of several effects are added.

    Of several stops, the nearest counts.

    Args:
        model: of the simulator or of the robot.
        of: units.
        held: part of its delay due to the hold of its log, s.
        fitted: parameters of the added effects, with their standard errors.
        speeds: the lowest and highest recorded one, base unit/s.
    """
    coefficients, effects = _linear(model, len(of.of) - 1)
    table = _coefficients(coefficients, of, fitted.get("parameter_change", {}))
    for effect in effects:
        for key, n in _numbers(model, effect, of, fitted.get(effect.name, {}), speeds):
            old = table.get(key)
            if old is not None:
                value = min(old.value, n.value) if "stop" in key else old.value + n.value
                n = replace(n, value=value, causes=n.causes | old.causes)
            table[key] = n
    if late := table.get("delay time"):
        table["delay time"] = replace(late, value=max(late.value - held, 0.0))
    return table


def _linear(model: Model | Fitted, order: int) -> tuple[np.ndarray, list[Effect]]:
    """Return the linear coefficients of a model, and the effects that are not part of them.

    A sensor lag is multiplied into the coefficients if the model's order is below the simulator's.
    """
    a, others = model.physical_coefficients, []
    for effect in model.effects:
        if effect.name == "sensor_lag" and len(a) <= order:
            tau, *zeta = (float(v) for _, v in effect.numbers())
            a = np.convolve(a, [1.0, 2 * zeta[0] * tau, tau**2] if zeta else [1.0, tau])
        else:
            others.append(effect)
    return a, others


def _coefficients(a: np.ndarray, of: Units, moved: Mapping) -> dict[str, _Number]:
    """Return gain, stiffness, damping and inertia from coefficients; `moved` holds fitted factors with errors."""
    causes = frozenset(["parameter_change"])
    factors = [moved.get(f"a_{i} over given") for i in range(len(a))]
    relative = [None if t is None or t["stderr"] is None else t["stderr"] / t["value"] for t in factors]
    table = {}
    if of.position:
        table["gain"] = _Number(1 / a[0], "", causes, None if relative[0] is None else relative[0] / a[0])
    for i, value in enumerate(a):
        error = None if relative[i] is None else abs(of.factor * value * relative[i])
        key = ("stiffness", "damping", "inertia")[i] if i < 3 else f"a{i}"
        own = 1.0 if of.position and i == 0 else 0.0  # the controller's
        table[key] = _Number(of.factor * (value - own), of.of[i], causes, error)
    return table


def _numbers(
    model: Model | Fitted, effect: Effect, of: Units, fitted: Mapping, speeds: tuple[float, float]
) -> Iterator[tuple[str, _Number]]:
    """Yield the parameters to which one effect of a model contributes, with names and values."""
    base = base_units(units_of(model))  # a simulator's units
    values = {p.name: physical(model, p, float(v), base) for p, v in effect.numbers()}
    errors = {name: (fitted.get(name) or {}).get("stderr") for name in values}
    a, causes = of.factor * model.physical_coefficients, frozenset([effect.name])

    def share(value: float, i: int, *names: str) -> _Number:  # of a product of these parameters
        known = [e / values[n][0] for n in names if (e := errors.get(n)) is not None and values[n][0]]
        error = abs(value) * float(np.sqrt(sum(k * k for k in known))) if len(known) == len(names) else None
        return _Number(value, of.of[i], causes, error)

    if effect.name == "added_mass" and len(a) > 2:
        yield "inertia", share(values["d"][0] * a[2], 2, "d")
    elif (effect.name, effect.form) == ("softening", "gravity") and of.output == "rad":
        weight = a[0] * values["curvature"][0] ** 2
        yield "softening weight", share(weight, 0, "curvature", "curvature")
        yield "stiffness", share(-weight, 0, "curvature", "curvature")
    elif (effect.name, effect.form) == ("softening", "weight on an arm"):
        yield "softening weight", share(a[0] * values["kappa"][0] / values["curvature"][0], 0, "kappa")
    elif (effect.name, effect.form) == ("coulomb_friction", "Stribeck") and (
        (level := _one_level(values, speeds)) is not None
    ):
        yield "coulomb_friction level", _Number(of.factor * level, of.force, causes, None, True)
    elif effect.name == "second_mode" and "kappa" in values and len(a) > 2:
        spring, omega, zeta = a[0] * values["kappa"][0], values["omega"][0], values["zeta"][0]
        yield "second_mode inertia", share(spring / omega**2, 2, "kappa", "omega", "omega")
        yield "second_mode spring", share(spring, 0, "kappa")
        yield "second_mode damper", share(2 * zeta * spring / omega, 1, "kappa", "zeta", "omega")
    else:
        for p, _ in effect.numbers():
            value, unit = values[p.name]
            error = errors[p.name]
            if p.name == "inverse":  # stored so that 0 means no limit; reported as the limit
                error = None if error is None or not value else error / value**2
                unit = f"{of.command}/s" if unit.startswith("s") else of.command
                value = 1 / value if value else np.inf
                if p.force:  # a limit of the actuator's force
                    value, unit, error = of.factor * value, of.force, error and of.factor * error
            elif p.force == 1:  # by its force, not by its unit: a backlash in rad is not a command in rad
                value, unit, error = of.factor * value, of.force, None if error is None else of.factor * error
            key = f"{p.name}, {effect.form}" if effect.form in ("above", "below") else p.name
            if effect.form.startswith("each side"):
                key = {"place": "place, above", "opposite": "place, below"}.get(p.name, p.name)
            yield f"{effect.name} {key}", _Number(value, unit, causes, error)


def _one_level(values: Mapping[str, tuple[float, str]], speeds: tuple[float, float]) -> float | None:
    """Return the friction at the recorded speeds if it is one level there; None if the recordings show its change."""
    level, rise, speed = (values[name][0] for name in ("level", "rise", "speed"))
    ends = [level * (1 + rise * np.exp(-((v / speed) ** 2))) for v in speeds]
    return float(np.mean(ends)) if np.ptp(ends) < _LEVEL * np.mean(ends) else None


def as_rows(parameters: Sequence[Parameter]) -> list[dict[str, Any]]:
    """Return the parameters as a list of dicts for JSON."""
    return [vars(p) for p in parameters]
