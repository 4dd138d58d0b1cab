"""Describe the motion that a target asks of a model, in model coordinates, from rest or a held voltage.

x = sensor^-1(target),    s_0 = rest at 0 V, or settled at the voltage that holds the actuator
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.coordinate import Zero, to_model
from ..model.dominant import nonzero_poles
from ..model.drive import ElectrodeLag
from ..model.memory import FadingMemory, RingingMemory
from ..model.model import Model
from ..signal.target import Target
from ..simulate.batched_rollout import fast_rollout
from ..simulate.decoder import rest_state, still_state
from ..simulate.prediction import at_rate

_RINGS = 0.7  # damping below which a pole oscillates
_IN, _OUT, _SMOOTH = 5.0, 3.0, 0.5  # periods: lead-in and lead-out with oscillation, both without


@dataclass(frozen=True)
class Motion:
    """A wanted motion of one model, sampled on one clock.

    Attributes:
        model: with the substeps that this clock needs.
        displacement: model coordinates, m, shape (T,).
        target: the samples of the target itself.
        wanted: the target with the rounding of its file, m.
        begins: time of the first sample on the target's clock, s.
        dt: sampling interval, s.
        settling: durations of lead-in and lead-out by the slowest mode, s.
        held: scaled state at the first sample; None at rest at 0 V.
        stands: displacement in that state, m.
        slew_kept: the nominal force of the lead-in stays within the slew limit.
        reached: the lead-in ends in the target's first state: x^(i) within 2 % of omega_0^i times the target's size.
    """

    model: Model
    displacement: np.ndarray
    target: slice
    wanted: np.ndarray
    begins: float
    dt: float
    settling: tuple[float, float]
    held: Float[Array, " state"] | None = None
    stands: float = 0.0
    slew_kept: bool = True
    reached: bool = True

    @property
    def age(self) -> float:
        """Return the time since the session started at the first sample, s; the actuator was at rest before."""
        return max(self.model.domain.age(self.begins), 0.0)

    @property
    def start(self) -> Float[Array, " state"]:
        """Return the scaled state at the first sample."""
        return rest_state(self.model, self.age) if self.held is None else self.held


def wanted_motion(
    model: Model, target: Target, smooth: Target, zero: Zero = "rest", start_input: float = 0.0
) -> Motion:
    """Convert a target to the motion that the model must perform.

    Args:
        model: any.
        target: in its base unit, on the clock of the plan.
        smooth: the same without the rounding of its file.
        zero: where the target is 0.
        start_input: V at the first sample.
    """
    model = at_rate(model, target.dt)
    wanted, displacement = (np.asarray(to_model(model, t.displacement, zero), float) for t in (target, smooth))
    times = settling(model)
    held, stands = None, 0.0
    if start_input:
        held, stands = standing(model, start_input, target.dt, times[0])
    own = slice(0, len(wanted))
    return Motion(model, displacement, own, wanted, float(target.time[0]), target.dt, times, held, stands)


def settling(model: Model) -> tuple[float, float]:
    """Return the durations of lead-in and lead-out, s, from the slowest mode.

    A mode that oscillates needs 5 and 3 periods, any other half a period (3 time constants). A memory counts as at most
    5 periods of the slowest pole, because slow creep excites no oscillation.
    """
    poles = nonzero_poles(model.physical_coefficients)
    memory, electrode = model.memory, model.drive
    lags = np.exp(np.asarray(memory.log_tau, float)) if isinstance(memory, (FadingMemory, RingingMemory)) else []
    beside: list[complex] = [-1 / float(tau) for tau in lags]
    if isinstance(memory, RingingMemory):
        omega, zeta = map(float, memory.ring)
        beside.append(omega * complex(-zeta, np.sqrt(1 - zeta**2)))
    if isinstance(electrode, ElectrodeLag):
        beside.append(-float(np.exp(-electrode.log_tau)))

    def longest(modes, periods: float) -> float:
        size = np.abs(modes)
        rings = -np.real(modes) < _RINGS * size
        return float((np.where(rings, periods, _SMOOTH) * 2 * np.pi / size).max(initial=0.0))

    most = _IN * longest(poles, 1.0)
    lead_in, lead_out = (max(longest(poles, n), min(longest(beside, n), most)) for n in (_IN, _OUT))
    return lead_in, lead_out


def standing(model: Model, voltage: float, dt: float, seconds: float) -> tuple[Float[Array, " state"], float]:
    """Return the scaled state and the displacement (m) after so many seconds at a constant voltage."""
    kind = model.coefficients.dtype
    level = float(model.input_map.force(np.asarray(voltage))) / float(model.physical_coefficients[0])
    level /= float(model.scales.state[0])
    # start at the nominal's own level; encoder and effects change it, so the model runs until it stands still
    begun = still_state(model, jnp.asarray(level, kind), jnp.asarray(voltage, kind), 0.0)
    count = int(np.clip(seconds / dt, 64, 100_000))  # samples; a longer wait is not simulated
    state = fast_rollout(model, jnp.full((1, count), voltage, kind), dt, begun[None])[0, -1]
    return state, float(state[0]) * float(model.scales.state[0])
