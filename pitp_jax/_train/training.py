"""Training: from a nominal model and records to a model with an encoder (paper, Algorithm 1, then rollouts).

    stage j:  box [b^(j+1) y, a^(j+1) y],  n r^j epochs of Adam at learning rate lr c^j on eq. 12
    stop when a wider box no longer improves the physics residual (a score that does not depend on the box)
    then:     least squares on free runs (`refine`), with the memories' and the drive's time constants

The equation error is fast and blind to what accumulates; free runs see just that (docs/readings.md, Algorithm 1).
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh

from .._errors import BadInput, ComputationFailed
from .._model.memory import RingingMemory
from .._model.model import Model
from .._model.programs import jit
from .._model_file.lineage import descended
from .._record.initial_state import aligned, in_motion
from .._record.long_record import LongRecord
from .._record.record import Record
from .._record.sets import check_set
from .._simulate.prediction import at_rate, begin
from .creep_balance import OUTLASTS, SlowBalance, slow_balance, widened
from .dataset import Dataset, build_dataset
from .equation_error import loss
from .parameters import trainable
from .refine import refine, run_samples
from .settings import Settings, firmness_of, memory_of, preset_of, with_encoder, with_parts

_OPTIMISER = optax.scale_by_adam()


@dataclass(frozen=True)
class Progress:
    """One line of progress: what is running, how far, and how well."""

    stage: str
    step: int
    steps: int
    box: float | None
    loss: float
    best: float
    seconds_left: float


@dataclass(frozen=True)
class Training:
    """The trained model, the history of its losses, whether it was cut short, and its summary (`left_out`: lines)."""

    model: Model
    history: tuple[dict, ...]
    interrupted: bool
    notes: dict = field(default_factory=dict)


def train(
    nominal: Model,
    records: Sequence[Record],
    *,
    preset: str = "default",
    settings: Settings | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    mesh: Mesh | None = None,
    key,
) -> Training:
    """Train an encoder on records, starting exactly at the nominal model.

    Args:
        nominal: an identified model; order, input map, hold and output are kept. Its effects come in with the free
            runs, and their numbers are fitted along.
        records: the training records, one sampling rate; those in which nothing moves are left out (`in_motion`).
        preset: "default" or "paper"; `settings` overrides it.
        progress: called after every epoch and every refinement step.
        mesh: devices of this process that share the free runs, by records (`records_mesh`); default one device.
        key: JAX key; the same key, records and machine give the same model.

    Returns:
        the model, losses per stage, and notes.

    Raises:
        BadInput: unknown preset, records of several rates, none that moves, a mesh over several processes, or no
            usable sample left after filtering.
        ComputationFailed: the loss is not finite.
        KeyboardInterrupt: interrupted before the first stage was complete (later ones return the best so far).

    Example:
        >>> trained = pitp.train(model, records, key=jax.random.key(0)).model  # doctest: +SKIP
    """
    settings = preset_of(preset) if settings is None else settings
    check_set(records)
    if mesh is not None and mesh.is_multi_process:
        raise BadInput("training runs in one process: its mesh may only hold jax.local_devices()")
    records, left_out = in_motion(records)
    seen, parent = records, nominal
    nominal = at_rate(nominal, records[0].dt)
    records = [aligned(r, b, nominal.output) for r, b in zip(records, begin(nominal, records)[2], strict=True)]
    key_init, key_stages = jax.random.split(key)
    data, slow = _prepared(nominal, records, settings)
    model = with_encoder(data, settings, key_init)
    history: list[dict] = []
    best, interrupted, began = None, False, time.monotonic()
    try:
        for found, entry in _improvements(model, nominal, data, slow, records, settings, key_stages, progress, mesh):
            best = found
            history.append(entry)
    except KeyboardInterrupt:
        if best is None:
            raise
        interrupted = True
    if best is None:
        raise BadInput("settings allow no training stage: set stages to 1 or more")
    notes = {"settings": asdict(settings), "seconds": round(time.monotonic() - began, 1), "history": history,
             "records": [r.name for r in records], "left_out": left_out, "samples": int(data.equation.force.shape[0]),
             "creep_held_to_s": round(slow.seconds, 1) if slow else None, "second_mass_hz": _second_mass_hz(best),
             "interrupted": interrupted}  # fmt: skip
    made = descended(_annotated(best, data, slow, records, notes), "fit", seen, parent)
    return Training(made, tuple(history), interrupted, notes)


def _prepared(nominal: Model, records, settings: Settings) -> tuple[Dataset, SlowBalance | None]:
    """What training reads; with the slow balance where the nominal keeps a record that outlasts the free runs.

    Not where the nominal has effects of its own, which that balance would not hold.
    """

    def dataset(long: LongRecord | None) -> Dataset:
        return build_dataset(replace(nominal, effects=()), records, scaling=settings.scaling,
                             difference=settings.difference,
                             memory=partial(memory_of, settings, nominal, long))  # fmt: skip

    long, seen = nominal.provenance.long_record, run_samples(records) * records[0].dt
    fits = settings.memory == "fading" and settings.refine_steps > 0 and not nominal.effects
    if long and fits and long.seconds > OUTLASTS * seen:
        data = dataset(long)
        if slow := slow_balance(data.model, long, data.region):
            return replace(data, region=widened(data.region, slow.features(data.model))), slow
    return dataset(None), None


def _improvements(
    model: Model, nominal, data: Dataset, slow: SlowBalance | None, records, settings: Settings, key, progress,
    mesh: Mesh | None,
):  # fmt: skip
    """Yield (best model so far, history entry): the stages on the equation error, then the free runs."""
    best = None
    for best, entry in _stages(model, data, settings, key, progress):
        yield best, entry
    if best is not None and settings.refine_steps:
        yield from refine(
            with_parts(best, nominal, settings), data, records, settings.refine_steps, partial(_report, progress),
            firmness=firmness_of(settings, model, len(records)), slow=slow, mesh=mesh,
        )  # fmt: skip


def _report(progress, stage, step, steps, value, best, seconds_left):
    progress(Progress(stage, step, steps, None, value, best, seconds_left))


def _stages(model: Model, data: Dataset, settings: Settings, key, progress):
    """Algorithm 1: yield (best model, history entry) after every stage."""
    total = sum(max(1, int(settings.epochs * settings.decay_epochs**j)) for j in range(settings.stages))
    best_model, best, constraint, count, began = model, np.inf, np.inf, 0, time.monotonic()
    for j in range(settings.stages):
        box = (settings.narrow ** (j + 1), settings.widen ** (j + 1))
        params, static = eqx.partition(best_model.encoder, trainable(best_model).encoder)  # no time constant: `loss`
        state = _OPTIMISER.init(params)
        epochs = max(1, int(settings.epochs * settings.decay_epochs**j))
        at_stage = best
        for epoch in range(epochs):
            key, sub = jax.random.split(key)
            fade = 0.5 * (1 + np.cos(np.pi * epoch / epochs)) if settings.encoder == "compact" else 1.0
            rate = settings.rate * settings.decay_rate**j * (0.05 + 0.95 * fade)
            box_rate = jnp.asarray(box, jnp.float32), jnp.asarray(rate, jnp.float32)
            params, state, (physics, constraint) = _epoch(
                params, static, state, model, data.equation, *box_rate, settings, sub
            )
            physics, constraint, count = float(physics), float(constraint), count + 1
            if not np.isfinite(physics + constraint):
                raise ComputationFailed(_nan_advice(f"stage {j + 1}, epoch {epoch + 1}"))
            if physics < best:
                best, best_model = physics, replace(best_model, encoder=eqx.combine(params, static))
            left = (time.monotonic() - began) / count * (total - count)
            progress(Progress(f"stage {j + 1}", epoch + 1, epochs, box[1], physics + constraint, best, left))
        yield (
            best_model,
            {"stage": j + 1, "box": list(box), "physics": best, "constraint": constraint, "epochs": epochs},
        )
        if best > (1 - settings.tolerance) * at_stage:
            return


def _nan_advice(place: str) -> str:
    return (
        f"the loss became nan in {place}: the records may hold a sensor spike or a wrong unit; "
        "check them with `pitp predict` on the nominal model, or lower the learning rate"
    )


@jit
def _epoch(params, static, state, model: Model, data, box, rate, settings: Settings, key):
    """One epoch over shuffled minibatches as one compiled scan; an incomplete batch is left to the next shuffle."""
    count = max(data.force.shape[0] // settings.batch, 1)
    size = min(settings.batch, data.force.shape[0])
    shuffle, drop = jax.random.split(key)
    order = jax.random.permutation(shuffle, data.force.shape[0])[: count * size].reshape(count, size)
    dropout = settings.encoder == "paper"

    def objective(p, batch, k):
        here = replace(model, encoder=eqx.combine(p, static))
        return loss(here, batch, box, width=settings.huber, penalty=settings.penalty, key=k)

    def update(carry, item):
        p, s = carry
        index, k = item
        grads, parts = eqx.filter_grad(objective, has_aux=True)(p, data.take(index), k if dropout else None)
        updates, s = _OPTIMISER.update(grads, s, p)
        updates = jax.tree.map(lambda u: -rate * u, updates)
        return (eqx.apply_updates(p, updates), s), jnp.stack(parts)

    keys = jax.random.split(drop, count)
    (params, state), parts = jax.lax.scan(update, (params, state), (order, keys))
    return params, state, tuple(parts.mean(0))


def _region(model: Model, data: Dataset, slow: SlowBalance | None, dt: float) -> tuple[tuple[float, float], ...]:
    """Lowest and highest value of every feature, with the memories as they were learned."""
    n, seen = model.order, []
    for found, valid in zip(data.features, data.valid, strict=True):
        past = np.asarray(model.memory.trajectory(jnp.asarray(found[:, 0]), dt, jnp.asarray(found[0, n:])))
        seen.append(np.concatenate([found[:, :n], past], -1)[valid])
    rows = np.concatenate(seen)
    region = tuple((float(a), float(b)) for a, b in zip(rows.min(0), rows.max(0), strict=True))
    return widened(region, slow.features(model)) if slow else region


def _second_mass_hz(model: Model) -> float | None:
    """Where what hangs on the moved mass resonates by itself, Hz."""
    memory = model.memory
    return float(memory.ring[0]) / (2 * np.pi) if isinstance(memory, RingingMemory) else None


def _annotated(model: Model, data: Dataset, slow: SlowBalance | None, records, notes: dict) -> Model:
    """The model with its trained region, the drives it has seen and the training summary in its provenance."""
    told = json.dumps({**json.loads(model.provenance.notes), "training": notes})
    dt = records[0].dt
    seen = model.provenance.driven_by(records).with_(dt=dt, region=_region(model, data, slow, dt), notes=told)
    return replace(model, provenance=seen.with_(covariance=(), misfit=float("inf")))  # an encoder stands beside it now
