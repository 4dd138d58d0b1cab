"""Invert a displacement, as a pure function of one recording for tracing, gradients and batches.

closed_form   u = drive^-1(sqrt(max(F, 0))),  F = sigma_off + sum_i sigma_i x^(i)     (paper, eq. 13)
discrete      the voltage whose decoder steps lead from each state to the next         (`discrete`)

Each signal is one recording; the caller vmaps.
"""

from typing import Literal

import numpy as np
from jaxtyping import Array, Bool, Float

from ...common.errors import BadInput
from ..model.coordinate import Zero
from ..model.fitted import Fitted, model_of
from ..model.model import Model
from ..model.programs import jit, signal
from ..simulate import ports
from .discrete import along_motion
from .equation import invert_path, unreachable
from .tokens import equation_of, motion_along

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
    displacement = signal(displacement, model.coefficients.dtype, "displacement")
    return _inverse(model, displacement, model.dt, kind, zero)


@jit
def _inverse(model: Model, displacement: Float[Array, " time"], dt, kind: Kind, zero: Zero):
    equation = equation_of(model, motion_along(model, displacement, dt, zero), dt)
    force, voltage, features = invert_path(model, equation, dt)
    if kind == "discrete":
        voltage = ports.played(model, along_motion(model, force, features, dt), dt, exact=True)
    return voltage.astype(equation.dtype), unreachable(model, force, dt)
