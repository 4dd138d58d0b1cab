"""One row in a process of its own: `python -m benchmarks.rows NAME SECONDS` prints it as one line of JSON.

Alone in its process a row has the first-call time and the peak memory of its own work.
"""

import json
import sys
import time
import traceback

from ..clock import Skipped, peak_mb

BEGAN = time.perf_counter()


def main(name: str, seconds: float) -> dict:
    """The row with its peak memory, or why there is none."""
    from . import measure

    try:
        found = measure(name, seconds)
    except Skipped as reason:
        return {"skipped": str(reason)}
    except Exception as error:
        traceback.print_exc()
        return {"skipped": f"failed: {type(error).__name__}: {error}"[:300]}
    from ..machine import facts

    found.setdefault("peak_mb", peak_mb())
    found["whole_s"] = round(time.perf_counter() - BEGAN, 1)
    return found | {"machine": facts()}


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], float(sys.argv[2]))))
