"""Training: from a nominal model and records to a model with an encoder (paper, Algorithm 1, then rollouts).

    stage j:  box [b^(j+1) y, a^(j+1) y],  n r^j epochs of Adam at learning rate lr c^j on eq. 12
    stop when a wider box no longer improves the physics residual (a score that does not depend on the box)
    then:     least squares on free runs (`_refine`), with the memories' and the drive's time constants

The equation error is fast and blind to what accumulates; free runs see just that. See PAPER_READINGS, Algorithm 1.
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

from ._dataset import Dataset, build_dataset
from ._errors import BadInput, ComputationFailed
from ._model.drive import ElectrodeLag
from ._model.encoder import CompactEncoder, PaperEncoder
from ._model.input_map import SquareInput
from ._model.memory import ElapsedTime, FadingMemory, NoMemory
from ._model.model import Model
from ._record.record import Record
from ._refine import refine
from ._residual import loss
from ._sensitivity import trainable

_WORDS = {
    "encoder": ("compact", "paper"),
    "memory": ("fading", "elapsed", "none"),
    "drive": ("electrode", "direct"),
    "scaling": ("rms", "paper"),
    "difference": ("stencil", "central"),
}


@dataclass(frozen=True)
class Settings:
    """What a preset fixes; the paper's symbols (Algorithm 1, III-D) in brackets.

    Attributes:
        encoder: "compact" or "paper".
        width: hidden size of the compact encoder's nets.
        offset: whether the compact encoder has an offset token.
        memory: "fading", "elapsed" or "none".
        memories: how many fading memories, log-spaced from 2 / omega_0 to the longest record (to half
            of it: a 50 s record after training on 10 s drifted by 1.3 % of range, against 0.6 %).
        drive: "electrode" (a lag before the square, where there is one, learned from 0.1 / omega_0 on) or "direct".
        scaling: "rms" (training rms of each derivative) or "paper" (eq. 3).
        difference: "stencil" (8th order) or "central" (eq. 8).
        epochs [n], decay_epochs [r], rate [lr], decay_rate [c], widen [a], narrow [b], penalty [alpha, beta]: stages.
        stages: most stages.
        tolerance [epsilon]: a stage must lower the physics residual by this share to earn another.
        huber: width of SmoothL1 in units of the largest force.
        batch: minibatch size.
        refine_steps: most Levenberg-Marquardt steps on free runs.
        firmness: how firmly free runs hold the nets of spring and damping at zero, in (1 %)^2 (the polynomials beside
            them at 1e-4). Default: 1e-4 behind a square, 1e-3 behind a linear input, where no rubber creeps. 1e-3
            extrapolates in amplitude (Silverbox at 1.3 times the trained one: 0.52 -> 0.27 mV) and costs a film some
            accuracy (cone100: median 0.26 -> 0.29 %, worst 0.6 -> 1.3 %).

    Raises:
        BadInput: an unknown word.
    """

    encoder: str = "compact"
    width: int = 8
    offset: bool = True
    memory: str = "fading"
    memories: int = 5
    drive: str = "electrode"
    scaling: str = "rms"
    difference: str = "stencil"
    epochs: int = 8
    decay_epochs: float = 0.971
    rate: float = 3e-3
    decay_rate: float = 0.6
    widen: float = 1.5
    narrow: float = 0.6
    penalty: tuple[float, float] = (0.1, 0.1)
    stages: int = 4
    tolerance: float = 0.01
    huber: float = 0.05
    batch: int = 2048
    refine_steps: int = 40
    firmness: float | None = None

    def __post_init__(self):
        """A word that stands for nothing would silently be the default."""
        for name, known in _WORDS.items():
            if getattr(self, name) not in known:
                raise BadInput(f"settings: {name} {getattr(self, name)!r} is unknown: use one of {', '.join(known)}")


_OPTIMISER = optax.scale_by_adam()

PRESETS = {
    "default": Settings(),
    "paper": Settings(
        encoder="paper", memory="elapsed", drive="direct", scaling="paper", difference="central", epochs=10, rate=1e-3,
        decay_rate=0.8, widen=1.2, narrow=0.8, penalty=(2.0, 2.0), huber=1.0, refine_steps=0, stages=8,
    ),
}  # fmt: skip


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
    """The trained model, the history of its losses, and whether it was cut short."""

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
        nominal: an identified model; order, input map, hold and output are kept.
        records: the training records, one sampling rate.
        preset: "default" or "paper"; `settings` overrides it.
        progress: called after every epoch and every refinement step.
        mesh: devices of this process that share the free runs, by records (`records_mesh`); default one device.
        key: JAX key; the same key, records and machine give the same model.

    Raises:
        BadInput: unknown preset, a nominal with effects, a mesh over several processes, or no usable sample left
            after filtering.
        ComputationFailed: the loss is not finite.
        KeyboardInterrupt: interrupted before the first stage was complete (later ones return the best so far).
    """
    if settings is None:
        if preset not in PRESETS:
            raise BadInput(f"unknown preset {preset!r}: use one of {', '.join(PRESETS)}")
        settings = PRESETS[preset]
    if nominal.effects:
        raise BadInput("a nominal with effects is not trained: train first, then diagnose the trained model")
    if mesh is not None and mesh.is_multi_process:
        raise BadInput("training runs in one process: its mesh may only hold jax.local_devices()")
    key_init, key_stages = jax.random.split(key)
    data = build_dataset(nominal, records, scaling=settings.scaling, difference=settings.difference,
                         memory=partial(_memory, settings, nominal, records))  # fmt: skip
    model = _with_encoder(data, settings, key_init)
    history: list[dict] = []
    best, interrupted, began = None, False, time.monotonic()
    try:
        for found, entry in _stages(model, data, settings, key_stages, progress):
            best = found
            history.append(entry)
        if best is not None and settings.refine_steps:
            lagging = _with_drive(best, settings)
            how = {"firmness": _firmness(settings, nominal), "mesh": mesh}
            for found, entry in refine(
                lagging, data, records, settings.refine_steps, partial(_report, progress), **how
            ):
                best = found
                history.append(entry)
    except KeyboardInterrupt:
        if best is None:
            raise
        interrupted = True
    if best is None:
        raise BadInput("settings allow no training stage: set stages to 1 or more")
    notes = {"settings": asdict(settings), "seconds": round(time.monotonic() - began, 1), "history": history,
             "records": [r.name for r in records], "samples": int(data.equation.force.shape[0]),
             "interrupted": interrupted}  # fmt: skip
    return Training(_annotated(best, data, notes), tuple(history), interrupted, notes)


