"""Compile one-sample steps of the model and of its inverse (eq. 13) for a control loop.

    inverse   (m, x, V_{-1}, V_{-2}), [x, ..., x^(n)]  ->  u = V + tau (3 V - 4 V_{-1} + V_{-2}) / (2 dt)
    decoder   (s, V, u_{-1}), u                        ->  displacement at the sample of u

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
from jaxtyping import Array, Float

from ...common.errors import BadInput
from ..model.coordinate import from_model, sign
from ..model.equation import equation_force
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import full_precision
from ..numerics.intersample import between
from ..simulate.decoder import film_voltage, rest_state, stage_fractions, step
from ..simulate.prediction import at_rate
from .one_sample import film_after, lag, memory_after


@dataclass(frozen=True)
class CompiledStep:
    """A compiled one-sample step with its state at rest.

    Attributes:
        carry: state at rest, shape (C,), float32.
        inputs: number of inputs per sample.
        run: fn(carry, input of shape (inputs,)) -> (carry, output of shape ()), compiled. If an input is not finite,
            the output is nan and the carry does not change.
        exported: the step itself; its `serialize()` (needs flatbuffers) gives bytes for `restore_step`.
    """

    carry: Float[np.ndarray, " carry"]
    inputs: int
    run: Callable[[Array, Array], tuple[Array, Array]]
    exported: export.Exported


def inverse_step(model: Model | Fitted, dt: float) -> CompiledStep:
    """Compile the step from a wanted [y, ..., y^(n)] (m/s^i, from 0 V) to the voltage before limits (V).

    Args:
        model: identified or trained, without effects.
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
    model = _refused(model_of(model), dt)
    memories, scale = model.memory.size, np.asarray(sign(model) * np.asarray(model.scales.state), np.float32)

    def one(carry: Float[Array, " carry"], wanted: Float[Array, " tokens"]):
        memory, (before, film_1, film_2) = carry[:memories], carry[memories:]
        x = wanted / scale
        memory = memory_after(model.memory, memory, before, x[0], dt)
        force = equation_force(model, model.encoder.over()([*x[:-1], *memory]), list(x))[0]
        film = film_voltage(model, force)
        # V' from the last two samples, because later samples are unknown in a loop
        voltage = film + lag(model.drive) * (3 * film - 4 * film_1 + film_2) / (2 * dt)
        return jnp.concatenate([memory, jnp.stack([x[0], film, film_1])]), voltage

    rest = jnp.zeros((), jnp.float32)
    memory = model.memory.initial(rest)
    rates = jnp.array(model.memory.rate()(memory, rest))
    before = memory - dt * rates  # elapsed time: the first sample is at age 0
    return _compiled(one, np.concatenate([np.asarray(before), np.zeros(3)]), model.order + 1)


def decoder_step(model: Model | Fitted, dt: float) -> CompiledStep:
    """Compile the step from a voltage (V) to the displacement (base unit, from 0 V) at the same sample.

    Args:
        model: identified or trained, without effects.
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
    model = at_rate(model, dt)
    fractions = stage_fractions(model)

    def one(carry: Float[Array, " carry"], drive: Float[Array, " one"]):
        state, (film, before) = carry[:-2], carry[-2:]
        now = film_after(model.drive, film, before, drive[0], dt)
        stages = between(jnp.stack([film, now]), model.hold, fractions, jnp)[0]
        state = step(model, state, stages, dt)
        shown = jnp.asarray(from_model(model, state[0] * model.scales.state[0]))
        return jnp.concatenate([state, jnp.stack([now, drive[0]])]), shown.astype(jnp.float32)

    return _compiled(one, np.concatenate([np.asarray(rest_state(model)), np.zeros(2)]), 1)


def restore_step(exported: bytes) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Restore the `run` of a `CompiledStep` from its bytes, compiled for this machine.

    Args:
        exported: bytes from `CompiledStep.exported.serialize()`.

    Returns:
        fn(carry, input) -> (carry, output), compiled.

    Examples:
        >>> run = pitp.restore_step(pitp.decoder_step(model, 1e-3).exported.serialize())  # doctest: +SKIP
    """
    return _compile(export.deserialize(bytearray(exported)))


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
    if model.effects:
        raise BadInput("real-time steps only work for models without effects")
    if not dt > 0:
        raise BadInput(f"dt must be positive, not {dt} s")
    return model


def _compiled(one, carry: np.ndarray, inputs: int) -> CompiledStep:
    def guarded(carry, values):
        after, output = one(carry, values)
        sound = jnp.isfinite(values).all()  # one lost sensor sample must not spoil the carry of all that follow
        after, output = jnp.asarray(after, jnp.float32), jnp.asarray(output, jnp.float32)
        return jnp.where(sound, after, carry), jnp.where(sound, output, jnp.nan)

    carry = carry.astype(np.float32)
    shapes = jax.ShapeDtypeStruct(carry.shape, jnp.float32), jax.ShapeDtypeStruct((inputs,), jnp.float32)
    exported = export.export(jax.jit(full_precision(guarded)))(*shapes)
    return CompiledStep(carry, inputs, _compile(exported), exported)
