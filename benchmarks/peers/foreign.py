"""Peers that live in an interpreter of their own, because their pins or their weight keep them out of this one.

    worker fit data.npz model seconds        worker run model inputs.npz output.npz

The interpreter is this one, or the one named by an environment variable (PEERS_JAX_SYSID_PYTHON,
PEERS_DEEPSI_PYTHON). A worker is a script that imports nothing from here: arrays in, arrays out.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from . import Skipped
from .grid import batch, make_grid


def interpreter(package: str, variable: str, advice: str) -> str:
    """An interpreter that imports the package, or `Skipped` with the reason."""
    python = os.environ.get(variable, sys.executable)
    found = subprocess.run([python, "-c", f"import {package}"], capture_output=True, text=True, check=False)
    if found.returncode:
        raise Skipped(f"{found.stderr.strip().splitlines()[-1]}; {advice}")
    return python


def fit(worker: str, python: str, nominal, records, seconds: float):
    """Fit in the worker on the coarse grid; the predictor asks it for one free run a record."""
    grid = make_grid(nominal, records)
    inputs, targets, weights = batch(grid, records)
    kept = tempfile.TemporaryDirectory()
    folder = Path(kept.name)

    def call(*words):
        """Run the worker; what it prints goes to stderr, what it leaves at home to the temporary folder."""
        command = [python, str(Path(__file__).with_name(worker)), *map(str, words)]
        subprocess.run(command, check=True, stdout=sys.stderr, cwd=folder, env={**os.environ, "HOME": kept.name})

    np.savez(folder / "data.npz", inputs=inputs, targets=targets, weights=weights)
    call("fit", "data.npz", "model", seconds)

    def predict(record, folder=folder, kept=kept):  # kept: the folder lives as long as the predictor
        np.savez(folder / "inputs.npz", inputs=grid.inputs(record))
        call("run", "model", "inputs.npz", "output.npz")
        return grid.restore(record, np.load(folder / "output.npz")["x"])

    return predict