def _report(progress, stage, step, steps, value, best, seconds_left):
    progress(Progress(stage, step, steps, None, value, best, seconds_left))


def _memory(settings: Settings, nominal: Model, records):
    """The memory a preset asks for, its time constants from the resonance and the longest record."""
    longest = max(r.samples for r in records) * records[0].dt
    if settings.memory == "none":
        return NoMemory()
    if settings.memory == "elapsed":
        return ElapsedTime(horizon=float(longest))
    tau = np.geomspace(min(2.0 / nominal.natural_frequency, longest / 20), longest, settings.memories)
    return FadingMemory(jnp.asarray(np.log(tau), jnp.float32))


def _with_encoder(data: Dataset, settings: Settings, key) -> Model:
    """The nominal with a fresh encoder, bounded at twice the trained region."""
    model = data.model
    n, memories = model.order, model.memory.size
    if settings.encoder == "paper":
        encoder = PaperEncoder(n + memories, n + 1, key=key)
    else:
        low, high = np.asarray(data.region).T
        half = np.maximum(high - low, 0.25 * (high[0] - low[0])) / 2
        bounds = (low + high) / 2 + 2 * np.array([[-1.0], [1.0]]) * half
        encoder = CompactEncoder(n, memories, width=settings.width, offset=settings.offset, bounds=bounds, key=key)
    return eqx.tree_at(lambda m: m.encoder, model, encoder)


