"""Train an encoder from a nominal model and records (paper, Algorithm 1, then fits of simulations).

    stage j:  box [b^(j+1) y, a^(j+1) y],  n r^j epochs of Adam at learning rate lr c^j on eq. 12
    stop when a wider box no longer improves the physics residual (a score that does not depend on the box)
    then:     least squares on free runs (`refine`), with the memories' and the drive's time constants
    then:     held-out blocks and all records compared with the nominal (`errors`); other starts if not converged

The equation error is quick but does not show errors that build up over a run; free runs fit exactly those
(docs/readings.md, Algorithm 1).
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh

from ...common.errors import BadInput, ComputationFailed
from ...common.shown import Shown
from ..fit.parameters import trainable
from ..model.coverage import with_excited
from ..model.dominant import has_spring
from ..model.fitted import Fitted, fitted_of
from ..model.lineage import descended
from ..model.memory import RingingMemory
from ..model.model import Model
from ..model.programs import jit
from ..signal.initial_state import Beginning, aligned, in_motion
from ..signal.long_record import LongRecord
from ..signal.record import Record
from ..signal.reduced import reduce_rate
from ..signal.sets import check_set
from ..simulate.beginnings import with_zero_at_rest
from ..simulate.prediction import begin
from .creep_balance import OUTLASTS, SlowBalance, slow_balance
from .dataset import Dataset, build_dataset, region_of
from .equation_error import loss
from .errors import Judge, RecordError, judge, kept
from .refine import BUDGET, HeldOut, refine, run_samples
from .settings import Settings, firmness_of, memory_of, preset_of, with_encoder, with_parts

_OPTIMISER = optax.scale_by_adam()
_PER_PERIOD = 40.0  # samples that a free run needs of a period (docs/decisions/training.md)


@dataclass(frozen=True)
class Progress:
    """One report of progress: the current part of the training, its step, and its loss."""

    stage: str
    step: int
    steps: int
    box: float | None
    loss: float
    best: float


@dataclass(frozen=True, repr=False)
class Training(Shown):
    """A trained model with the history of its losses, its errors on the training records, and notes.

    `notes`: a summary; `left_out` lists the recordings without motion. `errors`: of every training record with the
    nominal and with this model. `problems`: lines on failures. `fallback`: the model returned in place of the trained
    one, or None. `interrupted`: whether the user interrupted the training.
    """

    model: Fitted
    history: tuple[dict, ...]
    interrupted: bool
    notes: dict = field(default_factory=dict)
    errors: tuple[RecordError, ...] = ()
    problems: tuple[str, ...] = ()
    fallback: str | None = None

    def _rows(self) -> list[dict]:
        return [vars(e) for e in self.errors]


def train(
    nominal: Model | Fitted,
    records: Sequence[Record],
    *,
    preset: str = "default",
    settings: Settings | None = None,
    progress: Callable[[Progress], None] = lambda _: None,
    mesh: Mesh | None = None,
    encoder: eqx.Module | Callable[..., eqx.Module] | None = None,
    key,
) -> Training:
    """Train an encoder on records, with initial weights for which the model equals the nominal one.

    The model has smaller errors than the nominal (mean logarithm over records), over all samples and on blocks held out
    of its fit; `problems` names records on which it is over 1 % worse. If no start achieves this, the nominal is
    returned in the trained model's form, and `fallback` reports it. Oversampled records are first averaged over blocks
    (`reduce_rate`); the model remains valid for their own rate.

    Args:
        nominal: an identified model (`Fitted`, or a bare `Model`); order, input map, hold and output are kept. Its
            effects are added with the free runs, and their parameters are fitted as well.
        records: the training records, one sampling rate; records without motion are left out (`in_motion`).
        preset: "default" or "paper"; `settings` overrides it.
        progress: called after every epoch and every refinement step.
        mesh: devices of this process that share the free runs, by records (`records_mesh`); default one device.
        encoder: your own, instead of the preset's: an Equinox module as `OwnEncoder` describes it, or fn(features,
            logits, key=key) that makes one. With a module there is no test for a second mass, so it takes order +
            `Settings.memories` features. Training starts from its weights: at the nominal if its last layer is zero.
        key: JAX key; the same key, records and machine give the same model.

    Returns:
        the model (a `Fitted`), losses per stage, and notes.

    Raises:
        BadInput: unknown preset, records of several rates, none that moves, a mesh over several processes, or no
            usable sample left after filtering.
        KeyboardInterrupt: interrupted before the first stage was complete (later ones return the best so far).

    Examples:
        >>> trained = pitp.train(model, records, key=jax.random.key(0)).model  # doctest: +SKIP
    """
    settings = _settings_for(encoder, settings or preset_of(preset), fitted_of(nominal).model)
    check_set(records)
    if mesh is not None and mesh.is_multi_process:
        raise BadInput("training runs in one process; give a mesh that holds only jax.local_devices()")
    seen, motionless = in_motion(records)
    parent = fitted_of(nominal)
    nominal = parent.model.sampled(seen[0].dt, parent.hold)
    compare = judge(nominal, seen)
    records, nominal = reduce_rate(seen, nominal, _PER_PERIOD, BUDGET)
    # the equation error needs x itself, so each record's own offset and direction are taken out first
    begun = with_zero_at_rest(begin(nominal, records)[2])
    nominal = _with_zero(nominal, parent.origin.long_record, begun)
    records = [aligned(r, b, nominal.output) for r, b in zip(records, begun, strict=True)]
    data, slow = _prepared(nominal, parent.origin.long_record, records, settings)
    history: list[dict] = []
    best, gain, interrupted, began = None, np.inf, False, time.monotonic()
    try:
        for found, score, entry in _attempts(
            nominal, data, slow, records, compare, settings, encoder, key, progress, mesh
        ):
            best, gain = found, score
            history.append(entry)
    except KeyboardInterrupt:
        if best is None:
            raise
        interrupted = True  # the best model so far is returned after an interrupt, and marked as interrupted
    if best is None:
        raise BadInput("settings: no training stage; set stages to 1 or more")
    chosen, problems, fallback = kept(compare(best, gain), compare, _bare(best, nominal, data, settings))
    if records[0].dt != seen[0].dt:  # trained on block means
        chosen = replace(chosen, model=chosen.model.sampled(seen[0].dt, parent.hold))
    notes = {"settings": asdict(settings), "seconds": round(time.monotonic() - began, 1), "history": history,
             "records": [r.name for r in records], "left_out": motionless, "samples": int(data.equation.force.shape[0]),
             "creep_held_to_s": slow and round(slow.seconds, 1), "second_mass_hz": _second_mass_hz(best),
             "errors": {e.name: [e.nominal, e.trained] for e in chosen.errors}, "problems": problems,
             "interrupted": interrupted, "fallback": fallback, "trained_at_hz": 1 / records[0].dt}  # fmt: skip
    region = _region(chosen.model, data, slow, records[0].dt)
    domain = replace(chosen.model.domain.driven_by(seen), dt=seen[0].dt, region=region)
    # With an encoder, the origin's statements on the coefficients no longer describe the model.
    origin = replace(parent.origin, covariance=np.zeros((0, 0)), misfit=np.inf, training=notes, level=_level(history),
                     errors=())  # fmt: skip
    origin = with_excited(origin, seen)
    model = descended(Fitted(replace(chosen.model, domain=domain), origin), "fit", seen, parent)
    return Training(model, tuple(history), interrupted, notes, chosen.errors, tuple(problems), fallback)


def _settings_for(encoder, settings: Settings, nominal: Model) -> Settings:
    """Return the settings for a user's own encoder, of which a module fixes the number of memories, and for a nominal.

    Without a spring no position differs from another, and a lag of x is a position as well.
    """
    if encoder is not None:
        return replace(settings, encoder="own", ringing=settings.ringing and not isinstance(encoder, eqx.Module))
    if settings.encoder == "own":
        raise BadInput("settings: encoder 'own' needs your encoder; give train(..., encoder=MODULE)")
    free = settings.encoder == "compact" and not has_spring(nominal.physical_coefficients)
    return replace(settings, memory="none") if free else settings


def _with_zero(nominal: Model, long: LongRecord | None, begun: Sequence[Beginning]) -> Model:
    """Return the nominal model with the sensor offset of records at rest, if its own was not measured at 0 V."""
    known = [b for b in begun if not b.free]
    if long is None or long.rest or not known:
        return nominal
    return replace(nominal, output=replace(nominal.output, offset=known[0].zero))


def _prepared(
    nominal: Model, long: LongRecord | None, records, settings: Settings
) -> tuple[Dataset, SlowBalance | None]:
    """Prepare the training data, with creep windows if the stored long record outlasts the simulations.

    A nominal with its own effects is excluded, because that balance does not include them.
    """

    def dataset(long: LongRecord | None) -> Dataset:
        return build_dataset(replace(nominal, effects=()), records, scaling=settings.scaling,
                             difference=settings.difference,
                             memory=partial(memory_of, settings, nominal, long))  # fmt: skip

    seen = run_samples(records) * records[0].dt
    fits = settings.memory == "fading" and settings.refine_steps > 0 and not nominal.effects
    if long and fits and long.seconds > OUTLASTS * seen:
        data = dataset(long)  # again, below, if no window counts: its memories would be too long for the data
        if slow := slow_balance(data.model, long, data.region):
            return replace(data, region=region_of(data.region.T, slow.features(data.model))), slow
    return dataset(None), None


def _attempts(
    nominal, data: Dataset, slow: SlowBalance | None, records, compare: Judge, settings: Settings, own, key,
    progress, mesh: Mesh | None,
):  # fmt: skip
    """Yield (best model so far, its held-out gain, history entry) of the first start, and of others as needed.

    1: the stages on the equation error, then free runs. 2, 3, ...: free runs from the nominal itself, whose logits are
    zero, from start 3 with ten times firmer nets each time. A start that no longer improves the score is the last.
    """

    def report(stage, step, steps, value, best):
        progress(Progress(stage, step, steps, None, value, best))

    def refined(model: Model, firm: float):
        firmness, steps = firm * firmness_of(settings, model, len(records)), settings.refine_steps
        return refine(model, data, held_out, steps, report, firmness=firmness, slow=slow, mesh=mesh)

    init, sub = jax.random.split(key)
    model = None
    for model, entry in _stages(with_encoder(data, settings, own, init), data, settings, sub, progress):
        yield model, np.inf, entry
    if model is None or not settings.refine_steps:
        return
    held_out, best, model = HeldOut(records, data.begun), None, with_parts(model, nominal, settings)
    plain = held_out.score(_bare(model, nominal, data, settings))
    start = 0
    for start in range(1, settings.starts + 1):
        if start > 1:
            fresh = with_encoder(data, settings, own, jax.random.fold_in(init, start))
            model = with_parts(fresh, nominal, settings)
        gain = np.inf
        with suppress(ComputationFailed):  # a fit whose simulations diverge ends; training continues with another one
            for step, entry in refined(model, 10.0 ** max(start - 2, 0)):
                model = step
                gain = (plain - entry.get("held_out", -np.inf)) / 2
                # an interrupt returns the best, not an unfinished one
                yield (model, gain, entry) if best is None else (best.model, best.held_out, {**entry, "start": start})
        found = compare(model, gain)
        # a start that gains less in the log score is the last one
        ends = best is not None and best.gain > 0 and found.gain < best.gain + 0.05
        best = max(filter(None, (best, found)), key=lambda c: c.gain)
        if best.converged or ends:
            break
    if best is not None and start > 1:
        yield best.model, best.held_out, {"stage": "best", "error": best.mean**2}


def _bare(model: Model, nominal: Model, data: Dataset, settings: Settings) -> Model:
    """Return the nominal model in the form of a trained one: zero logits and no electrode lag."""
    start = replace(model, drive=data.model.drive, memory=data.model.memory)
    bare = with_parts(start, nominal, replace(settings, parts=(), drive="direct"))
    return replace(bare, encoder=model.encoder.scaled(0.0))


def _stages(model: Model, data: Dataset, settings: Settings, key, progress):
    """Run Algorithm 1 of the paper: yield (best model, history entry) after every stage."""
    best_model, best, constraint = model, np.inf, np.inf
    for j in range(settings.stages):
        box = (settings.narrow ** (j + 1), settings.widen ** (j + 1))
        params, static = eqx.partition(best_model.encoder, trainable(best_model).encoder)  # no time constant: `loss`
        state = _OPTIMISER.init(params)  # a stage starts at the best weights so far, so it needs new momentum
        epochs = max(1, int(settings.epochs * settings.decay_epochs**j))
        at_stage = best
        for epoch in range(epochs):
            key, sub = jax.random.split(key)
            # a half cosine down to a twentieth, so that the noise of minibatches settles within a stage
            fade = 0.5 * (1 + np.cos(np.pi * epoch / epochs)) if settings.encoder != "paper" else 1.0
            rate = settings.rate * settings.decay_rate**j * (0.05 + 0.95 * fade)
            box_rate = np.asarray(box, np.float32), np.float32(rate)
            params, state, (physics, constraint) = _epoch(
                params, static, state, model, data.equation, *box_rate, sub, **in_an_epoch(settings)
            )
            physics, constraint = float(physics), float(constraint)
            if not np.isfinite(physics + constraint):
                yield best_model, {"stage": j + 1, "epochs": epoch + 1, "diverged": True}
                return  # free runs start at the best so far: at first the nominal
            if physics < best:
                best, best_model = physics, replace(best_model, encoder=eqx.combine(params, static))
            progress(Progress(f"stage {j + 1}", epoch + 1, epochs, box[1], physics + constraint, best))
        yield (
            best_model,
            {"stage": j + 1, "box": list(box), "physics": best, "constraint": constraint, "epochs": epochs},
        )
        if best > (1 - settings.tolerance) * at_stage:
            return


def in_an_epoch(settings: Settings) -> dict:
    """Return the settings on which the compiled program of an epoch depends; the benchmarks time it with the same."""
    dropout = settings.encoder != "compact"
    return {"batch": settings.batch, "width": settings.huber, "penalty": settings.penalty, "dropout": dropout}


@jit
def _epoch(params, static, state, model: Model, data, box, rate, key, *, batch: int, width, penalty, dropout: bool):
    """Run one epoch over shuffled minibatches as one compiled scan; an incomplete batch is left out."""
    samples = len(data.force)
    count, size = max(samples // batch, 1), min(batch, samples)
    shuffle, drop = jax.random.split(key)
    order = jax.random.permutation(shuffle, samples)[: count * size].reshape(count, size)

    def objective(p, some, k):
        here = replace(model, encoder=eqx.combine(p, static))
        return loss(here, some, box, width=width, penalty=penalty, key=k)

    def update(carry, item):
        p, s = carry
        index, k = item
        grads, parts = eqx.filter_grad(objective, has_aux=True)(p, data.take(index), k if dropout else None)
        updates, s = _OPTIMISER.update(grads, s, p)
        # outside the optimiser; inside, the rate would be a constant and every epoch its own program
        updates = jax.tree.map(lambda u: -rate * u, updates)
        return (eqx.apply_updates(p, updates), s), jnp.stack(parts)

    keys = jax.random.split(drop, count)
    (params, state), parts = jax.lax.scan(update, (params, state), (order, keys))
    return params, state, tuple(parts.mean(0))


def _region(model: Model, data: Dataset, slow: SlowBalance | None, dt: float) -> np.ndarray:
    """Return the lowest and highest value of every feature, with the trained memories, shape (features, 2)."""
    n, seen = model.order, [slow.features(model)] if slow else []
    for features, valid in zip(data.features, data.valid, strict=True):
        # free runs changed the time constants, and with them the memories
        past = model.memory.trajectory(jnp.asarray(features[:, 0]), dt, jnp.asarray(features[0, n:]))
        seen.append(np.concatenate([features[:, :n], past], -1)[valid])
    return region_of(*seen)


def _second_mass_hz(model: Model) -> float | None:
    """Return the eigenfrequency of the second mass alone, Hz; None without a second mass."""
    memory = model.memory
    return float(memory.ring[0]) / (2 * np.pi) if isinstance(memory, RingingMemory) else None


def _level(history: Sequence[dict]) -> float:
    """Return e_rms (%) of the best fit of whole simulations; nan if there was none."""
    return float(np.sqrt(min((e["error"] for e in history if e["stage"] == "free runs"), default=np.nan)))
