"""How a free run answers every trained number: forward sensitivities through the decoder, and their normal equations.

    s_{t+1} = g(s_t, l_t, q, a),  l_t = encoder(s_t + drift; p),  V = drive(u; r, a),  y = sensor(s; a)
    Z_{t+1} = (dg/ds + dg/dl dl/ds) Z_t + [dg/dl dl/dp, dg/dq, dg/dV dV/d(r, a), dg/da]   Z = ds/d(p, q, r, a),  Z_0 = 0
    C = sum w e^2,   half gradient J'we,   H = J'WJ,       J = dy/ds Z + dy/da,  e = y - x_measured

p: the encoder's weights, q: the memories' time constants, r: the drive's, a: the effects' numbers (logarithms where
they are positive). A step depends on p through its n + 2 logits only, so a column of Z costs a small matrix product
and no pass through the network: 30 records of 10,000 samples and 190 parameters take 1.5 s on two cores, 6 times a
plain free run.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Shaped

from ._decode import midpoint, stage_voltages, substep
from ._levenberg import Normal
from ._model import augment
from ._model.encoder import CompactEncoder
from ._model.model import Model


class Runs(eqx.Module):
    """Free runs to be met: starts, drive voltages, scaled displacements and weights of the samples."""

    start: Float[Array, "records state"]
    rest: Float[Array, " records"]
    voltage: Float[Array, "records time"]
    target: Float[Array, "records time"]
    weight: Float[Array, "records time"]


def trainable(model: Model):
    """True at every number training may move: encoder weights, memory and drive time constants, effects' numbers."""
    spec = jax.tree.map(lambda _: False, model)
    spec = eqx.tree_at(_parts, spec, jax.tree.map(eqx.is_inexact_array, _parts(model)))
    if isinstance(model.encoder, CompactEncoder):
        spec = eqx.tree_at(lambda m: m.encoder.bounds, spec, False)
    return spec


def _parts(model: Model) -> tuple:
    return model.encoder, model.memory, model.drive, model.effects


def _logarithmic(model: Model) -> np.ndarray:
    """Which of the effects' numbers are fitted by their logarithm."""
    return np.array([p.positive for e in model.effects for p in e.PARAMETERS], bool)


def _stored(model: Model, numbers, xp):
    """Effects' numbers from what is fitted of them."""
    logs = _logarithmic(model)
    return xp.where(logs, xp.exp(xp.where(logs, numbers, 0.0)), numbers)


