"""Differentiate simulations with respect to every trained parameter (forward sensitivities), in blocks.

    s_{t+1} = g(s_t, l_t, q, a),  l_t = encoder(s_t + drift; p),  V = drive(u; r, a),  y = sensor(s; a)
    Z_{t+1} = A_t Z_t + N_t       Z = ds/d(p, q, r, a),  Z_0 = 0,       J = dy/ds Z + dy/da
    A_t = dg/ds + dg/dl dl/ds,    N_t = [dg/dl dl/dp, dg/dq, dg/dV dV/d(r, a), dg/da]
    Z_{t+k} = phi Z_t + sum_j A_{t+k-1} ... A_{j+1} N_j,    phi = A_{t+k-1} ... A_t

p, q, r, a: `parameters`. The states come from a plain free run, so everything except Z is computed in parallel, and Z
needs one small product per block (docs/decisions/free_runs.md).
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.model import Model
from ..model.programs import jit
from ..simulate import ports
from ..simulate.batched_rollout import fast_rollout
from ..simulate.decoder import at_rest
from .parameters import Numbers

_AT_ONCE = 16  # blocks side by side; their data stay in a core's memory


class Runs(eqx.Module):
    """Simulations to be fitted to records: initial states, voltages (V), scaled displacements and sample weights.

    `own_zero`: 1 where a run has its own sensor offset, projected out of its errors (variable projection).
    """

    start: Float[Array, "records state"]
    voltage: Float[Array, "records time"]
    target: Float[Array, "records time"]
    weight: Float[Array, "records time"]
    own_zero: Float[Array, " records"] | None = None

    def filled(self, parts: int) -> "Runs":
        """Append copies of the last simulation with weight 0, until the number is a multiple of `parts`."""
        extra = -len(self.start) % parts
        # copies of a valid run, because weight 0 times a diverged one is nan
        more = jax.tree.map(lambda a: np.concatenate([a, np.repeat(a[-1:], extra, axis=0)]), self)
        counts = np.arange(len(more.start))[:, None] < len(self.start)
        return eqx.tree_at(lambda r: r.weight, more, more.weight * counts)

    def parts(self, count: int) -> list["Runs"]:
        """Cut the simulations into `count` parts of equal shape, which share one compiled program."""
        whole = self.filled(count)
        size = len(whole.start) // count
        return [jax.tree.map(lambda a, k=k: a[k * size : (k + 1) * size], whole) for k in range(count)]


@jit
def run_errors(model: Model, runs: Runs, dt: float, every: int) -> Float[Array, "records errors"]:
    """Compute the weighted simulation errors sqrt(every w) e at every `every`-th sample."""
    states = fast_rollout(model, runs.voltage, dt, runs.start)
    errors = jax.vmap(lambda run: ports.readings(model, run))(states) - runs.target
    last = runs.target.shape[1] // every * every  # the blocks of `run_slopes`, so that rows match
    return _projected(errors[:, :last:every, None], runs, every)[..., 0]


def _projected(rows: Float[Array, "records errors n"], runs: Runs, every: int) -> Float[Array, "records errors n"]:
    """Weight errors by c = sqrt(every w); where a record has its own sensor offset, remove its best value.

    The result is the residual after the best offset. The same projection of its derivatives is exact (variable
    projection for a linear parameter).
    """
    c = jnp.sqrt(every * runs.weight)[:, : rows.shape[1] * every : every, None]
    rows = c * rows
    if runs.own_zero is None:
        return rows
    zero = (c * rows).sum(1, keepdims=True) / jnp.maximum((c * c).sum(1, keepdims=True), 1e-30)
    return rows - runs.own_zero[:, None, None] * c * zero


def _product(a, b):
    """Multiply two small matrices as a sum of products, because `@` would be a call for every instant."""
    return sum(a[:, k, None] * b[k] for k in range(len(b)))


class _Local:
    """The derivatives of one model along known states, sample by sample."""

    def __init__(self, model: Model, dt: float):
        self.numbers, self.substeps, self.h = Numbers(model), model.substeps, dt / model.substeps
        self.core, self.with_effects = model.order + model.memory.size, bool(model.effects)
        self.both = jnp.concatenate([self.numbers.drive, self.numbers.effects])

    def stages(self, runs: Runs, dt: float, both):
        """Compute the film voltages of every simulation at every stage, for these parameters of drive and effects."""
        cut = self.numbers.drive.size
        return self.numbers.stages(runs.voltage, at_rest(self.numbers.model, runs.start), dt, both[:cut], both[cut:])

    def substep(self, state, volts, volts_by):
        """Differentiate one substep; return A_t, dg/dl, N_t without the encoder's part, features, and the next state.

        The encoder is differentiated separately: with its few logits, all weights cost one reverse pass per block.
        """
        n, h, core = self.numbers, self.h, state[: self.core]

        def moved(state, logits, q, changes):
            a = n.effects + changes[n.drive.size :]
            return n.moved(state, logits, q, volts + volts_by @ changes, a, h)

        seen = n.seen(core, n.memory, h)
        by_core, seen_by_memory = jax.jacfwd(n.seen, (0, 1))(core, n.memory, h)
        here = state, n.logits(n.encoder, seen), n.memory, 0 * self.both
        by_state, by_logits, by_memory, by_both = jax.jacfwd(moved, (0, 1, 2, 3))(*here)
        by_seen = _product(by_logits, jax.jacrev(n.logits, 1)(n.encoder, seen))
        # time constants act twice: on the memory itself, and on the features half a step later
        others = jnp.concatenate([by_memory + _product(by_seen, seen_by_memory), by_both], 1)
        return (by_state.at[:, : self.core].add(_product(by_seen, by_core)), by_logits, others, seen), moved(*here)

    def sample(self, state, volts, volts_by):
        """Differentiate all substeps of one sample."""
        along = []
        for k in range(self.substeps):
            places = slice(2 * k, 2 * k + 3)
            parts, state = self.substep(state, volts[places], volts_by[places])
            along.append(parts)
        return jax.tree.map(lambda *a: jnp.stack(a), *along)

    def block(self, states, volts, volts_by):
        """Compute phi and N of a block of samples, which change the sensitivity Z to phi Z + N."""
        parts = jax.vmap(self.sample)(states, volts, volts_by)
        by_state, by_logits, others, seen = (a.reshape(len(states) * self.substeps, *a.shape[2:]) for a in parts)
        phi, later = jnp.eye(states.shape[1], dtype=states.dtype), []
        for t in reversed(range(len(by_state))):  # from the end: A_last ... A_{t+1} is one product longer each time
            later.append(phi)
            phi = (phi[:, :, None] * by_state[t]).sum(1)
        later = jnp.stack(later[::-1])
        # rows of (later dg/dl) are pulled back through the encoder, so dl/dp (logits x weights) is never formed
        back = jax.vjp(lambda p: jax.vmap(lambda f: self.numbers.logits(p, f))(seen), self.numbers.encoder)[1]
        by_encoder = jax.vmap(lambda rows: back(rows)[0], 1)((later[..., None] * by_logits[:, None]).sum(2))
        return phi, jnp.concatenate([by_encoder, jnp.einsum("tij,tjk->ik", later, others)], 1)

    def sensed(self, state, answer):
        """Compute the derivatives of the sensor's reading from those of the state."""
        if not self.with_effects:
            return answer[0]  # the sensor shows x itself
        n = self.numbers
        by_state, by_effects = jax.jacfwd(n.reading, (0, 1))(state, n.effects)
        return by_state @ answer + jnp.zeros((n.count,), answer.dtype).at[n.count - n.effects.size :].set(by_effects)


