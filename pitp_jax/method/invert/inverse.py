"""Invert a displacement, as a pure function of one recording for tracing, gradients and batches.

closed_form   u = drive^-1(sqrt(max(F, 0))),  F = sigma_off + sum_i sigma_i x^(i)     (paper, eq. 13)
discrete      the voltage whose decoder steps lead from each state to the next         (`discrete`)

Each signal is one recording; the caller vmaps, or `sharded_inverse` distributes many over devices.
"""

from typing import Literal

import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float

from ...common.errors import BadInput, refuse_traced
from ..model.coordinate import Zero
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit, signal
from ..numerics.spline_derivative import fast_derivatives
from ..simulate import ports
from ..simulate.along import equation_of, motion_along
from ..simulate.devices import local_rows, over_records, spread
from .discrete import along_motion
from .equation import invert_path, unreachable

Kind = Literal["closed_form", "discrete"]


def inverse(
    model: Model | Fitted,
    displacement: Float[np.ndarray | Array, " time"],
    *,
    kind: Kind = "closed_form",
    zero: Zero = "rest",
) -> tuple[Float[Array, " time"], Bool[Array, " time"]]:
    """Compute the voltage (V) with which the model follows a displacement (m) that starts at rest.

    `feedforward` adds limits, a lead-in and a check.

    Args:
        model: any: identified, trained, with effects.
        displacement: shape (time,), m, at the model's own sampling interval: 0 at 0 V, growing as the actuator
            extends (behind a linear input with the sensor's sign).
        kind: "closed_form" inverts the continuous equation (eq. 13); "discrete" inverts the decoder's own steps along
            the same derivatives, so a free run meets the displacement more closely (not for hold "bandlimited").
        zero: where the displacement is 0: "rest", at 0 V; "sensor", the sensor's own readings; or its value at 0 V.

    Returns:
        voltage, shape (time,), V; and a mask, shape (time,), True where no voltage produces the force: it is clipped at
            F = 0 there.

    Raises:
        BadInput: another kind, fewer samples than the order needs, or "discrete" for a band-limited voltage.

    Examples:
        >>> wanted = 1e-4 * (1 - jnp.cos(jnp.linspace(0.0, 6.28, 400)))
        >>> volts, unreachable = pitp.inverse(model, wanted)
        >>> volts.shape, bool(unreachable.any())
        ((400,), False)
    """
    if kind not in ("closed_form", "discrete"):
        raise BadInput(f"kind {kind!r} is not 'closed_form' or 'discrete'")
    model = model_of(model)
    return _inverse(model, signal(model, displacement, "displacement"), model.dt, kind, zero)[:2]


@jit
def _inverse(model: Model, displacement: Float[Array, " time"], dt, kind: Kind, zero: Zero):
    equation = equation_of(model, motion_along(model, displacement, dt, zero), dt)
    force, voltage, features = invert_path(model, equation, dt)
    if kind == "discrete":
        voltage = ports.played(model, along_motion(model, force, features, dt), dt, exact=True)
    # XLA would compute a force that is not returned twice: for the voltage, and for the mask
    return voltage.astype(equation.dtype), unreachable(model, force, dt), force


def _voltages(model, equation, dt: float):
    # one record after the other: an inverse is an array over time already, and long records fill the memory
    return jax.lax.map(lambda e: invert_path(model, e, dt)[1], equation)


def sharded_inverse(
    model: Model | Fitted, displacement: Float[np.ndarray, "records time"], dt: float, mesh: Mesh
) -> Float[np.ndarray, "records time"]:
    """Compute the voltages (V) for this process's wanted displacements (m) from rest, on all devices.

    Args:
        model: the same in every process, without effects.
        displacement: this process's, m, shape (records, T).
        dt: sampling interval, s.
        mesh: of `records_mesh`.

    Returns:
        voltages, shape (records, T).

    Examples:
        >>> mesh = pitp.records_mesh(jax.devices()[:1])
        >>> pitp.sharded_inverse(model, np.full((1, 64), 1e-3), 1e-3, mesh).shape
        (1, 64)
    """
    refuse_traced("sharded_inverse", "inverse", model, displacement)
    model = model_of(model)
    # on the host, in float64, because float32 has too few digits for derivatives
    rows = np.stack([fast_derivatives(x, dt, model.order) for x in displacement]) / model.scales.state
    batch = spread((rows.astype(model.coefficients.dtype),), mesh)
    return local_rows(over_records(_voltages, mesh, model, batch, dt=float(dt)), len(displacement))
