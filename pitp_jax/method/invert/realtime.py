"""Compile one-sample steps of the model and of its inverse (eq. 13) for a control loop.

    inverse   carry, [y, ..., y^(n)]  ->  carry, voltage           decoder   carry, voltage  ->  carry, displacement

Both are the steps of exported code (`steps`).
The state between samples is one flat float32 vector. The steps are exported (`jax.export`): as bytes they run in any
later process on the same kind of device without this package. The inverse uses past samples only, `invert_path` both
sides: V' is of 2nd order instead of 4th.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ...common.errors import BadInput, refuse_if
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import full_precision
from . import steps


@dataclass(frozen=True)
class CompiledStep:
    """A compiled one-sample step with its state at rest.

    Attributes:
        carry: state at rest, shape (C,), float32; pass it to the first call of `run`, then what `run` returned.
        inputs: number of inputs per sample: 1 (V) of a decoder, n + 1 (y to y^(n), m/s^i) of an inverse of order n.
        run: fn(carry, input of shape (inputs,)) -> (carry, output of shape ()), compiled; the output is a displacement
            (m) of a decoder, a voltage (V) of an inverse. If an input is not finite, the output is nan and the carry
            does not change.
        exported: the step itself; its `serialize()` (needs flatbuffers) gives bytes for `restore_step`.
    """

    carry: Float[np.ndarray, " carry"]
    inputs: int
    run: Callable[[Array, Array], tuple[Array, Array]]
    exported: export.Exported


def inverse_step(model: Model | Fitted, dt: float) -> CompiledStep:
    """Compile the step from a wanted [y, ..., y^(n)] (m/s^i, from 0 V) to the voltage before limits (V).

    Args:
        model: identified or trained, without effects (parts beyond its equation, such as friction or a delay).
        dt: sampling interval, s.

    Returns:
        the step: [y, ..., y^(n)] in, a voltage out.

    Raises:
        BadInput: the model has effects, or dt is not positive.

    Examples:
        >>> step = pitp.inverse_step(model, dt=1e-3)
        >>> carry, volts = step.run(step.carry, np.array([1e-3, 0, 0], np.float32))
        >>> round(float(volts))  # 1 mm at 1 kV
        1000
    """
    return _compiled(steps.inverse(_refused(model_of(model), dt), dt))


def decoder_step(model: Model | Fitted, dt: float) -> CompiledStep:
    """Compile the step from a voltage (V) to the displacement (base unit such as m, 0 at 0 V) at the same sample.

    Args:
        model: identified or trained, without effects (parts beyond its equation, such as friction or a delay).
        dt: sampling interval, s.

    Returns:
        the step: a voltage in, a displacement out.

    Raises:
        BadInput: the model has effects, dt is not positive, or the voltage between samples is read from later ones
            (hold "bandlimited").

    Examples:
        >>> step = pitp.decoder_step(model, dt=1e-3)
        >>> carry, x = step.run(step.carry, np.array([1000.0], np.float32))
        >>> 0 < float(x) < 1e-6  # m, one sample after rest
        True
    """
    model = _refused(model_of(model), dt)
    if model.hold == "bandlimited":
        raise BadInput("a model with hold 'bandlimited' has no real-time step; identify with hold 'zoh' or 'foh'")
    return _compiled(steps.predict(model, dt))


def restore_step(exported: bytes) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Restore the `run` of a `CompiledStep` from its bytes, compiled for this machine.

    Args:
        exported: bytes from `CompiledStep.exported.serialize()`.

    Returns:
        fn(carry of shape (C,), input of shape (inputs,)) -> (carry, output of shape ()), in float32, as
        `CompiledStep.run`; the first carry is `CompiledStep.carry`, which is stored apart.

    Raises:
        BadInput: bytes of something else.

    Examples:
        >>> run = pitp.restore_step(pitp.decoder_step(model, 1e-3).exported.serialize())  # doctest: +SKIP
    """
    try:
        step = export.deserialize(bytearray(exported))
    except Exception as problem:  # flatbuffers reads anything: the kinds of its errors are those of random offsets
        raise BadInput("the bytes do not hold a step; give those of `CompiledStep.exported.serialize()`") from problem
    return _compile(step)


def _compile(exported: export.Exported):
    """Compile an exported step through `jax.jit` by calling it once; a `Compiled` object dispatches half as fast.

    64-bit inputs are rounded, because the caller may have enabled them.
    """
    run = jax.jit(lambda *given: exported.call(*(jnp.asarray(g, jnp.float32) for g in given)))
    carry, values = (np.zeros(a.shape, np.float32) for a in exported.in_avals)
    for given in (values, values.astype(np.float64)):  # one program unless 64 bits are enabled
        jax.block_until_ready(run(carry, given))
    return run


def _refused(model: Model, dt: float) -> Model:
    """Return the model; refuse one with effects, and a sampling interval that is not positive."""
    refuse_if(
        (model.effects, "real-time steps only work for models without effects"),
        (not dt > 0, f"dt must be positive, not {dt} s"),
    )
    return model


def _compiled(step: steps.Step) -> CompiledStep:
    """Compile a step, with its carry at rest and between samples as one flat float32 vector."""
    rest = jnp.zeros((), jnp.float32)
    carry, unravel = ravel_pytree(_single(step.start(rest, rest)))

    def guarded(carry, values):
        after, (output, *_) = step.run(unravel(carry), values)
        sound = jnp.isfinite(values).all()  # one lost sensor sample must not spoil the carry of all that follow
        after, output = _single((ravel_pytree(after)[0], output))
        return jnp.where(sound, after, carry), jnp.where(sound, output, jnp.nan)

    shapes = jax.ShapeDtypeStruct(carry.shape, jnp.float32), jax.ShapeDtypeStruct((step.inputs,), jnp.float32)
    exported = export.export(jax.jit(full_precision(guarded)))(*shapes)
    return CompiledStep(np.asarray(carry), step.inputs, _compile(exported), exported)


def _single(tree):
    return jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), tree)
