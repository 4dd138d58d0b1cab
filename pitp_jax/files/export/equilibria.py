"""Find equilibria within the trained stroke: displacements that an allowed voltage can hold.

    N(x) = force that holds the actuator at x (memories and effects settled),   map(film(u)) = N(x),   low <= u <= high

Both equations are solved by bracketing (Brent 1973), so that a solution lies within the range or there is none.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root_scalar

from ...method.model.model import Model
from ...method.model.programs import full_precision
from ...method.simulate import ports

_SCANNED = 65  # displacements of one section


@dataclass(frozen=True)
class Equilibrium:
    """An equilibrium: displacement (m, model coordinates), voltage (V), and stiffness dF/dx (V^2/m or V/m)."""

    displacement: float
    voltage: float
    stiffness: float


def stroke(model: Model) -> float:
    """Return the largest trained displacement (m); for an untrained model the static one at its largest voltage."""
    return max(map(abs, _ends(model)))


def _ends(model: Model) -> tuple[float, float]:
    """Return the lowest and the highest displacement of the training records, m."""
    if len(model.domain.region):
        low, high = np.array(model.domain.region[0]) * model.scales.state[0]
        return float(min(low, 0.0)), float(max(high, 0.0))
    widest = [float(model.input_map.force(np.asarray(v))) for v in model.domain.voltage_range if np.isfinite(v)]
    force = max(map(abs, widest), default=float(model.scales.force)) or float(model.scales.force)
    high = force / float(model.physical_coefficients[0])
    return 0.0 if model.input_map.one_sided else -high, high


def equilibria(model: Model) -> list[Equilibrium]:
    """Find the equilibria at several fractions of the stroke.

    Args:
        model: in float64, without delays.

    Returns:
        Those that exist, at most five on each side of rest.
    """

    @jax.jit
    @full_precision
    @jax.vmap
    def held(x):
        return jax.jvp(lambda y: holding_force(model, y), (x,), (jnp.ones_like(x),))

    def holding(x):
        # always the same number of displacements, so that one program is compiled
        return tuple(np.asarray(v)[: len(x)] for v in held(jnp.asarray(np.resize(x, _SCANNED))))

    low, high = _voltages(model)
    least, most = (_force(model, u) for u in (low, high))
    points = []
    for end in _ends(model):
        if end == 0 or (end < 0 and model.input_map.one_sided):
            continue
        # fractions of the stroke that voltages can hold
        x = np.multiply((0.1, 0.25, 0.5, 0.75, 1.0), _reached(holding, end, most if end > 0 else least))
        for place, force, stiffness in zip(x, *holding(x), strict=True):
            u = _bracketed(model, float(force), low, high)
            if u is not None and (u > 0 or not model.input_map.one_sided):
                points.append(Equilibrium(float(place), u, float(stiffness)))
    return points


def holding_force(model: Model, x):
    """Compute the force in input units (V^2 or V) that holds the actuator at x (m, model coordinates)."""
    scaled = x / model.scales.state[0]
    row = jnp.zeros(model.order + 1).at[0].set(scaled)
    states = ports.split(model, ports.initial(model, scaled, jnp.zeros(()), 0.0))
    seen = jnp.concatenate([row[:-1], model.memory.initial(scaled)])
    return ports.needed(model, states, row, seen) * model.scales.force


def _reached(holding, end: float, limit: float) -> float:
    """Return the displacement up to `end` (m) that a force below `limit` can hold."""
    low, high = 0.0, end
    for _ in range(6):  # the last section is 1e-11 of the stroke wide
        x = np.linspace(low, high, _SCANNED)
        beyond = np.flatnonzero(np.sign(end) * (holding(x)[0] - limit) > 0)
        if not len(beyond) or beyond[0] == 0:
            break
        low, high = x[beyond[0] - 1], x[beyond[0]]
    return float(high if low == 0 else low)


def _voltages(model: Model) -> tuple[float, float]:
    """Return the voltage range of the model (V); if it has none, a range that reaches twice its unit of force."""
    low, high = map(float, model.domain.voltage_range)
    if model.input_map.one_sided:
        low, high = 0.0, max(high, -low)
    if np.isfinite(high) and np.isfinite(low) and high > low:
        return low, high
    force = 2 * float(model.scales.force)
    top = force**0.5 if model.input_map.one_sided else force
    for _ in range(100):
        if _force(model, top) >= force:
            break
        top *= 2
    return 0.0 if model.input_map.one_sided else -top, top


def _force(model: Model, u: float) -> float:
    """Compute the drive term (V^2 or V) after a long time at the constant voltage u."""
    film = jnp.asarray(u)
    for effect in ports.drives(model):
        film = effect.apply(film, effect.start(film))
    return float(model.input_map.force(film))


def _bracketed(model: Model, force: float, low: float, high: float) -> float | None:
    """Return the voltage within the range that gives a drive term (V^2 or V); None if there is none."""

    def missing(u):
        return _force(model, u) - force

    ends = missing(low), missing(high)
    if not np.isfinite([force, *ends]).all():
        return None
    slack = 1e-9 * abs(force)  # the end of the stroke was found at the end of the range
    if abs(ends[1]) <= slack:
        return high
    if ends[0] * ends[1] > 0:
        return None
    return float(root_scalar(missing, bracket=(low, high), xtol=1e-12 * (high - low), rtol=1e-14).root)
