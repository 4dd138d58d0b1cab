"""Refine a trained model: fit its simulations to the records by least squares (output error).

    minimise  mean over records of  f_k mean_t ( 100 (x(t) - x_measured(t)) / range_k )^2  +  sum_k rho_k (p_k - p_k0)^2
    f_k = (1 + (100 s_min)^2) / (1 + (100 s_k)^2)        s_k: sensor noise over range, s_min the least in the set

Levenberg-Marquardt (`accelerated`) runs in stages: windows of six periods from their filtered states, longer windows if
whole records still have large errors, then whole records from their own initial states, as in predictions. These stages
lack a third of every record, whose error decides when they end; the last stage fits all samples. Every stage
first scales the logits, between zero (the nominal model) and the trained ones, to the smallest error. A network fitted
to the equation error may be unstable, and no step can improve a diverged run. Creep slower than the runs is fitted in
addition (`creep_balance`). Every trained parameter is free: encoder weights, time constants of memory and drive, and
those of given effects.

If the records exceed the budget, half of it goes to representative records in full length,
because only they show creep. The other half goes to the beginnings of the others, because a resonance is narrow.
Benefits and alternatives: docs/decisions/free_runs.md.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh
from jaxtyping import Float

from ...common.errors import ComputationFailed
from ..fit.forward_sensitivity import Runs
from ..fit.free_run_problem import FreeRuns
from ..fit.lower_bound import LowerBound
from ..fit.minimise import accelerated
from ..fit.parameters import parameters, trainable, with_parameters
from ..model.memory import FadingMemory, RingingMemory
from ..model.model import Model
from ..signal.excitation_kind import spread_over_kinds
from ..signal.initial_state import Beginning, aligned, noise_of, noise_std
from ..signal.record import Record
from ..signal.sets import alike
from ..simulate import ports
from ..simulate.beginnings import with_zero_at_rest
from ..simulate.decoder import still_state
from ..simulate.prediction import begin, simulate
from .creep_balance import SlowBalance
from .dataset import Dataset

BUDGET = 400_000  # samples in all
_FEWEST_WHOLE, _SHORTEST = 12, 1000  # whole records, and samples of a cut one
_SHORT_STEPS, _PERIODS, _LONGER = 12, 6.0, 4.0  # steps on windows; their length at first, and its growth
_NEAR, _WORSE = 10.0, 3.0  # % of range, or times the windows' error, above which whole records are not fitted next
_SCALED = (1.0, 0.7, 0.4, 0.2, 0.0)  # factors on the logits at which a stage may start
_PRIOR = 1e-4  # rho of every trained parameter except the weights of the spring and damping nets
_DIVERGED = 1e4  # times the range; the error of a diverged run, so that a mean stays finite


@dataclass(frozen=True)
class HeldOut:
    """A third of every record, in three blocks, never the first, and the score of a model on them."""

    records: Sequence[Record]
    begun: Sequence[Beginning] = ()  # by the nominal

    @property
    def rest(self) -> list[Record]:
        """Return the records without their held-out blocks, which count as missing."""
        return [replace(r, displacement=np.where(_held(r, k), np.nan, r.displacement))
                for k, r in enumerate(self.records)]  # fmt: skip

    def score(self, model: Model) -> float:
        """Return the mean logarithm over records of the squared error on held-out blocks, none below the noise."""
        logs = []
        for k, (r, run) in enumerate(zip(self.records, simulate(model, self.rest, self.begun), strict=True)):
            seen = _held(r, k) & r.observed & run.scored
            error = float(np.mean((run.displacement - r.displacement)[seen] ** 2)) if seen.any() else 0.0
            least, most = max(noise_std(r.displacement), 1e-6 * r.span), _DIVERGED * r.span
            logs.append(np.log(np.clip(np.nan_to_num(error, nan=np.inf), least**2, most**2)))
        return float(np.mean(logs))


def _held(record: Record, place: int) -> np.ndarray:
    """Mark the held-out samples: the second of every three of nine blocks, in every other record the third."""
    return np.arange(record.samples) * 9 // record.samples % 3 == 1 + place % 2


@dataclass(frozen=True)
class _How:
    """The settings shared by all steps of a refinement."""

    dt: float
    report: Callable
    firmness: float
    slow: SlowBalance | None
    mesh: Mesh | None
    every: int


def refine(
    model: Model,
    data: Dataset,
    held_out: HeldOut,
    count: int,
    report,
    *,
    firmness: float = _PRIOR,
    slow: SlowBalance | None = None,
    mesh: Mesh | None = None,
) -> Iterator[tuple[Model, dict]]:
    """Yield (model, history entry) after every optimiser step that lowers the simulation error.

    `firmness`: rho of the nets of spring and damping, in (1 %)^2; see `Settings`. `slow`: the slow balance to be fitted
    as well. `held_out`: the records, and the blocks without which the model is fitted first, until their score no
    longer improves. The entries of whole runs have the best score so far.
    """
    records, rest = held_out.records, held_out.rest
    dt, period = records[0].dt, _period(model)
    how = _How(dt, report, firmness, slow, mesh, thinning(model, dt))
    longest = max(r.samples for r in records) * dt / period  # in periods
    periods, stage, windows = _PERIODS, "short runs", True
    while windows:
        runs = (_windows(model, data, rest, periods),)
        for stepped, entry in _descend(_nearest(model, runs, how), runs, _SHORT_STEPS, stage, how):
            model = stepped
            yield stepped, entry
        periods, stage = _LONGER * periods, "longer runs"
        # a fit of windows is useless if whole records drift away from it
        windows = 2 * periods < longest and _miss(model, _free(model, rest, data.begun), how) > max(
            _NEAR, _WORSE * _miss(model, runs, how)
        )
    free = _free(model, rest, data.begun)
    best = _nearest(model, free, how)
    scores = [held_out.score(best)]
    for stepped, entry in _descend(best, free, count, "partial runs", how):
        scores.append(held_out.score(stepped))
        if scores[-1] == min(scores):
            best = stepped
        yield best, {**entry, "held_out": min(scores)}
        if _is_flat(scores):
            break
    free = _free(best, records, data.begun)
    for stepped, entry in _descend(best, free, count, "free runs", how):
        yield stepped, {**entry, "held_out": min(scores)}


def _problem(model: Model, batches: Sequence[Runs], how: _How) -> FreeRuns:
    start, sizes = parameters(model)
    bound = lower_bound(model, sizes, how.dt / model.substeps)
    centre = np.where(np.arange(len(start)) < sizes[0], 0.0, start)  # time constants stay near their initial values
    prior = prior_weights(model, sizes, how.firmness), bound.coordinates(centre)
    return FreeRuns(model, batches, how.dt, how.every, prior=prior, bound=bound, slow=how.slow, mesh=how.mesh)


def lower_bound(model: Model, sizes, step: float) -> LowerBound:
    """Return the bound of the trained parameters: a lag of x is at least as long as a `step` (s) of the simulation.

    Runge-Kutta steps of a lag below a third of it diverge, too slowly for short windows to show it. A lag that short
    equals x, so nothing is lost.
    """
    bounds, end = np.full(sum(sizes), -np.inf), sum(sizes[:2])
    if isinstance(model.memory, FadingMemory | RingingMemory):  # the lags are the last parameters of both
        bounds[end - len(model.memory.log_tau) : end] = np.log(step)
    return LowerBound(bounds)


def _descend(model: Model, batches: Sequence[Runs], count: int, stage: str, how: _How) -> Iterator[tuple[Model, dict]]:
    runs = _problem(model, batches, how)
    costs, start = [], runs.bound.coordinates(parameters(model)[0])
    for k, (vector, cost, done) in enumerate(accelerated(runs.errors, runs.slopes, start)):
        if not np.isfinite(cost):
            raise ComputationFailed("the free runs diverged before refinement; check the recordings for spikes")
        costs.append(cost)
        how.report(stage, k, count, cost, min(costs))
        if k:  # the first is the start itself
            yield with_parameters(model, runs.bound.parameters(vector)), {"stage": stage, "step": k, "error": cost}
        if done or _is_flat(np.log(costs).tolist()) or k == count:
            return


def _is_flat(logs: Sequence[float]) -> bool:
    """Return whether the last five steps together lowered a cost by less than 5 %, from its logarithm after each."""
    return len(logs) > 5 and not logs[-1] < logs[-6] + np.log(0.95)


def _nearest(model: Model, batches: Sequence[Runs], how: _How) -> Model:
    """Multiply the model's logits by the factor (0 to 1) with the smallest simulation error."""
    runs = _problem(model, batches, how)
    scaled = [eqx.tree_at(lambda m: m.encoder, model, model.encoder.scaled(f)) for f in _SCALED]
    return scaled[int(np.argmin([runs.miss(parameters(m)[0]) for m in scaled]))]


