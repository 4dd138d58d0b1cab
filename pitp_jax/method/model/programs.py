"""Compile programs that all models of one structure share, and copy arrays from the host to the device.

Arrays of a model (weights) and its constants (scales, offsets, its domain) are arguments of a program; static fields
(order, hold, substeps, the classes of the parts, layer sizes) make another one. The origin of a model lies outside
every program (`Fitted.origin`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...common.errors import BadInput
from .constants import as_arguments, map_parameters

P = ParamSpec("P")
T = TypeVar("T")


def full_precision(function: Callable[P, T]) -> Callable[P, T]:
    """Make a function multiply float32 matrices with full precision, whatever the user's default.

    JAX multiplies float32 matrices in TF32 on recent NVIDIA GPUs, which gave voltage errors of 1e-3 of the largest.
    """

    @wraps(function)
    def precise(*args, **options):
        with jax.default_matmul_precision("highest"):
            return function(*args, **options)

    return precise


def jit(function: Callable[P, T]) -> Callable[P, T]:
    """Compile by `eqx.filter_jit`; constants of a model are arguments, and float32 products have full precision."""
    compiled: Any = eqx.filter_jit(full_precision(function))

    @wraps(function)
    def call(*args: P.args, **options: P.kwargs) -> T:
        return compiled(*as_arguments(args), **as_arguments(options))

    return call


def on_device(values, dtype=None) -> Array:
    """Copy an array from the host to the device. `jnp.asarray` would compile a program for every shape (20 ms)."""
    return jax.device_put(np.asarray(values, dtype))


def signal(model, values, name: str) -> Array:
    """Convert one recording's signal to an array of the model's precision, shape (time,).

    Raises:
        BadInput: something else than numbers, or several recordings.
    """
    try:
        array = jnp.asarray(values, model.coefficients.dtype)
    except (TypeError, ValueError):
        raise BadInput(f"{name} is a {type(values).__name__}, not an array of numbers") from None
    if array.ndim != 1:
        raise BadInput(f"{name} has shape {array.shape}: give one recording, shape (time,), and use jax.vmap for more")
    return array


@contextmanager
def double_on_cpu() -> Iterator[None]:
    """Compute in float64 on the CPU, whatever JAX's defaults are."""
    with jax.enable_x64(True), jax.default_device(jax.local_devices(backend="cpu")[0]):
        yield


def in_double(tree: T) -> T:
    """Convert the float arrays in a pytree to float64; call it under `jax.enable_x64(True)`."""
    return map_parameters(lambda a: a.astype(jnp.float64), tree)
