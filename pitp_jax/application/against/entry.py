"""Diagnose recordings against a model, or against recordings of a simulator."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, overload

import numpy as np
from jax.sharding import Mesh

from ...common.errors import BadInput
from ...common.metrics import e_rms_percent
from ...method.diagnose import rules
from ...method.diagnose.diagnosis import Diagnosis
from ...method.diagnose.diagnosis import diagnose as diagnose_model
from ...method.diagnose.joint import Answer, Parameter, parameters
from ...method.identify.identification import identify
from ...method.model.fitted import Fitted
from ...method.model.model import Model
from ...method.signal.initial_state import noise_of, noise_std
from ...method.signal.record import Record
from ...method.signal.sets import check_records
from ...method.simulate.prediction import predicted_pairs
from ..compare.pairing import pair_records
from .correction import corrections
from .mjcf import with_shared_weight
from .result import SimToReal


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
            if the nominal was made from these recordings, and for a note where no effect of the frozen one is certain.
        exclude: effects left out of the catalogue.
        seconds: of computing; then the best result so far is returned, and `notes` lists the untried steps.
        progress: called with one line per step.
        mesh: devices of this process (`records_mesh`); the runs of a diagnosis take the processor's cores.

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
    command, output = pairs.offsets
    real = [replace(r, voltage=r.voltage - command, displacement=r.displacement - output) for r in real]
    say = options["progress"]
    free = "; the searches that follow have no limit of time"
    say(f"identifying the simulator{free if np.isinf(options['seconds']) else ''}")
    noise = float(np.median(noise_of(real)))
    nominal, simulator, own = model_of_simulator(simulated, noise, options)
    say("diagnosing the robot's recordings")
    # at the robot's rate, because a held command stays for one sample of its own log
    played = Fitted(nominal.model, nominal.origin, domain=replace(nominal.domain, dt=real[0].dt))
    robot = diagnose_model(played, real, refit_nominal=False, **options)
    if robot.verdict == "no_gap" and own:
        robot = replace(robot, verdict="unknown", reason=(
            f"The model of the simulator misses the simulator's own recordings by {own:.2g} % of range, and the "
            f"difference to the robot is {robot.gap.before:.2g} %: it may hide in that error."
        ))  # fmt: skip
    say("correction signals")
    return SimToReal(
        robot=robot, simulator=simulator, nominal=nominal, own=own, pairs=pairs,
        parameters=parameters_of(nominal, robot, real, position_gain),
        records=tuple(real), corrections=tuple(corrections(nominal, real)),
    )  # fmt: skip


def model_of_simulator(
    simulated: Sequence[Record], noise: float, options: Mapping[str, Any]
) -> tuple[Fitted, Diagnosis | None, float]:
    """Identify the simulator with its own effects, by the lowest order that is not clearly worse.

    Effects come before order, because a higher order imitates them, and its coefficients then belong to no joint. The
    search sees the simulator through the robot's sensor: what that cannot show counts as none.

    Args:
        simulated: the simulator's recordings.
        noise: of the robot's sensor, base unit.
        options: of the diagnosis.

    Returns:
        the model, the diagnosis that added effects to it (None if it needs none), and the error of its free runs, % of
        range: 0 where the robot's sensor hides it.
    """
    best = identify(simulated)
    hidden = 100 * np.sqrt(rules.OWN**2 - 1) * noise / np.mean([r.span for r in simulated])
    draw = np.random.default_rng(0).standard_normal
    seen = [replace(r, displacement=r.displacement + noise * draw(r.samples)) for r in simulated]
    tried: list[tuple[Fitted, Diagnosis | None, float]] = []
    lower = [o.order for o in best.orders if o.poles_known and 2 <= o.order < best.chosen.order]
    for order in (*lower[:1], best.chosen.order):
        model, own = best.model, None
        if order < best.chosen.order:
            model = identify(simulated, order=order, input_map=model.input_map.name).model
        error = _error(model, simulated)
        if error > hidden:
            options["progress"](f"diagnosing the simulator's own recordings at order {order}")
            own = diagnose_model(model, seen, refit_nominal=True, **options)
            if own.interrupted:  # there is no result on the robot yet
                raise KeyboardInterrupt
            left = _error(own.model, simulated)
            if own.verdict != "unknown" or left < rules.HALF * error:  # parameters of uncertain effects mislead
                model, error = own.model, left
        if error <= hidden:
            return model, own, 0.0
        tried.append((model, own, error))
    # a lower order with its effects may leave a tenth more than a higher one
    return next(t for t in tried if t[2] <= 1.1 * min(error for *_, error in tried))


def parameters_of(
    nominal: Model | Fitted, robot: Answer, real: Sequence[Record], position_gain: float | None
) -> tuple[Parameter, ...]:
    """Return simulator's and robot's parameters under one hypothesis.

    Where another position gain explains the changed coefficients, the robot's torques are multiples of its own gain. A
    load that both carry is then the same torque in both.
    """
    rows = parameters(nominal, robot, real, position_gain)
    gain = [p for p in rows if p.name == "position gain"]
    if not gain:
        return rows
    own = {p.name: p for p in with_shared_weight(parameters(nominal, robot, real, gain[0].robot), robot)}
    for p in rows[1:]:
        value, less = own[p.name].robot, p.simulator if np.isfinite(p.simulator) else 0.0
        words = p.words.removesuffix(", if the position gain is the simulator's")
        gain.append(replace(p, words=words, robot=value, difference=value - less, stderr=own[p.name].stderr))
    return tuple(gain)


def _error(model: Model | Fitted, records: Sequence[Record]) -> float:
    """Return the rms error of simulations beyond noise, pooled over records, % of range; infinite if one diverges."""
    squares = []
    for record, run in predicted_pairs(model, records):
        error = e_rms_percent(run.displacement, record.displacement, run.scored)
        noise = 100 * noise_std(record.displacement) / max(record.span, 1e-30)
        squares.append(np.inf if run.diverged else max(error**2 - noise**2, 0.0))
    return float(np.sqrt(np.mean(squares)))
