"""Rows: one operation each, beside a peer that does the same in the same run.

    measure(seconds) -> dict of one row: median_ms, p10_ms, p90_ms, compile_s, peer, peer_median_ms, ratio, ...

A row is one file here and one line below. `seconds`: about how long the turns may take in all.
"""

from importlib import import_module

ROWS = {
    "inverse_default": "inverse_default",
    "inverse_paper": "inverse_paper",
    "rollout_batch": "rollout_batch",
    "rollout_many": "rollout_many",
    "free_runs": "free_runs",
    "stream": "stream",
    "realtime": "realtime",
    "devices": "devices",
    "growth": "growth",
    "ensemble": "ensemble",
    "identify": "identify",
    "identify_search": "identify_search",
    "fit_cone": "fit_cone",
    "fit_roll": "fit_roll",
    "diagnose": "diagnose",
    "diagnose_unknown": "diagnose_unknown",
    "import": "import_time",
    "reading": "reading",
}


def measure(name: str, seconds: float) -> dict:
    """The row of that name."""
    return import_module(f"{__name__}.{ROWS[name]}").measure(seconds)