def parameters(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """All trained numbers in one vector (encoder, memory, drive, effects), and how many of each."""
    params = eqx.filter(model, trainable(model))
    parts = [np.asarray(ravel_pytree(part)[0], np.float64) for part in _parts(params)]
    logs = _logarithmic(model)
    parts[3] = np.where(logs, np.log(np.maximum(np.where(logs, parts[3], 1.0), 1e-30)), parts[3])
    return np.concatenate(parts), np.array([len(p) for p in parts])


def with_parameters(model: Model, vector: Shaped[np.ndarray | Array, " parameters"]) -> Model:
    """The model with other trained numbers."""
    params, static = eqx.partition(model, trainable(model))
    new, first = [], 0
    for part in _parts(params):
        flat, unravel = ravel_pytree(part)
        values = jnp.asarray(vector[first : first + flat.size], flat.dtype)
        new.append(unravel(_stored(model, values, jnp) if part is params.effects else values))
        first += flat.size
    return eqx.combine(eqx.tree_at(_parts, params, tuple(new)), static)


def normal_equations(model: Model, runs: Runs, dt: float, every: int, vector: np.ndarray) -> Normal:
    """C, J'we and J'WJ at `vector`, from every `every`-th sample; in float32, summed up in blocks."""
    cost, gradient, hessian = normal_sums(with_parameters(model, vector), runs, dt, every)
    return Normal(float(cost), np.asarray(gradient, np.float64), np.asarray(hessian, np.float64))


@eqx.filter_jit
def normal_sums(model: Model, runs: Runs, dt: float, every: int):
    params, static = eqx.partition(model, trainable(model))
    encoder, build_encoder = ravel_pytree(params.encoder)
    memory, build_memory = ravel_pytree(params.memory)
    drive, build_drive = ravel_pytree(params.drive)
    effects, build_effects = ravel_pytree(params.effects)
    logs = _logarithmic(model)
    effects = jnp.where(logs, jnp.log(jnp.where(logs, effects, 1.0)), effects)
    width, core = 1.0 / model.substeps, model.order + model.memory.size

    def with_effects(m, a):
        built = eqx.combine(build_effects(_stored(model, a, jnp)), static.effects)
        return eqx.tree_at(lambda m: m.effects, m, built) if model.effects else m

    def stages(r, a):
        part, m = eqx.combine(build_drive(r), static.drive), with_effects(model, a)

        def one(u, rest):
            late = augment.delayed(m, u, dt, rest > 0)
            return stage_voltages(model, part.film(late, dt, rest > 0))

        return jax.vmap(one)(runs.voltage, runs.rest)

    def logits(p, features):
        return eqx.combine(build_encoder(p), static.encoder)(features)

    def moved(state, extra, q, volts, a):
        """One substep with `extra` logits along three stage voltages."""
        m = eqx.tree_at(lambda m: m.memory, model, eqx.combine(build_memory(q), static.memory))
        return substep(with_effects(m, a), state, volts, dt * width, extra)

    def seen(state, a):
        return augment.reading(with_effects(model, a), state)

    zero = jnp.zeros((model.order + 2,), encoder.dtype)

    def advance(state, answer, volts, volts_by):
        for k in range(model.substeps):
            here = (state, zero, memory, volts[2 * k : 2 * k + 3], effects)
            by_state, by_logits, by_memory, by_volts, by_effects = jax.jacfwd(moved, (0, 1, 2, 3, 4))(*here)
            by_weights = jax.jacrev(logits)(encoder, midpoint(model, state[:core], dt * width))
            by_drive, by_delay = jnp.split(by_volts @ volts_by[2 * k : 2 * k + 3], [drive.size], axis=1)
            new = [by_logits @ by_weights, by_memory, by_drive, by_effects + by_delay]
            answer = by_state @ answer + jnp.concatenate(new, 1)
            state = moved(*here)
        return state, answer

    def sensed(state, answer):
        """The reading and its slope."""
        by_state, by_effects = jax.jacfwd(seen, (0, 1))(state, effects)
        direct = jnp.zeros((count,), answer.dtype).at[count - effects.size :].set(by_effects)
        return seen(state, effects), by_state @ answer + direct

    def block(carry, item):
        """`every` samples; the error and its slope are taken at the first."""
        (state, answer), (hessian, gradient, cost) = carry
        pairs, target, weight = item
        reading, slope = jax.vmap(sensed)(state, answer) if model.effects else (state[:, 0], answer[:, 0])
        error = reading - target
        weighted = weight[:, None] * slope
        sums = hessian + weighted.T @ slope, gradient + weighted.T @ error, cost + jnp.sum(weight * error**2)
        runs_on = jax.lax.scan(lambda c, p: (jax.vmap(advance)(*c, *p), None), (state, answer), pairs)[0]
        return (runs_on, sums), None

    def grid(values):
        """(records, time, ...) to (blocks, every, records, ...), less an incomplete last block."""
        count = values.shape[1] // every
        ordered = jnp.moveaxis(values[:, : count * every], 0, 1)
        return ordered.reshape(count, every, *ordered.shape[1:])

    along = jax.jacfwd(lambda v: stages(v[: drive.size], v[drive.size :]))(jnp.concatenate([drive, effects]))
    pairs = grid(stages(drive, effects)), grid(along)
    count = encoder.size + memory.size + drive.size + effects.size
    records, states = runs.start.shape
    start = runs.start, jnp.zeros((records, states, count), encoder.dtype)
    sums = jnp.zeros((count, count)), jnp.zeros((count,)), jnp.zeros(())
    items = (pairs, grid(runs.target)[:, 0], every * grid(runs.weight)[:, 0])
    return jax.lax.scan(block, (start, sums), items)[0][1][::-1]