def _miss(model: Model, batches: Sequence[Runs], how: _How) -> float:
    """Compute the rms simulation error, % of range; infinite if a simulation diverges."""
    return _problem(model, batches, how).miss(parameters(model)[0])


def prior_weights(model: Model, sizes, firmness: float) -> np.ndarray:
    """Return the prior weight rho of every trained parameter."""
    nets = eqx.filter(model.encoder.token_nets(), trainable(model).encoder)
    in_nets = np.asarray(ravel_pytree(nets)[0], np.float64)  # 1 or 0
    return np.append(_PRIOR + (firmness - _PRIOR) * in_nets, np.full(sum(sizes) - sizes[0], _PRIOR))


def thinning(model: Model, dt: float) -> int:
    """Return the number of samples between fitted errors: ten per period of the resonance, at most 8 apart.

    Neighbours on a smooth run are redundant, and fewer samples need fewer derivatives.
    """
    return int(np.clip(_period(model) / dt / 10, 1, 8))


def _period(model: Model) -> float:
    """Return the period of the nominal model's resonance, s."""
    return 2 * np.pi / model.natural_frequency


def _windows(model: Model, data: Dataset, records: Sequence[Record], periods: float = _PERIODS) -> Runs:
    """Cut the records into windows of a few periods, each simulated from its filtered initial state.

    An error is relative to the range of its record, because most windows may stand still.
    """
    size = round(np.clip(periods * _period(model) / records[0].dt, 64, np.median([r.samples for r in records])))
    places = [
        (k, first)
        for k, valid in enumerate(data.valid)
        for first in range(int(np.argmax(valid)), len(valid) - size + 1, size)
        if valid[first]
    ]
    every = max(-(-len(places) * size // BUDGET), 1)
    places = places[::every] or [(0, 0)]

    def cut(arrays):
        return jnp.asarray(np.stack([arrays[k][first : first + size] for k, first in places]), jnp.float32)

    x = [model.output.to_model(r.displacement) / model.scales.state[0] for r in records]
    seen = [np.isfinite(v) for v in x]
    count = np.bincount([k for k, _ in places], minlength=len(records))
    # a mean over samples, then windows, then records: a long record counts once
    each = _record_weights(model, records) / size / np.maximum(count, 1) / np.count_nonzero(count)
    weight = [w * s for w, s in zip(each, seen, strict=True)]
    start = jnp.stack([_begun(model, data.features[k][first], records[k].voltage[first]) for k, first in places])
    target = cut([np.where(s, v, 0.0) for v, s in zip(x, seen, strict=True)])
    return Runs(start, cut([r.voltage for r in records]), target, cut(weight))


def _begun(model: Model, features: np.ndarray, voltage: float):
    """Append the effects' states to a filtered state, as after a long time in that state."""
    held = ports.initial(model, jnp.asarray(features[0]), jnp.asarray(voltage, features.dtype), 0.0)
    return jnp.concatenate([jnp.asarray(features), held])


def run_samples(records: Sequence[Record]) -> int:
    """Return the length of the longest simulation, samples: the longest record, or less within the budget."""
    longest = max(r.samples for r in records)
    if sum(r.samples for r in records) <= BUDGET:
        return longest
    each = BUDGET // len(records) if len(records) <= _FEWEST_WHOLE else BUDGET // 2 // _FEWEST_WHOLE
    return min(longest, max(each, _SHORTEST))


def _record_weights(model: Model, records: Sequence[Record]) -> Float[np.ndarray, " records"]:
    """Return the weight of every record, 1e4 f_k / range_k^2, in the model's scaled units.

    With f_k = 1, a record with 5 % noise always contributes 25, which hides the information of one with 0.1 %.
    """
    x = [r.displacement[r.observed] / model.scales.state[0] for r in records]
    span = np.array([max(float(np.ptp(v)), 1e-12) for v in x])
    noise = noise_of(records) / model.scales.state[0] / span
    return 1e4 / span**2 * (1 + (100 * noise.min()) ** 2) / (1 + (100 * noise) ** 2)


def _free(model: Model, records: Sequence[Record], known: Sequence[Beginning] = ()) -> tuple[Runs, ...]:
    """Prepare all records for simulation; beyond the budget, some whole and the beginnings of the others.

    A record that begins at rest by the nominal model does so in every fit: a half-trained model fits another start
    better, and a model that is fitted from there predicts only from there.
    """
    size = run_samples(records)
    each = _record_weights(model, records)
    if sum(min(r.samples, size) for r in records) <= max(BUDGET, _SHORTEST * len(records)):
        sets = alike(records)  # by length, because padding to one length would be mostly padding
        sizes, parts = (
            [min(size, max(records[k].samples for k in some)) for some in sets],
            [1 / len(records)] * len(sets),
        )
    else:
        long = spread_over_kinds(records, max(BUDGET // 2 // size, 1))
        sets = [list(long), [k for k in range(len(records)) if k not in set(long)]]
        sizes, parts = (
            [size, min(size, max(BUDGET // 2 // len(sets[1]), _SHORTEST))],
            [0.5 / len(some) for some in sets],
        )
    start, spent, begun = begin(model, records, known=known)
    begins = list(zip(start, spent, with_zero_at_rest(begun), strict=True))
    return tuple(
        _from_the_start(model, [records[k] for k in some], [begins[k] for k in some], samples, part * each[some])
        for some, samples, part in zip(sets, sizes, parts, strict=True)
    )


def _from_the_start(
    model: Model, records: Sequence[Record], begins: Sequence[tuple], size: int, each: Float[np.ndarray, " records"]
) -> Runs:
    """Pad the first `size` samples of records to arrays; samples used for the initial state have no weight.

    A held record with the offset of those at rest starts at its measured level, and thus determines the static curve.
    Other held records have their own offset, projected out of their errors. A record in motion keeps the model's
    offset, as in its prediction.
    """
    shape = len(records), size
    voltage, target, weight = (np.zeros(shape, np.float32) for _ in range(3))
    starts = []
    for k, (given, (start, spent, b)) in enumerate(zip(records, begins, strict=True)):
        r = aligned(given, b, model.output)
        starts.append(_settled(model, b, r) if b.begins == "held" and not b.free else start)
        n = min(size, r.samples)
        x = model.output.to_model(r.displacement) / model.scales.state[0]
        seen = np.isfinite(x[:n])
        seen[:spent] = False
        # a jump to 0 V could make an unstable fit diverge
        voltage[k] = np.pad(r.voltage[:n], (0, size - n), mode="edge")
        target[k, :n] = np.where(seen, x[:n], 0.0)
        weight[k, :n] = each[k] * seen / max(seen.sum(), 1)
    start = jnp.stack(starts)
    own = np.array([b.free and b.begins == "held" for _, _, b in begins], np.float32)
    return Runs(start, *(jnp.asarray(v) for v in (voltage, target, weight, own)))


def _settled(model: Model, b: Beginning, record: Record):
    """Return the state of a record that starts in equilibrium at its first reading and voltage."""
    x = jnp.asarray(b.direction * (b.level - b.zero) / model.scales.state[0], model.coefficients.dtype)
    return still_state(model, x, jnp.asarray(record.voltage[0], x.dtype), 0.0)
