"""Compiled programs, which all models of one structure share, and the way of host arrays to the device.

Arrays of a model (weights, scales, offsets, its domain; of JAX or NumPy) are arguments of a program; static fields
(order, hold, substeps, the classes of the parts, layer sizes) make another one.
"""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

jit = eqx.filter_jit


def on_device(values, dtype=None) -> Array:
    """Copy an array of the host's to the device; `jnp.asarray` compiles a program for every shape, 20 ms each."""
    return jax.device_put(np.asarray(values, dtype))
