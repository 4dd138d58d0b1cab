"""The equation at one instant (paper, eq. 5 with an offset token): F = sigma_off + sum_i sigma_i(S, m) x^(i)."""

from jaxtyping import Array, Float

from .model import Model


def equation_force(
    model: Model, features: Float[Array, " features"], equation: Float[Array, " tokens"], *, key=None
) -> tuple[Float[Array, ""], Float[Array, " tokens"]]:
    """Scaled force the model needs at one instant (eq. 5 plus the offset token), and the tokens."""
    tokens, offset = model.tokens(features, key=key)
    return tokens @ equation + offset, tokens
