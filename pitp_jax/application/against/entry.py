"""Diagnose recordings against a model, or against recordings of a simulator."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import overload

import numpy as np
from jax.sharding import Mesh

from ...common.errors import BadInput
from ...common.metrics import e_rms_percent
from ...common.units import base_unit
from ...method.diagnose.diagnosis import Diagnosis
from ...method.diagnose.diagnosis import diagnose as diagnose_model
from ...method.diagnose.joint import parameters
from ...method.identify.identification import Identification, identify
from ...method.model.fitted import Fitted
from ...method.model.lineage import descended
from ...method.model.model import Model
from ...method.signal.initial_state import noise_std
from ...method.signal.record import Record
from ...method.signal.sets import check_records
from ...method.simulate.prediction import predict
from ..compare.pairing import Pairing, pair_records
from ..compare.records import linear_model_of
from .correction import corrections
from .result import SimToReal

_OWN = 2.0  # % of range: largest error of a lower order in the place of the simulator
_HIDES = 0.5  # of the gap's rms: a larger error of the simulator's model could be the gap
_OFFSET = 0.1  # of the range: a smaller constant difference is left to each recording's sensor offset
_PART = 0.1  # of the gap's rms, below which the simulator's model is not the cause: 1 % of the energy


@overload
def diagnose(
    model: Model | Fitted, records: Sequence[Record], *, refit_nominal: bool | None = ..., exclude: Sequence[str] = ...,
    seconds: float = ..., progress: Callable[[str], None] = ..., mesh: Mesh | None = ...,
) -> Diagnosis: ...  # fmt: skip


@overload
def diagnose(
    model: Sequence[Record], *, against: Sequence[Record], position_gain: float | None = ..., seconds: float = ...,
    exclude: Sequence[str] = ..., progress: Callable[[str], None] = ..., mesh: Mesh | None = ...,
) -> SimToReal: ...  # fmt: skip


def diagnose(
    model, records=None, *, against=None, position_gain=None, refit_nominal=None, exclude=(), seconds=np.inf,
    progress=lambda line: None, mesh=None,
):  # fmt: skip
    """Find the effects that a model, or a simulator, lacks compared with real recordings.

    `diagnose(model, records)`: the unmodelled effect behind the gap of a nominal model. `diagnose(records,
    against=simulated)`: the same with a simulator in the place of the model, known by its recordings alone; a missing
    effect is then reported as the simulator's value, the robot's and the difference.

    Args:
        model: an identified linear model or a trained one (`Fitted` or `Model`); with `against` the real recordings.
        records: of one actuator, one sampling rate, best of several kinds of excitation.
        against: recordings of a simulator, paired by their commands; another rate and another clock are fine.
        position_gain: Kp of the simulator's position controller (N m/rad, N/m), which turns ratios into torques.
        refit_nominal: fit the nominal's coefficients too, because it was identified on records with the effect. None:
            if the nominal was made from these recordings.
        exclude: effects left out of the catalogue.
        seconds: of computing; then the best result so far is returned, and `notes` lists the untried steps.
        progress: called with one line per step.
        mesh: devices of this process that share the rollouts of all candidates (`records_mesh`); default one device.

    Returns:
        verdict, effects, gap, ranking, and the model (a `Fitted`) with the effects added; with `against` a `SimToReal`.

    Raises:
        BadInput: no records, of several rates, two of one name or none that moves; no command common to both sets; a
            nominal that diverges on one; a mesh over several processes.
        ComputationFailed: no linear model of the simulator can be identified.

    Examples:
        >>> print(pitp.diagnose(model, records))  # doctest: +SKIP
        verdict: no_gap ...
        >>> pitp.diagnose(robot, against=simulated, position_gain=20.0).frame()  # doctest: +SKIP
    """
    options = {"exclude": exclude, "seconds": seconds, "progress": progress, "mesh": mesh}
    if against is None:
        if position_gain is not None:
            raise BadInput("position_gain only works with against=; it is the gain of the simulator's controller")
        if records is None:
            raise BadInput("give diagnose(model, records), or diagnose(records, against=simulated)")
        return diagnose_model(model, records, refit_nominal=refit_nominal, **options)
    if records is not None or refit_nominal:
        raise BadInput("with against=, give only the real recordings, no model and no refit_nominal")
    return _against(model, against, position_gain, options)


def _against(real: Sequence[Record], simulated: Sequence[Record], position_gain: float | None, options) -> SimToReal:
    check_records(real)
    check_records(simulated)
    pairs = pair_records(real, simulated, shared="second")
    if not pairs.pairs:
        name, why = pairs.first_alone[0]
        raise BadInput(f"no recording of the simulator has the same command as one of the robot; {name}: {why}")
    offsets = constant_offsets(pairs)
    if any(offsets):
        real = [replace(r, voltage=r.voltage - offsets[0], displacement=r.displacement - offsets[1]) for r in real]
        pairs = pair_records(real, simulated, shared="second")
    say = options["progress"]
    say("identifying the simulator")
    identified, own, gap = simplest_model(simulated, real)
    nominal = identified.model
    simulator = None
    if own > _PART * gap:
        say("diagnosing the simulator's own recordings")
        simulator = diagnose_model(nominal, simulated, refit_nominal=False, **options)
        if simulator.interrupted:  # there is no result on the robot yet
            raise KeyboardInterrupt
        nominal = simulator.model
        own = simulator.gap.after
    say("diagnosing the robot's recordings")
    robot = diagnose_model(nominal, real, refit_nominal=False, **options)
    robot_gap = max(robot.gap.before, 1e-12)
    if robot.verdict == "no_gap" and _without_noise(own, simulated) > _HIDES * robot_gap:
        robot = replace(robot, verdict="unknown", reason=(
            f"The model of the simulator misses the simulator's own recordings by {own:.2g} % of range, and the "
            f"difference to the robot is {robot_gap:.2g} %: it may hide in that error."
        ))  # fmt: skip
    share = min((own / robot_gap) ** 2, 1.0)
    say("correction signals")
    return SimToReal(
        robot=robot, simulator=simulator, identification=identified, nominal=nominal, pairs=pairs,
        parameters=parameters(nominal, robot, real, position_gain),
        simulator_share=(share, 0.5 * share, min(2.0 * share, 1.0)),
        records=tuple(real), corrections=tuple(corrections(nominal, real)), offsets=offsets,
    )  # fmt: skip


def simplest_model(simulated: Sequence[Record], real: Sequence[Record]) -> tuple[Identification, float, float]:
    """Identify the simulator with the lowest order whose error is small: a tenth of its distance to the robot, or 2 %.

    A simulator has no noise to limit the order. Without this rule, an integrator's step and its hold became a third
    pole, and no parameter belonged to the joint.

    Returns:
        the identification, and the errors of its free runs on the simulator's and the robot's records, % of range.
    """
    best = linear_model_of(simulated)
    own, gap = _error(best.model, simulated), max(_error(best.model, real), 1e-12)
    most = min(_PART * gap, _OWN)
    enough = [o.order for o in best.orders if own * o.rms <= most * best.chosen.rms]
    order = min(enough, default=best.chosen.order)
    if order >= best.chosen.order:
        return best, own, gap
    lower = identify(simulated, order=order, input_map=best.model.input_map.name, learn=("delay",))
    return lower, _error(lower.model, simulated), max(_error(lower.model, real), 1e-12)


def constant_offsets(pairs: Pairing) -> tuple[float, float]:
    """Return the constants by which the robot's commands and outputs exceed the simulator's, base units.

    Registers of a servo read 2048 at rest, which is no distance between robot and simulator. Below a tenth of the range
    an offset is 0. Commands and outputs of one kind have one offset, unless the outputs differ by more.
    """
    rows, alike = [], False
    for p in pairs.pairs:
        a = p.first
        if p.correlation > 0 and p.output_sign > 0:
            off = float(np.nanmedian(a.voltage - p.command())), float(np.nanmedian(a.displacement - p.output()))
            rows.append((*off, np.ptp(a.voltage), np.nanmax(a.displacement) - np.nanmin(a.displacement)))
            alike = base_unit(a.voltage_unit) == base_unit(a.displacement_unit)
    if not rows:
        return 0.0, 0.0
    (command, output), (wide, high) = np.median(rows, 0)[:2], np.max(rows, 0)[2:]
    command = float(command) if abs(command) > _OFFSET * wide else 0.0
    if alike and command and abs(output - command) < 2 * _OFFSET * high:
        return command, command
    return command, float(output) if abs(output) > _OFFSET * high else 0.0


def _without_noise(percent: float, records: Sequence[Record]) -> float:
    """Return an error, % of range, without the noise of these recordings."""
    noise = [100 * noise_std(r.displacement) / max(r.span, 1e-30) for r in records]
    return float(np.sqrt(max(percent**2 - np.mean(np.square(noise)), 0.0)))


def _error(model: Model | Fitted, records: Sequence[Record]) -> float:
    """Return the rms error of simulations, pooled over records, % of range; infinite if one diverges."""
    squares = []
    for record, run in zip(records, predict(model, records), strict=True):
        squares.append(
            np.inf if run.diverged else e_rms_percent(run.displacement, record.displacement, run.scored) ** 2
        )
    return float(np.sqrt(np.mean(squares)))


def with_lineage(result: SimToReal) -> Fitted:
    """Return the diagnosed model with the robot's recordings added to its lineage."""
    return descended(result.model, "diagnose against a simulator", result.records, result.nominal)
