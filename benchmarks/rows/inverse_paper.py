"""Network and inverse of the paper preset, 120,000 instants, beside the paper's separate networks in PyTorch."""

from ..inverse import network_and_inverse
from ..subjects import paper


def measure(seconds: float) -> dict:
    """Three networks: a table row per feature for the fusion, two layers of 128, one output."""
    tokens, features, width = 3, 3, 128
    return network_and_inverse(paper(), tokens * (features * width + 2 * width**2 + width), seconds)
