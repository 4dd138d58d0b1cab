"""How a free run answers every trained number: forward sensitivities through the decoder, and their normal equations.

    s_{t+1} = g(s_t, l_t, q, a),  l_t = encoder(s_t + drift; p),  V = drive(u; r, a),  y = sensor(s; a)
    Z_{t+1} = (dg/ds + dg/dl dl/ds) Z_t + [dg/dl dl/dp, dg/dq, dg/dV dV/d(r, a), dg/da]   Z = ds/d(p, q, r, a),  Z_0 = 0
    C = sum w e^2,   half gradient J'We,   H = J'WJ,       J = dy/ds Z + dy/da,  e = y - x_measured

p: the encoder's weights, q: the memories' time constants, r: the drive's, a: the effects' numbers (logarithms where
they are positive). A step depends on p through its n + 2 logits only, so a column of Z costs a small matrix product
and no pass through the network: 30 records of 10,000 samples and 190 parameters take 2.2 s on one core, a plain free
run of them 0.06 s.
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
from ._rollout_fast import fast_rollout

_AT_ONCE = 16  # blocks whose samples are taken side by side; their parts stay in a core's memory


class Runs(eqx.Module):
    """Free runs to be met: starts, drive voltages, scaled displacements and weights of the samples."""

    start: Float[Array, "records state"]
    rest: Float[Array, " records"]
    voltage: Float[Array, "records time"]
    target: Float[Array, "records time"]
    weight: Float[Array, "records time"]

    def filled(self, lanes: int) -> "Runs":
        """Copies of the last one added, which count for nothing, until `lanes` can have equally many."""
        extra = -len(self.start) % lanes
        more = jax.tree.map(lambda a: np.concatenate([a, np.repeat(a[-1:], extra, axis=0)]), self)
        counts = np.arange(len(more.start))[:, None] < len(self.start)
        return eqx.tree_at(lambda r: r.weight, more, more.weight * counts)

    def parts(self, count: int) -> list["Runs"]:
        """The same in so many parts of equal shape."""
        whole = self.filled(count)
        size = len(whole.start) // count
        return [jax.tree.map(lambda a, k=k: a[k * size : (k + 1) * size], whole) for k in range(count)]


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
    """C, J'we and J'WJ at `vector`, from every `every`-th sample; in float32."""
    return Normal.of(*normal_sums(with_parameters(model, vector), runs, dt, every))


@eqx.filter_jit
def normal_sums(model: Model, runs: Runs, dt: float, every: int):
    """C, J'we and J'WJ of `normal_equations`, as JAX arrays."""
    errors = run_errors(model, runs, dt, every).ravel()
    slopes = run_slopes(model, runs, dt, every).reshape(errors.size, -1)
    return errors @ errors, slopes.T @ errors, slopes.T @ slopes


@eqx.filter_jit
def run_errors(model: Model, runs: Runs, dt: float, every: int) -> Float[Array, "records errors"]:
    """Sqrt(every w) e at every `every`-th sample, less an incomplete last block."""
    states = fast_rollout(model, runs.voltage, dt, runs.start)
    errors = jax.vmap(lambda run: augment.readings(model, run))(states) - runs.target
    last = runs.target.shape[1] // every * every
    return (jnp.sqrt(every * runs.weight) * errors)[:, :last:every]


class _Numbers:
    """A model taken apart: its trained numbers as flat vectors, and what each of them is needed for."""

    def __init__(self, model: Model):
        self.model = model
        params, self.static = eqx.partition(model, trainable(model))
        self.encoder, self._encoder = ravel_pytree(params.encoder)
        self.memory, self._memory = ravel_pytree(params.memory)
        self.drive, self._drive = ravel_pytree(params.drive)
        effects, self._effects = ravel_pytree(params.effects)
        logs = _logarithmic(model)
        self.effects = jnp.where(logs, jnp.log(jnp.where(logs, effects, 1.0)), effects)
        self.count = self.encoder.size + self.memory.size + self.drive.size + self.effects.size

    def with_effects(self, model: Model, a) -> Model:
        if not self.model.effects:
            return model
        built = eqx.combine(self._effects(_stored(self.model, a, jnp)), self.static.effects)
        return eqx.tree_at(lambda m: m.effects, model, built)

    def stages(self, runs: Runs, dt: float, r, a):
        """Film voltages at the stages of every sample of every record."""
        drive, model = eqx.combine(self._drive(r), self.static.drive), self.with_effects(self.model, a)

        def one(u, rest):
            return stage_voltages(model, drive.film(augment.delayed(model, u, dt, rest > 0), dt, rest > 0))

        return jax.vmap(one)(runs.voltage, runs.rest)

    def logits(self, p, features):
        return eqx.combine(self._encoder(p), self.static.encoder)(features)

    def with_memory(self, q) -> Model:
        return eqx.tree_at(lambda m: m.memory, self.model, eqx.combine(self._memory(q), self.static.memory))

    def seen(self, core, q, h: float):
        """What the encoder sees of a state half a substep on."""
        return midpoint(self.with_memory(q), core, h)

    def moved(self, state, logits, q, volts, a, h: float):
        """The state after one substep under these logits along three stage voltages."""
        return substep(self.with_effects(self.with_memory(q), a), state, volts, h, logits)

    def reading(self, state, a):
        return augment.reading(self.with_effects(self.model, a), state)


@eqx.filter_jit
def run_slopes(model: Model, runs: Runs, dt: float, every: int) -> Float[Array, "records errors parameters"]:
    """How `run_errors` answer every trained number."""
    n, h, core = _Numbers(model), dt / model.substeps, model.order + model.memory.size
    records, size = runs.start.shape
    both = jnp.concatenate([n.drive, n.effects])

    def local(state, volts, volts_by):
        """Of one substep: ds/ds, dg/dl, ds by all numbers but the encoder's, and what the encoder sees."""

        def moved(state, logits, q, changes):
            a = n.effects + changes[n.drive.size :]
            return n.moved(state, logits, q, volts + volts_by @ changes, a, h)

        seen = n.seen(state[:core], n.memory, h)
        by_core, seen_by_memory = jax.jacfwd(n.seen, (0, 1))(state[:core], n.memory, h)
        here = state, n.logits(n.encoder, seen), n.memory, 0 * both
        by_state, by_logits, by_memory, by_both = jax.jacfwd(moved, (0, 1, 2, 3))(*here)
        by_seen = by_logits @ jax.jacrev(n.logits, 1)(n.encoder, seen)
        others = jnp.concatenate([by_memory + by_seen @ seen_by_memory, by_both], 1)
        return by_state.at[:, :core].add(by_seen @ by_core), by_logits, others, seen

    def sample(state, volts, volts_by):
        """The substeps of one sample."""
        found = []
        for k in range(model.substeps):
            places = slice(2 * k, 2 * k + 3)
            found.append(local(state, volts[places], volts_by[places]))
            if k + 1 < model.substeps:
                seen = n.seen(state[:core], n.memory, h)
                state = n.moved(state, n.logits(n.encoder, seen), n.memory, volts[places], n.effects, h)
        return jax.tree.map(lambda *a: jnp.stack(a), *found)

    def block(states, volts, volts_by):
        """Z after `every` samples from Z before: phi Z + new."""
        parts = jax.vmap(sample)(states, volts, volts_by)
        by_state, by_logits, by_others, seen = (a.reshape(every * model.substeps, *a.shape[2:]) for a in parts)
        phi, later = jnp.eye(size, dtype=by_state.dtype), []
        for t in reversed(range(len(by_state))):
            later.append(phi)
            phi = phi @ by_state[t]
        later = jnp.stack(later[::-1])
        back = jax.vjp(lambda p: jax.vmap(lambda f: n.logits(p, f))(seen), n.encoder)[1]
        by_encoder = jax.vmap(lambda rows: back(rows)[0], 1)(later @ by_logits)
        return phi, jnp.concatenate([by_encoder, jnp.einsum("tij,tjk->ik", later, by_others)], 1)

    def sensed(state, answer):
        """Slope of the reading."""
        if not model.effects:
            return answer[0]
        by_state, by_effects = jax.jacfwd(n.reading, (0, 1))(state, n.effects)
        return by_state @ answer + jnp.zeros((n.count,), answer.dtype).at[n.count - n.effects.size :].set(by_effects)

    def chunk(answer, item):
        """Blocks side by side, then Z through them; the slope is taken at each one's first sample."""

        def on(answer, part):
            state, phi, new = part
            return phi @ answer + new, jax.vmap(sensed)(state, answer)

        parts = item[0][:, :, 0], *jax.vmap(jax.vmap(block))(*item)
        return jax.lax.scan(on, answer, jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), parts))

    count = runs.voltage.shape[1] // every

    def chunks(values):
        """(records, time, ...) to (chunks, records, blocks, every, ...), zeros after the last block."""
        values = values[:, : count * every].reshape(records, count, every, *values.shape[2:])
        filled = jnp.pad(values, [(0, 0), (0, -count % _AT_ONCE)] + [(0, 0)] * (values.ndim - 2))
        return jnp.moveaxis(filled.reshape(records, -(-count // _AT_ONCE), _AT_ONCE, *values.shape[2:]), 1, 0)

    along = jax.jacfwd(lambda v: n.stages(runs, dt, v[: n.drive.size], v[n.drive.size :]))(both)
    states = fast_rollout(model, runs.voltage, dt, runs.start)
    items = chunks(states), chunks(n.stages(runs, dt, n.drive, n.effects)), chunks(along)
    start = jnp.zeros((records, size, n.count), n.encoder.dtype)
    slopes = jax.lax.scan(chunk, start, items)[1].reshape(-1, records, n.count)[:count]
    return jnp.sqrt(every * runs.weight)[:, : count * every : every, None] * jnp.moveaxis(slopes, 0, 1)
