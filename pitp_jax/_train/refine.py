"""Refinement: the trained model's free runs against the records, by least squares (the output error).

    minimise  mean over records of  mean_t ( 100 (x(t) - x_measured(t)) / range )^2  +  sum_k rho_k (p_k - p_k0)^2

Levenberg-Marquardt (`geodesic_steps`), first on windows of six periods from their filtered states, then on whole
records from their own starts, as predictions run. Creep that outlasts them is met beside (`creep_balance`). Every
trained number is free: encoder weights, memory and drive time constants, and those of effects the model was given.
Where all records exceed the budget, half of it goes to some that stand for all, to their ends, since nothing else sees
creep within a record, and half to the beginnings of the others, since a resonance is narrow. On a cone it takes the
held-out median from 0.91 to 0.27 %; what else was tried: docs/decisions/free_runs.md.
"""

import time
from collections.abc import Iterator, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh

from .._errors import ComputationFailed
from .._model.model import Model
from .._numerics.geodesic_steps import steps
from .._record.excitation_kind import spread_over_kinds
from .._record.initial_state import aligned
from .._record.record import Record
from .._record.sets import alike
from .._simulate import ports
from .._simulate.decoder import rollout_batch
from .._simulate.prediction import begin
from .creep_balance import SlowBalance
from .dataset import Dataset
from .forward_sensitivity import Runs
from .free_run_problem import FreeRuns
from .parameters import parameters, trainable, with_parameters

_BUDGET = 400_000  # samples in all
_FEWEST, _SHORTEST = 12, 1000  # whole records, and samples of a cut one
_SHORT_STEPS, _PERIODS = 12, 6.0
_NEAR = 5.0  # times the largest displacement to meet; from further off no step led down
_PRIOR = 1e-4  # rho of every trained number but the weights of the nets of spring and damping
_PATIENCE, _SLOW = 5, 0.01  # stop when that many steps together lower the error by less than this share


def refine(
    model: Model,
    data: Dataset,
    records: Sequence[Record],
    count: int,
    report,
    *,
    firmness: float = _PRIOR,
    slow: SlowBalance | None = None,
    mesh: Mesh | None = None,
) -> Iterator[tuple[Model, dict]]:
    """Yield (model, history entry) after every step that lowers the error; `count` at most on whole records.

    `firmness`: rho of the nets of spring and damping, in (1 %)^2; see `Settings`. `slow`: what else is to be met.
    """
    dt = records[0].dt
    short = _windows(model, data, records)
    rest = report, firmness, slow, mesh
    for found, entry in _descend(_tamed(model, (short,), dt), (short,), dt, _SHORT_STEPS, "short runs", *rest):
        model = found
        yield found, entry
    free = _free(model, records)
    yield from _descend(_tamed(model, free, dt), free, dt, count, "free runs", *rest)


def _descend(
    model: Model,
    batches: Sequence[Runs],
    dt: float,
    count: int,
    stage: str,
    report,
    firmness: float,
    slow: SlowBalance | None,
    mesh: Mesh | None,
) -> Iterator[tuple[Model, dict]]:
    start, sizes = parameters(model)
    centre = np.where(np.arange(len(start)) < sizes[0], 0.0, start)  # time constants stay near where they began
    prior = _prior(model, sizes, firmness), centre
    runs = FreeRuns(model, batches, dt, _thinning(model, dt), prior=prior, slow=slow, mesh=mesh)
    costs, began = [], time.monotonic()
    for k, (vector, cost, done) in enumerate(steps(runs.errors, runs.slopes, start)):
        if not np.isfinite(cost):
            raise ComputationFailed("the free runs diverged before refinement; check the records for spikes")
        costs.append(cost)
        left = (time.monotonic() - began) / (k + 1) * (count - k)
        report(stage, k, count, cost, min(costs), left)
        if k:
            yield with_parameters(model, vector), {"stage": stage, "step": k, "error": cost}
        settled = k >= _PATIENCE and costs[-1] > (1 - _SLOW) * costs[-1 - _PATIENCE]
        if done or settled or k == count:
            return


def _prior(model: Model, sizes, firmness: float) -> np.ndarray:
    """Rho of every trained number."""
    nets = eqx.filter(model.encoder.token_nets(), trainable(model).encoder)
    share = np.asarray(ravel_pytree(nets)[0], np.float64)
    return np.append(_PRIOR + (firmness - _PRIOR) * share, np.full(sum(sizes) - sizes[0], _PRIOR))


def _thinning(model: Model, dt: float) -> int:
    """Every how many samples the error is taken: ten to a period of the resonance, at most every eighth."""
    return int(np.clip(_period(model) / dt / 10, 1, 8))


def _period(model: Model) -> float:
    """Of the nominal's resonance, s."""
    return 2 * np.pi / model.natural_frequency


