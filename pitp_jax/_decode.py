"""Decoder: the model rolled out from a voltage (paper, eq. 7), and predictions for whole sets of records.

    tokens frozen over a step of size h:   x^(n) = (F - sigma_off - sum_{i<n} sigma_i x^(i)) / sigma_n,   RK4
    read where the state drifts to by h/2: x^(i) + h/2 x^(i+1) for i < n-1, memories likewise, x^(n-1) as it is

The voltage between samples is squared inside every stage (`_between`): on a healthy roll record zoh left three times
the noise floor of foh. With frozen tokens a step is affine in the forces of its stages. Order 4
for constant tokens. Tokens read at a step's beginning (the paper) make a hard spring pump energy, explicit Euler's
w^2 h^2 / 2 a step: an encoder fitted to the equation error of the roll diverged. Half a step on costs nothing and is
order 2 against the continuous-token ODE, but for what depends on x^(n-1) (order 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._between import between
from ._effects.base import Instant
from ._model import augment
from ._model.model import Model
from ._record.record import Record
from ._rest import INITIAL_SAMPLES, first_known, starts_at_rest

_FAR = 1e4  # a scaled displacement beyond this has left every actuator's range: diverged


def scaled_force(model: Model, voltage: Float[Array, "..."]) -> Float[Array, "..."]:
    """Force over force_scale."""
    return model.input_map.force(voltage) / model.scales.force


def stage_voltages(model: Model, film: Float[Array, " time"]) -> Float[Array, "time stages"]:
    """Film voltage at the beginning, middle and end of every substep of every sample: 2 substeps + 1 stages."""
    return between(film, model.hold, np.arange(2 * model.substeps + 1) / (2 * model.substeps), jnp)


def increment(
    model: Model, state: Float[Array, " state"], logits: Float[Array, " logits"], forces: tuple, h: float
) -> Float[Array, " state"]:
    """What one RK4 step of length h (s) adds under these logits; `state` is S then memory, scaled."""
    return _runge_kutta(model, state, *model.tokens_from(logits), forces, h)


def _runge_kutta(model: Model, state, tokens, offset, forces: tuple, h: float):
    """What one RK4 step of length h (s) adds under these tokens; `state` is S then memory, scaled."""
    n = model.order
    rates = jnp.asarray(model.scales.rates, state.dtype)
    first, middle, last = forces

    def slope(s, force):
        highest = (force - offset - tokens[:n] @ s[:n]) / tokens[n]
        memory = model.memory.rate(s[n:], s[0])
        return jnp.concatenate([rates * jnp.append(s[1:n], highest), memory])

    k1 = slope(state, first)
    k2 = slope(state + h / 2 * k1, middle)
    k3 = slope(state + h / 2 * k2, middle)
    k4 = slope(state + h * k3, last)
    return h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def midpoint(model: Model, state: Float[Array, " state"], h: float) -> Float[Array, " state"]:
    """What is known of the state half a step on, whatever the force: all but x^(n-1) has drifted."""
    n = model.order
    rates = jnp.asarray(model.scales.rates, state.dtype)
    still = jnp.zeros((1,), state.dtype)
    return state + h / 2 * jnp.concatenate([rates[: n - 1] * state[1:n], still, model.memory.rate(state[n:], state[0])])


def frozen_increment(model: Model, state: Float[Array, " state"], forces: tuple, h: float) -> Float[Array, " state"]:
    """What one step adds, tokens read at the drifted midpoint."""
    return increment(model, state, model.encoder(midpoint(model, state, h)), forces, h)


def step(model: Model, state: Float[Array, " state"], stages: Float[Array, " stages"], dt: float):
    """Advance one sample along its stage voltages: `substeps` RK4 steps, tokens read anew at each."""
    if model.effects:
        return _step_with_effects(model, state, stages, dt)
    force = scaled_force(model, stages)
    for k in range(model.substeps):
        now = (force[2 * k], force[2 * k + 1], force[2 * k + 2])
        state = state + frozen_increment(model, state, now, dt / model.substeps)
    return state


def _step_with_effects(model: Model, state, stages, dt: float):
    """The same with every effect's force frozen beside the tokens, and its states moved on after each substep."""
    size, h = model.order + model.memory.size, dt / model.substeps
    for k in range(model.substeps):
        core, parts = state[:size], augment.split(model, state[size:])
        volts, parts = augment.films(model, parts, tuple(stages[2 * k : 2 * k + 3]), h)
        seen = midpoint(model, core, h)
        forces = augment.coupled(model, tuple(scaled_force(model, v) for v in volts), seen[0])
        rates = jnp.asarray(model.scales.rates, state.dtype)
        now = Instant(seen[: model.order], model.coefficients, rates, forces[1], h)
        tokens, offset = augment.acted(model, parts, now, *model.tokens(seen))
        after = core + _runge_kutta(model, core, tokens, offset, forces, h)
        state = jnp.concatenate([after, *augment.moved(model, parts, core[0], after[0], h)])
    return state


