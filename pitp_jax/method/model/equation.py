"""Evaluate the equation of motion (paper, eq. 5 with an offset token): F = sigma_off + sum_i sigma_i x^(i)."""

from jaxtyping import Array

from .model import Model
from .rows import Rows


def equation_force(model: Model, logits: Rows, equation: Rows) -> tuple[Array, list[Array]]:
    """Compute the scaled force for these logits and the scaled derivatives x, ..., x^(n); return it with the tokens."""
    tokens, force = model.tokens_from(logits)
    for token, row in zip(tokens, equation, strict=True):
        force = force + token * row
    return force, tokens
