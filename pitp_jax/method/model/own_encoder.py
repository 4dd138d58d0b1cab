"""Use any Equinox module as an encoder: a user's own network from features to logits.

    l = factor * module(S, m)         S, m: scaled state and memories, shape (n + K,);  l: logits, shape (n + 2,)

The factor is a parameter like the module's weights. At 0 the encoder is the identified linear model, whatever the
module returns.
"""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...common.errors import BadInput
from .constants import map_parameters
from .encoder import AbstractEncoder, plain


class OwnEncoder(AbstractEncoder):
    """An encoder around a user's Equinox module; `Model`, `train` and `load` wrap modules automatically.

    The module is called as `module(features)` with scaled features of shape (n + K,): the state x, x', ..., x^(n-1),
    then the K memories. It returns n + 2 logits: one per token sigma_0 ... sigma_n, then the offset token. Logits of 0
    are the identified linear model. A module with an argument `key` gets one in the first phase of the training only,
    for dropout; otherwise it must be deterministic.

    Attributes:
        module: the user's module; its inexact arrays are parameters and are stored in model files.
        factor: multiplies the logits, shape ().
    """

    module: Any
    factor: Float[Array, ""]

    def __init__(self, module: Any, factor: Float[Array, ""] | float = 1.0):
        """Store the user's module, with its NumPy arrays converted to JAX arrays."""
        self.module = jax.tree.map(lambda a: jnp.asarray(a) if isinstance(a, np.ndarray) else a, module)
        self.factor = jnp.asarray(factor, jnp.result_type(float) if isinstance(factor, float) else None)

    def __call__(self, features, *, key=None):
        """Compute the logits of one instant, shape (n + 2,), in the precision of the features."""
        options = {}
        if key is not None and "key" in inspect.signature(self.module).parameters:
            options["key"] = key
        return (self.factor * self.module(features, **options)).astype(features.dtype)

    def scaled(self, factor):
        """Return the encoder with its logits multiplied by `factor`."""
        return OwnEncoder(self.module, factor * self.factor)

    def token_nets(self):
        """Return the encoder with 1 for every weight: it has no polynomial, but may have as many weights as a net."""
        return map_parameters(jnp.ones_like, self)


def as_encoder(given: Any) -> Any:
    """Wrap a user's Equinox module as an encoder; return an encoder of this package unchanged."""
    wrapped = isinstance(given, AbstractEncoder) or not isinstance(given, eqx.Module)
    return given if wrapped else OwnEncoder(given)


def own_module(encoder: AbstractEncoder) -> Any:
    """Return the user's own module inside an encoder; None for an encoder of this package."""
    inner = plain(encoder)
    return inner.module if isinstance(inner, OwnEncoder) else None


def build_own(given: Any, features: int, logits: int, key) -> OwnEncoder:
    """Build an encoder from a user's module, or from a function (features, logits, key=key) that builds one.

    Raises:
        BadInput: its logits do not have the shape (logits,), or it does not take that many features.
    """
    encoder = OwnEncoder(given if isinstance(given, eqx.Module) else given(features, logits, key=key))
    wanted = f"it must take {features} features (order + memories) and return {logits} logits (order + 2)"
    try:
        shape = eqx.filter_eval_shape(encoder, jax.ShapeDtypeStruct((features,), jnp.float32)).shape
    except Exception as error:
        raise BadInput(f"encoder {type(encoder.module).__name__}: {wanted}; it fails with {error}") from None
    if shape != (logits,):
        raise BadInput(f"encoder {type(encoder.module).__name__}: {wanted}; its result has shape {shape}")
    return encoder
