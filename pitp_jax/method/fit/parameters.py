"""Collect the trained parameters of a model, as one vector and by part of the model.

    p: the encoder's weights,   q: the memories' time constants,   r: the drive's,   a: the effects' parameters

Positive numbers are fitted by their logarithms: no step can make them negative, and a step is a factor.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Shaped

from ..model.constants import Constants
from ..model.model import Model
from ..numerics.where import where
from ..simulate import ports
from ..simulate.decoder import midpoint, motion_of, stage_voltages, substep


def trainable(model: Model):
    """Mark every number that training may change: encoder weights, time constants, effect parameters."""
    spec = jax.tree.map(lambda _: False, model)  # coefficients stay, because the encoder's factors move the tokens
    return eqx.tree_at(_parts, spec, jax.tree.map(_moves, _parts(model), is_leaf=_is_constant))


def _is_constant(part) -> bool:
    return isinstance(part, Constants)


def _moves(part):
    # inside a program the constants are arrays too, and only their class identifies them
    return jax.tree.map(lambda _: False, part) if _is_constant(part) else eqx.is_inexact_array(part)


def _parts(model: Model) -> tuple:
    return model.encoder, model.memory, model.drive, model.effects


def _logarithmic(model: Model) -> np.ndarray:
    """Mark the effect parameters that are fitted by their logarithm."""
    return np.array([p.positive for e in model.effects for p, _ in e.numbers()], bool)


def _stored(model: Model, numbers, xp):
    """Convert fitted values to effect parameters: the exponential where the logarithm was fitted."""
    logs = _logarithmic(model)
    # the inner `where` keeps exp from overflowing on values that are not logarithms, which would spoil the gradient
    return xp.where(logs, xp.exp(xp.where(logs, numbers, 0.0)), numbers)


def parameters(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return all trained parameters as one vector (encoder, memory, drive, effects), and the size of each part."""
    params = eqx.filter(model, trainable(model))
    parts = [np.asarray(ravel_pytree(part)[0], np.float64) for part in _parts(params)]
    logs = _logarithmic(model)
    # zero (an effect that is off) has no logarithm: it starts at a negligible value
    parts[3] = np.where(logs, np.log(np.maximum(np.where(logs, parts[3], 1.0), 1e-30)), parts[3])
    return np.concatenate(parts), np.array([len(p) for p in parts])


def with_parameters(model: Model, vector: Shaped[np.ndarray | Array, " parameters"]) -> Model:
    """Return the model with its trained parameters replaced by this vector."""
    params, static = eqx.partition(model, trainable(model))
    outside = isinstance(vector, np.ndarray)  # of any program: cut there, and copied to the device at once
    xp, new, first = np if outside else jnp, [], 0
    for part in _parts(params):
        leaves, tree = jax.tree.flatten(part)
        sizes = [leaf.size for leaf in leaves]
        values = xp.asarray(vector[first : first + sum(sizes)], jnp.result_type(*leaves) if leaves else None)
        values = _stored(model, values, xp) if part is params.effects else values
        cuts = xp.split(values, np.cumsum(sizes)[:-1]) if leaves else []
        arrays = [cut.reshape(leaf.shape).astype(leaf.dtype) for cut, leaf in zip(cuts, leaves, strict=True)]
        new.append(tree.unflatten(jax.device_put(arrays) if outside else arrays))
        first += sum(sizes)
    return eqx.combine(eqx.tree_at(_parts, params, tuple(new)), static)


class Numbers:
    """A model split into vectors of trained parameters (encoder, memory, drive, effects), and functions of these."""

    def __init__(self, model: Model):
        self.model = model
        params, self.static = eqx.partition(model, trainable(model))
        flat, (self._encoder, self._memory, self._drive, self._effects) = zip(
            *map(ravel_pytree, _parts(params)), strict=True
        )
        dtype = model.coefficients.dtype  # JAX would give an empty vector its default precision
        self.encoder, self.memory, self.drive, effects = (numbers.astype(dtype) for numbers in flat)
        logs = _logarithmic(model)
        self.effects = where(logs, jnp.log(where(logs, effects, 1.0)), effects)
        self.count = self.encoder.size + self.memory.size + self.drive.size + self.effects.size

    def with_effects(self, model: Model, a) -> Model:
        """Return a model with the effect parameters `a`."""
        if not self.model.effects:
            return model
        built = eqx.combine(self._effects(_stored(self.model, a, jnp)), self.static.effects)
        return eqx.tree_at(lambda m: m.effects, model, built)

    def stages(self, voltage, rest, dt: float, r, a):
        """Compute the film voltages at the stages of every sample of every record, for the parameters `r` and `a`."""
        drive, model = eqx.combine(self._drive(r), self.static.drive), self.with_effects(self.model, a)

        def one(u, rest):
            return stage_voltages(model, drive.film(ports.delayed(model, u, dt, rest), dt, rest))

        return jax.vmap(one)(voltage, rest)

    def logits(self, p, features):
        """Compute the encoder's logits with the weights `p`."""
        return eqx.combine(self._encoder(p), self.static.encoder)(features)

    def with_memory(self, q) -> Model:
        """Return the model with the memory time constants `q`."""
        return eqx.tree_at(lambda m: m.memory, self.model, eqx.combine(self._memory(q), self.static.memory))

    def seen(self, core, q, h: float):
        """Compute the encoder's features of a state half a substep later."""
        return jnp.stack(midpoint(motion_of(self.with_memory(q)), list(core), h))

    def moved(self, state, logits, q, volts, a, h: float):
        """Advance the state by one substep of h (s), with these logits and three stage voltages."""
        return substep(self.with_effects(self.with_memory(q), a), state, volts, h, logits)

    def reading(self, state, a):
        """Compute the scaled sensor reading of a state, with the effect parameters `a`."""
        return ports.reading(self.with_effects(self.model, a), state)
