"""Choose between two arrays: `jnp.where` with three arguments, annotated as an array for JAX up to 0.9."""

from typing import Any, cast

import jax.numpy as jnp
from jaxtyping import Array


def where(condition: Any, x: Any, y: Any) -> Array:
    """Return x where the condition is true, otherwise y, broadcast to one shape."""
    return cast(Array, jnp.where(condition, x, y))