@jit
def run_slopes(model: Model, runs: Runs, dt: float, every: int) -> Float[Array, "records errors parameters"]:
    """Differentiate `run_errors` with respect to every trained parameter."""
    local, (records, size), count = _Local(model, dt), runs.start.shape, runs.voltage.shape[1] // every

    def through(answer, block):
        state, phi, new = block
        return phi @ answer + new, jax.vmap(local.sensed)(state, answer)

    def chunk(answer, item):
        """Compute several blocks in parallel, then the sensitivities Z at the first sample of each block."""
        blocks = item[0][:, :, 0], *jax.vmap(jax.vmap(local.block))(*item)
        return jax.lax.scan(through, answer, jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), blocks))

    def chunks(values):
        """Reshape (records, time, ...) to (chunks, records, blocks, every, ...), with zeros after the last block."""
        values = values[:, : count * every].reshape(records, count, every, *values.shape[2:])
        filled = jnp.pad(values, [(0, 0), (0, -count % _AT_ONCE)] + [(0, 0)] * (values.ndim - 2))
        return jnp.moveaxis(filled.reshape(records, -(-count // _AT_ONCE), _AT_ONCE, *values.shape[2:]), 1, 0)

    states, stages = fast_rollout(model, runs.voltage, dt, runs.start), partial(local.stages, runs, dt)
    items = chunks(states), chunks(stages(local.both)), chunks(jax.jacfwd(stages)(local.both))
    start = jnp.zeros((records, size, local.numbers.count), states.dtype)
    # blocks of zeros follow the last one; the values of Z there are cut off here
    slopes = jax.lax.scan(chunk, start, items)[1].reshape(-1, records, local.numbers.count)[:count]
    return _projected(jnp.moveaxis(slopes, 0, 1), runs, every)