def rest_state(model: Model, age: float = 0.0) -> Float[Array, " state"]:
    """The scaled state of an actuator that has been at rest for ever, at an age of the session in s."""
    zero = jnp.zeros((), model.coefficients.dtype)
    return settled_state(model, jnp.zeros(model.order, zero.dtype), zero, zero, age)


def settled_state(model: Model, state: Float[Array, " order"], level, voltage, age) -> Float[Array, " state"]:
    """S, with memory and effects as after a long time at scaled displacement `level` under a voltage."""
    return jnp.concatenate([state, model.memory.initial(level), augment.initial(model, level, voltage, age)])


def rollout(
    model: Model, voltage: Float[Array, " time"], dt: float, start: Float[Array, " state"]
) -> Float[Array, "time state"]:
    """Scaled states at every sample under a drive voltage u, row 0 = `start`; for one record, vmap for more.

    A start at x = 0 without motion is rest: the film is uncharged. Any other start has it settled at u(0).
    """
    rest = ~jnp.any(start[: model.order])
    voltage = model.drive.film(augment.delayed(model, voltage, dt, rest), dt, rest)

    def advance(state, stages):
        return step(model, state, stages, dt), state

    return jax.lax.scan(advance, start, stage_voltages(model, voltage))[1]


rollout_batch = eqx.filter_jit(eqx.filter_vmap(rollout, in_axes=(None, 0, None, 0)))


@eqx.filter_jit
def estimate_start(
    model: Model,
    voltage: Float[Array, " time"],
    displacement: Float[Array, " time"],
    observed: Bool[Array, " time"],
    dt: float,
    age: float = 0.0,
) -> Float[Array, " state"]:
    """Initial state of a record that starts moving, from its first samples (scaled displacement; at most 50).

    Gauss-Newton on the rollout over S(0) and one level m at which every memory is taken to have settled, with a weak
    prior (1e-3) towards the mean displacement and no motion.
    """
    level = jnp.sum(jnp.where(observed, displacement, 0.0)) / jnp.maximum(jnp.sum(observed), 1)

    def assemble(p):
        return settled_state(model, p[:-1], p[-1], voltage[0], age)

    prior = jnp.zeros(model.order + 1, displacement.dtype).at[jnp.array([0, -1])].set(level)

    def residual(p):
        x = augment.readings(model, rollout(model, voltage, dt, assemble(p)))
        return jnp.concatenate([jnp.where(observed, x - displacement, 0.0), 1e-3 * (p - prior)])

    def improve(p, _):
        jacobian, left = jax.jacfwd(residual)(p), residual(p)
        move = jnp.linalg.lstsq(jacobian, -left)[0]
        best = p + move
        better = jnp.sum(residual(best) ** 2) < jnp.sum(left**2)
        return jnp.where(better, best, p + 0.2 * move * jnp.isfinite(move).all()), None

    return assemble(jax.lax.scan(improve, prior, None, length=12)[0])


