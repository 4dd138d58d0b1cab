"""The whole fit of the cone, default preset."""

from ..fit import measure_fit


def measure(seconds: float) -> dict:
    """Seconds of the fit, and of one step beside PyTorch's."""
    return measure_fit("cone100", seconds)
