"""Network and inverse of the default preset, 120,000 instants, beside the same network in PyTorch."""

from ..inverse import network_and_inverse
from ..subjects import default


def measure(seconds: float) -> dict:
    """Three nets of width 8 on 1, 7 and 4 features with 2, 1 and 1 outputs, and the polynomials."""
    width = 8
    return network_and_inverse(default(), width * (1 + 7 + 4) + width * (2 + 1 + 1) + 30, seconds)
