"""What is timed: models as the two presets build them, with random weights, and motions for them.

A model's time depends on its shape, not on what it learned. Order 2 at 5 Hz, 1 kHz; default: width 8, five memories,
electrode; paper: n + 1 networks 128 wide, elapsed time.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pitp_jax import Model
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import CompactEncoder, PaperEncoder
from pitp_jax.method.model.input_map import SquareInput
from pitp_jax.method.model.memory import ElapsedTime, FadingMemory
from pitp_jax.method.model.model import Output, linear_model

from .sizes import size

DT = 1e-3
SAMPLES = size(120_000, 4000)
_HZ, _STIFFNESS, _TRAVEL = 5.0, 1e9, 1e-3


def nominal(order: int = 2) -> Model:
    """A resonance at 5 Hz, damping 0.1, further pairs at 15 Hz and so on; the odd real pole at 2.5 Hz."""
    omega, poly = 2 * np.pi * _HZ, np.ones(1)
    for k in range(order // 2):
        w = omega * 3.0**k
        poly = np.convolve(poly, [1.0, 0.2 / w, 1 / w**2])
    if order % 2:
        poly = np.convolve(poly, [1.0, 2 / omega])
    return linear_model(
        _STIFFNESS * poly, input_map=SquareInput(), state_scale=_TRAVEL * omega ** np.arange(order + 1),
        force_scale=1e6, output=Output(), hold="foh", substeps=1, domain=Domain(DT),
    )  # fmt: skip


def _stirred(encoder, size: float):
    rng = np.random.default_rng(0)

    def move(a):
        return a + jnp.asarray(size * rng.standard_normal(a.shape) / np.sqrt(a.shape[-1]), a.dtype) if a.size else a

    return jax.tree.map(lambda a: move(a) if eqx.is_inexact_array(a) else a, encoder)


def default(order: int = 2, width: int = 8, memories: int = 5, lag: float = 3e-3) -> Model:
    """As the default preset trains it; features bounded at five times the travel."""
    bounds = np.array([[-5.0], [5.0]]) * np.ones(order + memories)
    fresh = CompactEncoder(order, memories, width=width, bounds=bounds, key=jax.random.key(0))
    encoder = eqx.tree_at(lambda e: e.bounds, _stirred(fresh, 0.05), fresh.bounds)
    memory = FadingMemory(jnp.log(jnp.geomspace(0.06, 120.0, memories)).astype(jnp.float32))
    drive = ElectrodeLag(jnp.asarray(np.log(lag), jnp.float32))
    return eqx.tree_at(lambda m: (m.encoder, m.memory, m.drive), nominal(order), (encoder, memory, drive))


def paper(order: int = 2) -> Model:
    """As the paper preset trains it."""
    encoder = _stirred(PaperEncoder(order + 1, order + 1, key=jax.random.key(0)), 0.05)
    memory = ElapsedTime(SAMPLES * DT)
    return eqx.tree_at(lambda m: (m.encoder, m.memory), nominal(order), (encoder, memory))


def target(samples: int = SAMPLES) -> np.ndarray:
    """Displacement from rest, m: two sines that beat, within the travel."""
    t = np.arange(samples) * DT
    return _TRAVEL * (0.35 * (1 - np.cos(2 * np.pi * t)) + 0.3 * np.sin(0.37 * np.pi * t) ** 4)


def voltages(records: int, samples: int) -> np.ndarray:
    """Drive voltages from rest, V, float32, shape (records, samples): 1 to 4 Hz, within the travel."""
    t = np.arange(samples) * DT
    hz = np.linspace(1.0, 4.0, records)[:, None]
    return (600 * np.sin(np.pi * hz * t) ** 2).astype(np.float32)
