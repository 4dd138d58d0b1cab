"""What `import pitp_jax` takes beyond `import jax, equinox`, in fresh processes; and with every verb loaded."""

import subprocess
import sys
import time

from ..clock import row, summary
from ..sizes import size

_TURNS = size(7, 1)
_BASE = "import jax, equinox"
_OURS = f"{_BASE}; import pitp_jax"
_VERBS = f"{_OURS}; [getattr(pitp_jax, name) for name in pitp_jax.__all__]"


def seconds_of(line: str) -> float:
    """One fresh interpreter."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", line], check=True)
    return time.perf_counter() - began


def measure(seconds: float) -> dict:
    """`extra_ms` is what the bar is about."""
    lines = {"pitp_jax": _OURS, "jax and equinox": _BASE, "every verb": _VERBS}
    first = {name: seconds_of(line) for name, line in lines.items()}
    times: dict[str, list[float]] = {name: [] for name in lines}
    for _ in range(_TURNS):
        for name, line in lines.items():
            times[name].append(seconds_of(line))
    found = {name: summary(taken, first[name]) for name, taken in times.items()}
    extra = {
        name: found[name]["median_ms"] - found["jax and equinox"]["median_ms"] for name in ("pitp_jax", "every verb")
    }
    return row(
        found, "pitp_jax", "jax and equinox", extra_ms=extra["pitp_jax"], every_verb_extra_ms=extra["every verb"]
    )
