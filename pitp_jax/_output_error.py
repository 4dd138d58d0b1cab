"""The output error of a linear ODE over a padded set of records, and the covariance of its parameters.

    r_t = w_t (gain x_t(poles, start) + offset - y_t),    p = (log pole coefficients, gain, offset, [starts])
    the offset is fitted only where no record starts at rest: a linear model's misfit would bend it by far more than
    the first samples leave open (cone100 sweep: 11 um against 1)

Everything is normalised: voltage, output and frequency by their scales. The covariance is a block sandwich
(J'J)^-1 (sum_b g_b g_b') (J'J)^-1, g_b the gradient over one of 64 blocks of time: model error is strongly
correlated, and the textbook formula would understate the errors by an order of magnitude.
"""

from collections.abc import Sequence
from functools import lru_cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._errors import BadInput
from ._poles import respond
from ._record.preprocess import force_band
from ._record.record import Record
from ._rest import initial_rest

_BLOCKS = 64


class OutputError(eqx.Module):
    """The data of one identification: padded to (records, time), normalised by the scales it carries."""

    drive: Float[Array, "records time"]
    output: Float[Array, "records time"]
    weight: Float[Array, "records time"]
    rest: tuple[bool, ...] = eqx.field(static=True)
    square: bool = eqx.field(static=True)
    dt: float  # this and the next four are leaves: a static number would compile every problem anew
    omega: float
    voltage_scale: float
    output_scale: float
    offset: float

    def parameters(self, order: int) -> int:
        """Number of parameters: poles, gain, an offset unless some record rests, a start per moving record."""
        return order + 1 + self.free_offset + order * self.rest.count(False)

    @property
    def free_offset(self) -> bool:
        """Whether the sensor's offset has to be fitted."""
        return not any(self.rest)


def build_problem(records: Sequence[Record], input_map: str) -> OutputError:
    """Normalise and pad the records; find rest, offset and the unit of frequency."""
    dt, size = records[0].dt, max(r.samples for r in records)
    rest, offset = initial_rest(records)
    output, drive, weight = (np.zeros((len(records), size)) for _ in range(3))
    for k, r in enumerate(records):
        drive[k, : r.samples], drive[k, r.samples :] = r.voltage, r.voltage[-1]
        weight[k, : r.samples] = r.observed
        output[k, : r.samples] = np.where(r.observed, r.displacement - offset, 0.0)
    voltage_scale, output_scale = float(np.abs(drive).max()), float(np.sqrt((output**2).sum() / weight.sum()))
    if np.ptp(drive) == 0:
        raise BadInput("the voltage never changes in these records: record an excitation such as a sweep")
    if np.ptp(np.concatenate([r.displacement[r.observed] for r in records])) == 0:
        raise BadInput("the displacement never changes in these records: check the sensor and its column")
    band = force_band([np.asarray(r.voltage ** (2 if input_map == "square" else 1)) for r in records], dt)
    return OutputError(
        jnp.asarray(drive / voltage_scale), jnp.asarray(output / output_scale), jnp.asarray(weight),
        rest=tuple(bool(v) for v in rest), square=input_map == "square", dt=dt,
        omega=float(2 * np.pi * min(band, 0.1 / dt)), voltage_scale=voltage_scale, output_scale=output_scale,
        offset=offset,
    )  # fmt: skip


@partial(jax.jit, static_argnames=("order", "hold"))
def residual(
    params: Float[Array, " parameters"], problem: OutputError, *, order: int, hold: str
) -> Float[Array, " residuals"]:
    """Weighted output error, flattened over records and time."""
    rest = np.asarray(problem.rest)
    starts = jnp.zeros((len(rest), order), params.dtype)
    if not rest.all():
        starts = starts.at[np.flatnonzero(~rest)].set(params[order + 1 + problem.free_offset :].reshape(-1, order))
    run = partial(respond, step=problem.omega * problem.dt, square=problem.square, hold=hold)
    unit = jax.vmap(run, in_axes=(None, 0, None))(params[:order], problem.drive, jnp.zeros(order, params.dtype))
    modelled = params[order] * unit + (params[order + 1] if problem.free_offset else 0.0)
    if not rest.all():  # the free response is linear in the start: added outside the gain
        free = jax.vmap(run, in_axes=(None, None, 0))(params[:order], 0 * problem.drive[0], starts)
        modelled = modelled + free
    return (problem.weight * (modelled - problem.output)).reshape(-1)


@lru_cache
def residual_function(order: int, hold: str):
    """The residual as fn(params, problem), one object per order and hold so that a solver compiles it once.

    A ridge of 1e-5 per sample on the logarithms gives directions the data do not see (a pole far above the band) a
    minimum; it moves identifiable poles by less than 1e-6 of themselves.
    """

    def fn(params, problem):
        ridge = 1e-5 * jnp.sqrt(problem.weight.sum()) * params[:order]
        return jnp.concatenate([residual(params, problem, order=order, hold=hold), ridge])

    return fn


def numerical_jacobian(fn, params: np.ndarray) -> np.ndarray:
    """Central differences of a float64 function, shape (outputs, parameters); good to 1e-9, and nothing to compile."""
    step = 1e-6 * np.maximum(np.abs(params), 1e-3)
    columns = []
    for k, h in enumerate(step):
        move = np.zeros_like(params)
        move[k] = h
        columns.append((np.asarray(fn(params + move)) - np.asarray(fn(params - move))) / (2 * h))
    return np.stack(columns, -1)


def covariance(params: np.ndarray, problem: OutputError, *, order: int, hold: str) -> np.ndarray:
    """Block-sandwich covariance of the parameters, shape (parameters, parameters); inf where singular."""

    def fn(p):
        return residual(jnp.asarray(p), problem, order=order, hold=hold)

    jacobian, left = numerical_jacobian(fn, params), np.asarray(fn(params))
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return np.full((len(params),) * 2, np.inf)
    blocks = zip(np.array_split(jacobian, _BLOCKS), np.array_split(left, _BLOCKS), strict=True)
    scores = np.stack([j.T @ r for j, r in blocks])
    return inverse @ (scores.T @ scores) @ inverse
