"""Invert a displacement that arrives in blocks, with constant memory use.

    rows [x, ..., x^(n)]   from R samples on either side (`spline_derivative`)
    memory m               carried from window to window
    u = V + tau V'         uses two rows of the next window

Voltages are those of the whole path at once, to rounding. Windows are of one size, so two compilations serve any length
(the last window is shorter); time counts within a window, so only the memories' own state may grow.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...common.errors import BadInput, refuse_if, refuse_traced
from ..model.coordinate import to_model
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..numerics.spline_derivative import derivatives_of_blocks
from .equation import force_and_voltage, scaled_equation, tolerance

_WINDOW = 1 << 17  # rows of a window
_SMALLEST = 16  # rows of a window, which overlaps both neighbours
_AHEAD = 2  # rows that `drive.lead` looks ahead and back


@dataclass(frozen=True)
class Piece:
    """A part of the computed voltage; the parts follow one another without gaps.

    Attributes:
        voltage: drive voltage before any limit, V, shape (samples,).
        infeasible: True where the model needs a force that no voltage produces.
    """

    voltage: Float[np.ndarray, " samples"]
    infeasible: Bool[np.ndarray, " samples"]


def invert_stream(
    model: Model | Fitted, blocks: Iterable[Float[np.ndarray, " _"]], dt: float, *, window: int = _WINDOW
) -> Iterator[Piece]:
    """Compute the voltage for a wanted displacement that arrives in blocks and starts at rest, without shooting.

    Args:
        model: identified or trained, without effects.
        blocks: wanted displacement from the position at 0 V, base unit.
        dt: sampling interval, s.
        window: samples per pass, at least 16; memory use is proportional to it.

    Returns:
        pieces of the result, in order, as soon as they are known.

    Raises:
        BadInput: the model has effects, dt is not positive or the window too small; later, a sample is missing, or all
            blocks together are too short for its order.

    Examples:
        >>> pieces = pitp.invert_stream(model, np.split(target.displacement, 4), target.dt)
        >>> sum(len(piece.voltage) for piece in pieces) == len(target.displacement)
        True
    """
    refuse_traced("invert_stream", "inverse", model, None if isinstance(blocks, Iterator) else blocks)
    model = model_of(model)
    one = isinstance(blocks, np.ndarray) and blocks.ndim < 2
    refuse_if(
        (one, "blocks is one array: give a list of arrays, [displacement] where there is only one"),
        (model.effects, "streaming does not support effects; use `feedforward`"),
        (
            not dt > 0 or window < _SMALLEST,
            f"dt {dt} s, window {window}: dt must be positive, and window at least {_SMALLEST}",
        ),
    )
    return _pieces(model, blocks, dt, window)


def _pieces(model: Model, blocks, dt: float, window: int) -> Iterator[Piece]:
    state = model.memory.initial(jnp.zeros((), model.coefficients.dtype))
    rows, back = np.zeros((0, model.order + 1)), 0
    moved = (to_model(model, block) for block in _whole(blocks))
    for more in derivatives_of_blocks(_sized(moved, window), dt, model.order):
        rows = np.concatenate([rows, more])
        while len(rows) > window:
            inverted = force_and_voltage(model, scaled_equation(model, rows[:window]), dt, state)
            yield _piece(model, inverted, slice(back, window - _AHEAD))
            # windows overlap by the rows that a derivative of V needs on either side
            state, back = inverted[2][window - 2 * _AHEAD], _AHEAD
            rows = rows[window - 2 * _AHEAD :]
    if len(rows):
        yield _piece(model, force_and_voltage(model, scaled_equation(model, rows), dt, state), slice(back, None))


def _whole(blocks) -> Iterator[np.ndarray]:
    """Yield the blocks; refuse a missing sample, because one nan would zero a whole window's voltage."""
    first = 0
    for block in blocks:
        values = np.asarray(block, np.float64)
        if not np.isfinite(values).all():
            place = first + int(np.argmin(np.isfinite(values)))
            raise BadInput(f"sample {place} of the wanted displacement is not a number; fill it, or stop there")
        first += len(values)
        yield values


def _piece(model: Model, inverted, kept: slice) -> Piece:
    force, voltage, _ = inverted
    return Piece(np.asarray(voltage)[kept], np.asarray(model.input_map.infeasible(force + tolerance(model)))[kept])


def _sized(blocks: Iterable[np.ndarray], size: int) -> Iterator[np.ndarray]:
    """Yield the samples regrouped in blocks of at least `size`; the last block may be shorter."""
    waiting, count = [], 0
    for block in blocks:
        waiting.append(block)
        count += len(block)
        if count >= size:
            yield np.concatenate(waiting)
            waiting, count = [], 0
    if count:
        yield np.concatenate(waiting)
