"""Displacement in, drive voltage out: derivatives, memories, network, inverse, electrode; 120,000 samples.

Default preset. The peer is what one would assemble: SciPy's spline for the derivatives, one `lfilter` per memory, the
network in PyTorch compiled, NumPy for the rest.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter

import pitp_jax as pitp
from pitp_jax._invert.equation import invert_displacement, invert_path
from pitp_jax._numerics.spline_derivative import derivatives

from ..clock import row, take_turns
from ..subjects import DT, SAMPLES, default, target


def plain(model, x):
    """The package's plain path."""
    return invert_path(model, jnp.asarray(derivatives(x, DT, 2) / np.asarray(model.scales.state), jnp.float32), DT)[1]


def assembled(model, x):
    """Fn() for the peer, or none, and why."""
    try:
        import torch

        from ..torch_model import Inverse
    except ImportError as error:
        return None, f"{error.name} is not installed"
    network, tau = torch.compile(Inverse(model).eval(), dynamic=False), np.exp(np.asarray(model.memory.log_tau, float))
    lag = float(np.exp(model.drive.log_tau))

    def run():
        rows = (derivatives(x, DT, 2) / np.asarray(model.scales.state)).astype(np.float32).T
        past = []
        for t in tau:
            q, settle = np.exp(-DT / t), -np.expm1(-DT / t)
            slope = 1 - settle * t / DT
            past.append(lfilter([slope, settle - slope], [1.0, -q], rows[0]))
        seen = np.concatenate([rows[:-1], np.stack(past).astype(np.float32)])
        with torch.inference_mode():
            film = network(torch.from_numpy(seen), torch.from_numpy(np.ascontiguousarray(rows))).numpy()
        return film + lag * np.gradient(film, DT)

    return run, ""


def from_file(model, x) -> float:
    """Seconds from a displacement file to the voltage, once."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "target.npz"
        np.savez(file, time_s=np.arange(SAMPLES) * DT, displacement_m=x)
        began = time.perf_counter()
        np.asarray(invert_displacement(model, pitp.read_target(file).displacement, DT))
        return time.perf_counter() - began


def measure(seconds: float) -> dict:
    """Ours, the package's plain path and the peer."""
    model, x = default(), target()
    ways = {"pitp_jax": lambda: invert_displacement(model, x, DT), "pitp_jax, spline and vmap": lambda: plain(model, x)}
    run, why = assembled(model, x)
    peer = "SciPy spline and filters, PyTorch compiled"
    if run is not None:
        ways[peer] = run
    found = take_turns(ways, seconds)
    if run is not None:  # the same voltages, but for the root's corners at F = 0
        truth, other = np.asarray(ways["pitp_jax"]()), run()
        assert (np.abs(other - truth) > 5e-3 * truth.max()).mean() < 0.01
    taken = 1e3 * float(np.median([from_file(model, x) for _ in range(5)]))
    return row(found, "pitp_jax", peer if run else None, samples=SAMPLES, with_file_ms=taken, peer_skipped=why)
