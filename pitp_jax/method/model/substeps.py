"""Choose the number of Runge-Kutta (RK4) steps per sample of a linear model.

e^z - R(z) = z^5 / 120 + ...,   z = p h:   a step has a relative error of |z|^5 / 120
at the resonance errors add up over 1 / (zeta |z|) steps:   error = |z|^4 / (240 zeta) of its range
|z| <= min(1/4, (240 zeta e)^(1/4)),   e = 2e-4,   and for poles above the Nyquist frequency |z| < 2 (stable up to 2.78)
"""

import numpy as np
from jaxtyping import Float

from .dominant import nonzero_poles


def substeps(a: Float[np.ndarray, " tokens"], dt: float) -> int:
    """Return the number of Runge-Kutta steps per sample of `dt` (s) for the coefficients a_0 ... a_n."""
    poles = nonzero_poles(np.nan_to_num(a))
    size = np.abs(poles)
    # with less damping than 1e-4, errors add up over more periods than a recording has
    damping = np.maximum(-np.real(poles) / size, 1e-4)
    # 1/4: frozen tokens make the decoder of order two, whatever the nominal's poles allow
    accurate = size * dt / np.minimum((240 * damping * 2e-4) ** 0.25, 0.25)
    # a pole that needs more than 16 steps for accuracy is faster than the samples can show
    needed = np.maximum(np.minimum(accurate, 16), size * dt / 2)
    # 1e-9: rounding must not add a step
    return int(min(np.ceil(needed.max(initial=1.0) - 1e-9), 4096))
