"""Convert a logit to a positive factor of a token: g(l) = 1 + l for l > -1/2, -1 / (4 l) below.

Positive, C1 (both branches have value 1/2 and slope 1 at l = -1/2), g(0) = 1, and exactly linear where tokens usually
are.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def positive_factor(logit: Float[Array, "..."]) -> Float[Array, "..."]:
    """Compute the positive factor g(l) by which a logit l multiplies its token."""
    # the inner `where` keeps the untaken branch from dividing by zero, which would spoil the gradient
    low = logit < -0.5
    return jnp.where(low, -0.25 / jnp.where(low, logit, -1.0), 1.0 + logit)


def logit_of(factor: Float[Array, "..."]) -> Float[Array, "..."]:
    """Compute the logit l for which g(l) equals a positive factor."""
    low = factor < 0.5
    return jnp.where(low, -0.25 / jnp.where(low, factor, 1.0), factor - 1.0)
