"""Decoder: the model rolled out from a voltage (paper, eq. 7), and predictions for whole sets of records.

    tokens frozen over a step of size h:   x^(n) = (F - sigma_off - sum_{i<n} sigma_i x^(i)) / sigma_n,   RK4

The voltage runs linearly between samples (foh) and is squared inside every stage, or is held (zoh): on a healthy roll
record zoh left three times the noise floor. With frozen tokens a step is affine in the forces of its stages. Order 4
for constant tokens; for state-dependent tokens frozen over a step, order 1 against the continuous-token ODE.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._model.model import Model
from ._record.record import Record
from ._rest import INITIAL_SAMPLES, starts_at_rest

_FAR = 1e4  # a scaled displacement beyond this has left every actuator's range: diverged


def scaled_force(model: Model, voltage: Float[Array, "..."]) -> Float[Array, "..."]:
    """Force over force_scale."""
    return model.input_map.force(voltage) / model.scales.force


def stage_forces(model: Model, now, later, fraction: float, width: float):
    """Scaled force at the start, middle and end of a substep covering [fraction, fraction + width] of a sample."""
    if model.hold == "zoh":
        force = scaled_force(model, now)
        return force, force, force
    places = (fraction, fraction + width / 2, fraction + width)
    first, middle, last = (scaled_force(model, now + (later - now) * p) for p in places)
    return first, middle, last


def frozen_increment(model: Model, state: Float[Array, " state"], forces: tuple, h: float) -> Float[Array, " state"]:
    """What one RK4 step of length h (s) adds, tokens of its first instant; `state` is S then memory, scaled."""
    n = model.order
    tokens, offset = model.tokens(state)
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


def step(model: Model, state: Float[Array, " state"], now, later, dt: float) -> Float[Array, " state"]:
    """Advance one sample: `substeps` RK4 steps, tokens read anew at each."""
    width = 1.0 / model.substeps
    for k in range(model.substeps):
        forces = stage_forces(model, now, later, k * width, width)
        state = state + frozen_increment(model, state, forces, dt * width)
    return state


def rest_state(model: Model) -> Float[Array, " state"]:
    """The scaled state of an actuator that has been at rest for ever."""
    dtype = model.coefficients.dtype
    return jnp.concatenate([jnp.zeros(model.order, dtype), model.memory.initial(jnp.zeros((), dtype))])


def rollout(
    model: Model, voltage: Float[Array, " time"], dt: float, start: Float[Array, " state"]
) -> Float[Array, "time state"]:
    """Scaled states at every sample, row 0 = `start`; write for one record, vmap for more."""

    def advance(state, pair):
        return step(model, state, pair[0], pair[1], dt), state

    pairs = jnp.stack([voltage, jnp.append(voltage[1:], voltage[-1])], -1)
    return jax.lax.scan(advance, start, pairs)[1]


rollout_batch = eqx.filter_jit(eqx.filter_vmap(rollout, in_axes=(None, 0, None, 0)))


@eqx.filter_jit
def estimate_start(
    model: Model,
    voltage: Float[Array, " time"],
    displacement: Float[Array, " time"],
    observed: Bool[Array, " time"],
    dt: float,
) -> Float[Array, " state"]:
    """Initial state of a record that starts moving, from its first samples (scaled displacement; at most 50).

    Gauss-Newton on the rollout over S(0) and one level m at which every memory is taken to have settled, with a weak
    prior (1e-3) towards the mean displacement and no motion.
    """
    level = jnp.sum(jnp.where(observed, displacement, 0.0)) / jnp.maximum(jnp.sum(observed), 1)

    def assemble(p):
        return jnp.concatenate([p[:-1], model.memory.initial(p[-1])])

    prior = jnp.zeros(model.order + 1, displacement.dtype).at[jnp.array([0, -1])].set(level)

    def residual(p):
        x = rollout(model, voltage, dt, assemble(p))[:, 0]
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
    starts, estimated = zip(*[_start(model, r) for r in records], strict=True)
    dtype = model.coefficients.dtype
    states = rollout_batch(model, jnp.asarray(voltage, dtype), records[0].dt, jnp.stack(starts))
    return tuple(
        _prediction(model, r, np.asarray(s[: r.samples]), e) for r, s, e in zip(records, states, estimated, strict=True)
    )


def _start(model: Model, record: Record):
    """Rest, or the state estimated from the first samples; and which of the two."""
    if starts_at_rest(record, model.output.offset):
        return rest_state(model), False
    first = slice(0, INITIAL_SAMPLES)
    dtype = model.coefficients.dtype
    x = model.output.to_model(record.displacement[first]) / model.scales.state[0]
    observed = np.isfinite(x)
    voltage, known = jnp.asarray(record.voltage[first], dtype), jnp.asarray(np.where(observed, x, 0.0), dtype)
    return estimate_start(model, voltage, known, jnp.asarray(observed), record.dt), True


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


def _prediction(model: Model, record: Record, states: np.ndarray, estimated: bool) -> Prediction:
    lost = ~(np.isfinite(states).all(-1) & (np.abs(states[:, 0]) < _FAR))
    first = int(np.argmax(lost)) if lost.any() else record.samples
    x = np.full(record.samples, np.nan)
    x[:first] = model.output.to_rig(states[:first, 0].astype(np.float64) * model.scales.state[0])
    scored = np.ones(record.samples, bool)
    scored[: INITIAL_SAMPLES if estimated else 0] = False
    share = 1.0 if first == 0 else outside_share(model, states[:first])
    return Prediction(record.name, x, bool(lost.any()), estimated, scored, share)
