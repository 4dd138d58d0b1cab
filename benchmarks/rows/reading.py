"""Reading: a million rows of three columns beside `pandas.read_csv` alone, and `pitp check` of a hundred files.

The bar: at most 2 s a million rows in a warm process and 400 MB beyond its start; at most 40 s for the hundred files of
20,000 rows. The peer only parses: no dialect, units, clock, spikes or grid.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import scipy

import pitp_jax as pitp

from ..clock import peak_mb, row, take_turns
from ..sizes import size

_ROWS, _FILES, _EACH = size((10**6, 100, 20_000), (2000, 3, 2000))


_OMEGA = 2 * np.pi * 12.0  # rad/s, of an actuator with damping 0.1


def written(path: Path, rows: int, seed: int) -> Path:
    """An actuator driven by a sine at 1 kHz, with noise of the laser; in blocks, which take no memory."""
    rng = np.random.default_rng(seed)
    b, a = scipy.signal.bilinear([2e-7 * _OMEGA**2], [1.0, 0.2 * _OMEGA, _OMEGA**2], 1000.0)
    state = np.zeros(2)
    for first in range(0, rows, _EACH):
        t = np.arange(first, min(first + _EACH, rows)) / 1000
        u = 1500 * (1 - np.cos(2 * np.pi * (1 + 0.5 * (seed % 20)) * t))
        y, state = scipy.signal.lfilter(b, a, u**2, zi=state)
        y = y + 1e-3 * rng.standard_normal(len(t))
        block = pd.DataFrame({"Time (s)": t, "Voltage (V)": u, "Laser (mm)": y})
        block.to_csv(path, mode="a", header=first == 0, index=False, float_format="%.7g")
    return path


def measure(seconds: float) -> dict:
    """`beyond_mb` is before pandas has read the file; `check_s` is all that the command does but its start."""
    from pitp_jax.application.check.check import check

    with tempfile.TemporaryDirectory() as folder:
        pitp.read(written(Path(folder) / "warm.csv", _EACH, 0))  # what is imported on the first call
        path, start = written(Path(folder) / "long.csv", _ROWS, 1), peak_mb()
        (record,) = pitp.read(path)
        assert record.samples == _ROWS
        beyond = peak_mb() - start
        timed = take_turns(
            {"pitp.read": lambda: pitp.read(path), "pandas.read_csv": lambda: pd.read_csv(path)}, seconds
        )
        many = Path(folder) / "many"
        many.mkdir()
        for k in range(_FILES):
            written(many / f"r{k:03d}.csv", _EACH, k)
        began, cpu = time.perf_counter(), time.process_time()
        assert len(check(pitp.read(many)).records) == _FILES
        wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    more = {"rows": _ROWS, "beyond_mb": beyond, "files": _FILES, "check_s": wall, "check_cpu_s": cpu}
    return row(timed, "pitp.read", "pandas.read_csv", None, **more)
