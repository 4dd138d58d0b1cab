"""Compile programs that all models of one structure share: what a model was made from is no part of their key.

    jit(f)(model, ...) = eqx.filter_jit(f)(bare(model), ...)

Arrays (weights, scales, offsets; of JAX or NumPy) are arguments of a program; static fields (order, hold, substeps, the
classes of the parts, layer sizes) make another one. Provenance is static too, since its texts cannot be traced, and is
taken off before the call. Were it merely left out of the comparison, a function that reads it would bake in, and one
that returns a model hand back, the notes of whoever called first.
"""

from collections.abc import Callable
from copy import copy
from functools import wraps
from typing import ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .model import REMOVED, Model

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def on_device(values, dtype=None) -> Array:
    """Copy an array of the host's to the device; `jnp.asarray` compiles a program for every shape, 20 ms each."""
    return jax.device_put(np.asarray(values, dtype))


def in_double(tree: T) -> T:
    """The same with its arrays of numbers in float64; call it under `jax.enable_x64(True)`."""
    return jax.tree.map(lambda a: a.astype(jnp.float64) if eqx.is_inexact_array(a) else a, tree)


def bare(tree: T) -> T:
    """Take the provenance off every model in a tree; reading it fails then."""

    def removed(node):
        if not isinstance(node, Model):
            return node
        without = copy(node)  # not `replace`: what is stacked, or half a model, passes no check of shapes
        object.__setattr__(without, "provenance", REMOVED)  # a copy of our own: nobody else holds it yet
        return without

    return jax.tree.map(removed, tree, is_leaf=lambda node: isinstance(node, Model))


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of models (`eqx.filter_jit`); a model that is returned comes without provenance."""
    compiled = eqx.filter_jit(function)

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        args, kwargs = bare((args, kwargs))
        return compiled(*args, **kwargs)

    return run