def at_rate(model: Model, dt: float) -> Model:
    """The same model with enough substeps for records sampled more coarsely than those it was trained on."""
    factor = max(1, round(dt / model.provenance.dt))
    return replace(model, substeps=model.substeps * factor) if factor > 1 else model


@dataclass(frozen=True)
class Prediction:
    """A free run beside one record.

    Attributes:
        name: of the record.
        displacement: predicted output in rig coordinates (offset and polarity applied), base unit, shape (T,);
            nan from the sample where the rollout left every range.
        diverged: whether it did.
        estimated_start: the record starts moving, so state and memory were estimated from its first samples.
        scored: samples that count, shape (T,): all but those the initial state was estimated from.
        outside_training_share: share of samples whose state lies outside the trained region.
    """

    name: str
    displacement: np.ndarray
    diverged: bool
    estimated_start: bool
    scored: np.ndarray
    outside_training_share: float


def predict(model: Model, records: Sequence[Record]) -> tuple[Prediction, ...]:
    """Free run of the model under every record's voltage, batched; records may have any lengths, one sampling rate."""
    model = at_rate(model, records[0].dt)
    size = -(-max(r.samples for r in records) // 1024) * 1024
    voltage = np.stack([np.pad(r.voltage, (0, size - r.samples), mode="edge") for r in records])
    start, spent = starts(model, records)
    states = rollout_batch(model, jnp.asarray(voltage, model.coefficients.dtype), records[0].dt, start)
    return tuple(
        _prediction(model, r, np.asarray(s[: r.samples]), n) for r, s, n in zip(records, states, spent, strict=True)
    )


def starts(model: Model, records: Sequence[Record]) -> tuple[Float[Array, "records state"], tuple[int, ...]]:
    """Initial states of all records, and from how many samples each was estimated (0: it starts at rest)."""
    found, spent = zip(*[_start(model, r) for r in records], strict=True)
    return jnp.stack(found), spent


def _start(model: Model, record: Record):
    """Rest, or the state estimated from the first samples; and how many samples that took (0 at rest).

    After a gap at the beginning the first 50 samples are those behind it: the rollout reaches them from the start.
    """
    if starts_at_rest(record, model.output.offset):
        return rest_state(model, record.time[0]), 0
    first = slice(0, first_known(record) + INITIAL_SAMPLES)
    dtype = model.coefficients.dtype
    x = model.output.to_model(record.displacement[first]) / model.scales.state[0]
    observed = np.isfinite(x)
    voltage, known = jnp.asarray(record.voltage[first], dtype), jnp.asarray(np.where(observed, x, 0.0), dtype)
    return estimate_start(model, voltage, known, jnp.asarray(observed), record.dt, record.time[0]), len(x)


def outside_share(model: Model, features: np.ndarray) -> float:
    """Share of rows (S then memory, scaled; shape (T, features)) outside the box the model was trained in.

    The box is widened by 5 % of its size, or of the displacement's range, on each side (slow memories barely move
    in short records). A model without a region (identified only) returns 0.
    """
    if not model.provenance.region or len(features) == 0:
        return 0.0
    low, high = np.asarray(model.provenance.region).T
    slack = 0.05 * np.maximum(high - low, high[0] - low[0])
    return float(((features < low - slack) | (features > high + slack)).any(-1).mean())


def _prediction(model: Model, record: Record, states: np.ndarray, spent: int) -> Prediction:
    lost = ~(np.isfinite(states).all(-1) & (np.abs(states[:, 0]) < _FAR))
    first = int(np.argmax(lost)) if lost.any() else record.samples
    x = np.full(record.samples, np.nan)
    seen = np.asarray(augment.readings(model, jnp.asarray(states[:first])), np.float64)
    x[:first] = model.output.to_rig(seen * model.scales.state[0])
    scored = np.ones(record.samples, bool)
    scored[:spent] = False
    share = 1.0 if first == 0 else outside_share(model, states[:first, : model.order + model.memory.size])
    return Prediction(record.name, x, bool(lost.any()), spent > 0, scored, share)