def _windows(model: Model, data: Dataset, records: Sequence[Record]) -> Runs:
    """Windows of a few periods, side by side, each from its filtered state: no run can leave the data far behind."""
    size = int(np.clip(_PERIODS * _period(model) / records[0].dt, 64, np.median([r.samples for r in records])))
    places = [
        (k, first)
        for k, valid in enumerate(data.valid)
        for first in range(int(np.argmax(valid)), len(valid) - size + 1, size)
        if valid[first]
    ]
    share = max(-(-len(places) * size // _BUDGET), 1)
    places = places[::share] or [(0, 0)]

    def cut(arrays):
        return jnp.asarray(np.stack([arrays[k][first : first + size] for k, first in places]), jnp.float32)

    x = [model.output.to_model(r.displacement) / model.scales.state[0] for r in records]
    seen = [np.isfinite(v) for v in x]
    weight = [1e4 * s / size / np.ptp(v[s]) ** 2 / len(places) for v, s in zip(x, seen, strict=True)]
    start = jnp.stack([_begun(model, data.features[k][first], records[k].voltage[first]) for k, first in places])
    target = cut([np.where(s, v, 0.0) for v, s in zip(x, seen, strict=True)])
    return Runs(start, jnp.zeros(len(places), jnp.float32), cut([r.voltage for r in records]), target, cut(weight))


def _begun(model: Model, features: np.ndarray, voltage: float):
    """A filtered state with the effects' states as if it had been held there."""
    held = ports.initial(model, jnp.asarray(features[0]), jnp.asarray(voltage, features.dtype), 0.0)
    return jnp.concatenate([jnp.asarray(features), held])


def run_samples(records: Sequence[Record]) -> int:
    """How many samples the longest free run has: all of the longest record, if all or some such fit the budget."""
    longest = max(r.samples for r in records)
    share = _BUDGET // len(records) if len(records) <= _FEWEST else _BUDGET // 2 // _FEWEST
    return longest if sum(r.samples for r in records) <= _BUDGET else min(longest, max(share, _SHORTEST))


def _free(model: Model, records: Sequence[Record]) -> tuple[Runs, ...]:
    """All records, or some that stand for all and the beginnings of the others; each of the two counts half."""
    size = run_samples(records)
    if sum(min(r.samples, size) for r in records) <= max(_BUDGET, _SHORTEST * len(records)):
        sets = [[records[k] for k in places] for places in alike(records)]
        longest = [min(size, max(r.samples for r in some)) for some in sets]
        shares = [len(some) / len(records) for some in sets]
        return tuple(_from_the_start(model, *one) for one in zip(sets, longest, shares, strict=True))
    long = spread_over_kinds(records, max(_BUDGET // 2 // size, 1))
    others = [r for k, r in enumerate(records) if k not in set(long)]
    brief = min(size, max(_BUDGET // 2 // len(others), _SHORTEST))
    parts = ([records[k] for k in long], size), (others, brief)
    return tuple(_from_the_start(model, some, samples, 0.5) for some, samples in parts)


def _from_the_start(model: Model, records: Sequence[Record], size: int, share: float) -> Runs:
    """Padded arrays of the first `size` samples; what an initial state was estimated from has no weight.

    Records that do not begin at rest have a zero of their own, projected out of their errors.
    """
    shape = len(records), size
    voltage, target, weight = (np.zeros(shape, np.float32) for _ in range(3))
    start, spent, begun = begin(model, records)
    for k, (given, b) in enumerate(zip(records, begun, strict=True)):
        r = aligned(given, b, model.output)
        n = min(size, r.samples)
        x = model.output.to_model(r.displacement) / model.scales.state[0]
        seen = np.isfinite(x[:n])
        seen[: spent[k]] = False
        voltage[k, :n], voltage[k, n:] = r.voltage[:n], r.voltage[n - 1]
        target[k, :n] = np.where(seen, x[:n], 0.0)
        span = np.nanmax(x) - np.nanmin(x)
        weight[k, :n] = share * 1e4 * seen / max(seen.sum(), 1) / span**2 / len(records)
    rest = np.asarray(~start[:, : model.order].any(1), np.float32)
    own = np.array([b.begins != "rest" for b in begun], np.float32)
    return Runs(start, *(jnp.asarray(v) for v in (rest, voltage, target, weight, own)))


def _tamed(model: Model, batches: Sequence[Runs], dt: float) -> Model:
    """The model with its logits scaled down until every free run stays finite: at zero it is the linear nominal."""
    for factor in (1.0, 0.7, 0.4, 0.2, 0.0):
        tried = eqx.tree_at(lambda m: m.encoder, model, model.encoder.scaled(factor))
        if all(_stays(tried, runs, dt) for runs in batches):
            return tried
    return tried


def _stays(model: Model, runs: Runs, dt: float) -> bool:
    """Every run is finite and somewhere near what it is to meet."""
    x = np.asarray(rollout_batch(model, runs.voltage, dt, runs.start))[..., 0]
    return bool(np.isfinite(x).all() and np.abs(x).max() < _NEAR * float(jnp.abs(runs.target).max()))
