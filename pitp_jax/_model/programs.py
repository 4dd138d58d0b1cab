"""Compile programs, which all models of one structure share, and take arrays of the host to the device.

Arrays of a model (weights, scales, offsets, its domain; of JAX or NumPy) are arguments of a program; static fields
(order, hold, substeps, the classes of the parts, layer sizes) make another one. What a model was made from stands
beside it (`Fitted.origin`), where no program sees it.
"""

from functools import wraps
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

T = TypeVar("T")


def full_precision(function):
    """Let a function multiply float32 matrices in full precision, whatever the user's default, also where it is traced.

    JAX multiplies float32 matrices in TF32 on recent NVIDIA GPUs: inverse voltages were wrong by 1e-3 of the largest.
    """

    @wraps(function)
    def precise(*args, **options):
        with jax.default_matmul_precision("highest"):
            return function(*args, **options)

    return precise


def jit(function):
    """Compile a function with its float32 products in full precision (`full_precision`)."""
    return eqx.filter_jit(full_precision(function))


def on_device(values, dtype=None) -> Array:
    """Copy an array of the host's to the device; `jnp.asarray` compiles a program for every shape, 20 ms each."""
    return jax.device_put(np.asarray(values, dtype))


def in_double(tree: T) -> T:
    """Convert the arrays of numbers in a tree to float64; call it under `jax.enable_x64(True)`."""
    return jax.tree.map(lambda a: a.astype(jnp.float64) if eqx.is_inexact_array(a) else a, tree)