def _firmness(settings: Settings, nominal: Model) -> float:
    if settings.firmness is not None:
        return settings.firmness
    return 1e-4 if isinstance(nominal.input_map, SquareInput) else 1e-3


def _with_drive(model: Model, settings: Settings) -> Model:
    """The lag free runs start from. Not before: the equation error reads the drive as direct, and does not fit it.

    Without a square behind it a lag is one more linear pole, which the order stands for: Silverbox's arrows 1.41 and
    0.86 mV with it, 0.71 and 0.28 without.
    """
    if settings.drive != "electrode" or not isinstance(model.input_map, SquareInput):
        return model
    lag = ElectrodeLag(jnp.asarray(np.log(0.1 / model.natural_frequency), jnp.float32))
    return eqx.tree_at(lambda m: m.drive, model, lag)


def _stages(model: Model, data: Dataset, settings: Settings, key, progress):
    """Algorithm 1: yield (best model, history entry) after every stage."""
    total = sum(max(1, int(settings.epochs * settings.decay_epochs**j)) for j in range(settings.stages))
    best_model, best, count, began = model, np.inf, 0, time.monotonic()
    for j in range(settings.stages):
        box = (settings.narrow ** (j + 1), settings.widen ** (j + 1))
        params, static = eqx.partition(best_model, _trainable(best_model))
        state = _OPTIMISER.init(params)
        epochs = max(1, int(settings.epochs * settings.decay_epochs**j))
        at_stage = best
        for epoch in range(epochs):
            key, sub = jax.random.split(key)
            fade = 0.5 * (1 + np.cos(np.pi * epoch / epochs)) if settings.encoder == "compact" else 1.0
            rate = settings.rate * settings.decay_rate**j * (0.05 + 0.95 * fade)
            box_rate = jnp.asarray(box), jnp.asarray(rate)
            params, state, (physics, constraint) = _epoch(
                params, static, state, data.equation, *box_rate, settings, sub
            )
            physics, constraint, count = float(physics), float(constraint), count + 1
            if not np.isfinite(physics + constraint):
                raise ComputationFailed(_nan_advice(f"stage {j + 1}, epoch {epoch + 1}"))
            if physics < best:
                best, best_model = physics, eqx.combine(params, static)
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


def _trainable(model: Model):
    """Encoder weights only: the equation error knows no time constant."""
    frozen = jax.tree.map(lambda _: False, model)
    return eqx.tree_at(lambda m: m.encoder, frozen, trainable(model).encoder)


@eqx.filter_jit
def _epoch(params, static, state, data, box, rate, settings: Settings, key):
    """One epoch over shuffled minibatches as one compiled scan; an incomplete batch is left to the next shuffle."""
    count = max(data.force.shape[0] // settings.batch, 1)
    size = min(settings.batch, data.force.shape[0])
    shuffle, drop = jax.random.split(key)
    order = jax.random.permutation(shuffle, data.force.shape[0])[: count * size].reshape(count, size)
    dropout = settings.encoder == "paper"

    def objective(p, batch, k):
        return loss(eqx.combine(p, static), batch, box, width=settings.huber, penalty=settings.penalty, key=k)

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


def _region(model: Model, data: Dataset) -> tuple[tuple[float, float], ...]:
    """Lowest and highest value of every feature, with the memories as they were learned."""
    n, seen = model.order, []
    for found, valid in zip(data.features, data.valid, strict=True):
        past = np.asarray(
            model.memory.trajectory(jnp.asarray(found[:, 0]), model.provenance.dt, jnp.asarray(found[0, n:]))
        )
        seen.append(np.concatenate([found[:, :n], past], -1)[valid])
    rows = np.concatenate(seen)
    return tuple((float(a), float(b)) for a, b in zip(rows.min(0), rows.max(0), strict=True))


def _annotated(model: Model, data: Dataset, notes: dict) -> Model:
    """The model with its trained region and the training summary in its provenance."""
    old = json.loads(model.provenance.notes)
    provenance = replace(model.provenance, region=_region(model, data), notes=json.dumps({**old, "training": notes}))
    return replace(model, provenance=provenance)
