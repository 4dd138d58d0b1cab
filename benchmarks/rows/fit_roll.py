"""The whole fit of the roll, default preset."""

from ..fit import measure_fit


def measure(seconds: float) -> dict:
    """Seconds of the fit, and of one step beside PyTorch's."""
    return measure_fit("roll", seconds)
