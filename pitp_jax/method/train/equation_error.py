"""Compute the training loss (paper, eq. 12): residual of the equation plus penalties on the coefficients.

    L1 = Huber_delta( sigma_off + sum_i sigma_i X_i - F )                     forces over their training maximum
    L2 = 1/m sum_i [ alpha relu(sigma_i - P_i) + beta relu(Q_i - sigma_i) ]   in units of the nominal token
    P = max(a^j y, b^j y), Q = min(a^j y, b^j y)                              the box of stage j

SmoothL1 with width delta is huber / delta. X is filtered and differentiated data; x^(n) enters here and never the
encoder.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.equation import equation_force
from ..model.model import Model
from ..model.rows import Rows


class EquationData(eqx.Module):
    """Scaled samples of all records: features (S, memory), derivatives X, force, and a weight for each sample."""

    features: Float[Array, "samples features"]
    equation: Float[Array, "samples tokens"]
    force: Float[Array, " samples"]
    weight: Float[Array, " samples"]

    def take(self, index) -> "EquationData":
        """Return the samples of these indices as a minibatch."""
        return jax.tree.map(lambda a: a[index], self)


def huber(residual, width: float):
    """Compute the SmoothL1 loss: r^2 / (2 width) for |r| < width, |r| - width / 2 beyond."""
    size = jnp.abs(residual)
    return jnp.where(size < width, 0.5 * size**2 / width, size - 0.5 * width)


def loss(model: Model, data: EquationData, box, *, width: float, penalty, key=None):
    """Compute the mean training loss (eq. 12) over a batch of samples.

    Args:
        box: (lower, upper) factors on the nominal tokens, e.g. (0.8, 1.2).
        width: Huber width, in units of the largest training force.
        penalty: (alpha, beta).
        key: turns dropout on.

    Returns:
        The total, and (L1, L2).
    """
    # a key for every sample, because one for all would drop the same units in the whole batch
    keys = None if key is None else jax.random.split(key, data.force.shape[0])
    logits = jax.vmap(lambda f, k: model.encoder(f, key=k), (0, None if key is None else 0))(data.features, keys)
    force, tokens = equation_force(model, list(logits.T), list(data.equation.T))
    return balance(model, force - data.force, tokens, data.weight, box, width=width, penalty=penalty)


def balance(model: Model, residual: Float[Array, " samples"], tokens: Rows, weight, box, *, width: float, penalty):
    """Compute the mean Huber loss and the penalties of coefficients outside the box: the total, and both parts."""
    # Huber, because a few noisy samples of x^(n) would dominate otherwise
    physics = jnp.mean(weight * huber(residual, width))
    factor = jnp.stack(tokens, -1) / model.coefficients  # the box is in units of the nominal, whatever its sign
    over, under = jax.nn.relu(factor - box[1]), jax.nn.relu(box[0] - factor)
    constraint = jnp.mean(penalty[0] * over + penalty[1] * under)
    return physics + constraint, (physics, constraint)
