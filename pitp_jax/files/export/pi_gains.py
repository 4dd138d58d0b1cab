"""Tune a PI controller that acts on the force, from the model and a closed-loop time constant (IMC).

    F = F_ff + P e + I int e dt,   I = a_0 / lambda,   P = (a_1 / a_0) I
    e = expected - measured (model coordinates), averaged:  e += k (now - e),  k = dt / (dt + lambda / 5),  less 4 s_e
    loop and margins: `method.invert.loop`, with G = dx/dF of the sampled decoder with its effects, the input held

The controller's zero cancels a_0 + a_1 s, so that below the resonance L = 1 / (lambda s). At the resonance |L| is
1 / (2 zeta lambda w_0). s_e = s sqrt(k / (2 - k)) is the noise s of the sensor in the average; without noise k is 1.
`expected` is the model's own displacement under the feedforward, so an unchanged actuator is not corrected. Acting on
the force, u = map^-1(F), keeps L the same at every voltage. G is linearised about equilibria of the trained stroke
(`equilibria`), a_0 is the least stiffness among them.

Rivera, Morari and Skogestad (1986), Internal model control: PID controller design.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from ...common.errors import BadInput
from ...common.numbers import rounded_up
from ...method.effects.kernels import total_delay
from ...method.invert import steps
from ...method.invert.loop import Plant, linearised, margins
from ...method.model.coordinate import from_model, sign
from ...method.model.fitted import Fitted, model_of
from ...method.model.model import Model
from ...method.model.programs import in_double
from .equilibria import equilibria

SENSITIVE = 2.0  # a gain margin of 2 and a phase margin of 29 degrees at least (Astrom and Hagglund)
_FINER = 1.05  # ratio of two time constants of a search
_ALONE = "; --time-constant inf exports the feedforward without a controller"


@dataclass(frozen=True)
class PIGains:
    """The gains of a PI controller that acts on the force, with the robustness of the closed loop.

    Attributes:
        p: V^2 / m (V / m for a linear input), in the model's direction.
        i: V^2 / (m s).
        time_constant: of the closed loop, s; also that of the back-calculation.
        gain_margin: by how much the plant's gain may grow.
        max_sensitivity: largest |1 / (1 + L)|.
        smoothing: the part of its difference from the error that the average moves in a sample; 1: no average.
        tolerance: averaged noise of the sensor that is not corrected, m.
    """

    p: float
    i: float
    time_constant: float
    gain_margin: float
    max_sensitivity: float
    smoothing: float = 1.0
    tolerance: float = 0.0


def pi_gains(model: Model | Fitted, dt: float | None = None, time_constant: float | None = None) -> PIGains:
    """Compute the gains of a PI controller that acts on the force (V^2/m or V/m), from a model.

    Args:
        model: identified or trained, with any effects.
        dt: s between two samples of the controller; None: the model's own.
        time_constant: of the closed loop, s; None: the shortest one with a maximum sensitivity of at most 1.7, of at
            least 10 samples, and slow enough for the slew limit and the sensor's noise; inf: no controller, P = I = 0.

    Returns:
        the gains, the gain margin and the maximum sensitivity.

    Raises:
        BadInput: the maximum sensitivity is above 2 at this time constant, or no margin can be computed: no voltage of
            the model's range holds the actuator, or the model has no derivatives there.

    Examples:
        >>> gains = pitp.pi_gains(model)
        >>> gains.max_sensitivity < 2 < gains.gain_margin
        True
    """
    model = model_of(model)
    for name, given in (("dt", dt), ("--time-constant", time_constant)):
        if given is not None and not given > 0:
            raise BadInput(f"{name} {given} is not a positive number of seconds")
    dt = dt or model.dt
    if time_constant == np.inf:
        return PIGains(0.0, 0.0, np.inf, np.inf, 1.0)
    tuned, slowest = tuning(model, dt), _slowest(model.physical_coefficients)
    if time_constant is None:
        # below the limit, because a model is not the actuator
        return _shortest(tuned, slowest, dt, 1.7, model)
    gains = tuned(time_constant)
    if gains.max_sensitivity > SENSITIVE:
        enough = _shortest(tuned, max(slowest, time_constant), dt, SENSITIVE)
        raise BadInput(
            f"--time-constant {time_constant:g} s: the maximum sensitivity would be {gains.max_sensitivity:.3g}, "
            f"above {SENSITIVE:g} (gain margin {gains.gain_margin:.3g}); give at least "
            f"{rounded_up(enough.time_constant):g} s"
        )
    return gains


def tuning(model: Model, dt: float) -> Callable[[float], PIGains]:
    """Return a function that computes the gains and margins for a closed-loop time constant (s).

    Raises:
        BadInput: no margin can be computed.
    """
    a = model.physical_coefficients
    with jax.enable_x64(True):
        plants, stiffness = operating_points(in_double(model), dt)
    a0, noise = min(a[0], *stiffness), float(model.domain.noise)

    def tuned(seconds: float) -> PIGains:
        i = float(a0 / seconds)
        p = float(a[1] / a[0] * i)
        k = dt / (dt + 0.2 * seconds) if noise else 1.0
        tolerance = 4.0 * noise * float(np.sqrt(k / (2 - k)))
        return PIGains(p, i, float(seconds), *margins(plants, p, i, dt, k), k, tolerance)

    return tuned


def _slowest(a: np.ndarray) -> float:
    """Return 2 / (zeta w_0) of the slowest resonance (s); without a resonance, 2 / |p| of the slowest pole p."""
    poles = np.roots(a[::-1])
    # a pair closer to the real axis hardly oscillates
    pairs = poles[np.abs(poles.imag) > 0.1 * np.abs(poles)]
    return float(2 / np.abs((pairs if len(pairs) else poles).real).min())


def slew_of(model: Model) -> float:
    """Return the largest slew of the voltage: of the training records, or of a slew limit in the model, V/s."""
    inverses = [float(e.inverse) for e in model.effects if e.name == "slew_limit"]
    return min([float(model.domain.slew), *(1 / v for v in inverses if v > 0)])


def _is_calm(model: Model, gains: PIGains, dt: float) -> bool:
    """Return whether the loop leaves room for the sample time, and asks no more of the slew than the limit gives."""
    low, high = model.domain.voltage_range
    slew, top = slew_of(model), max(abs(low), abs(high))
    if gains.time_constant < 10 * dt:
        return False
    if not np.isfinite(slew) or not np.isfinite(top):
        return True
    # the slew limit allows a correction of a tenth of the range within the time constant
    seconds = 0.1 * (high - low) / slew
    jump = np.sqrt(2) * gains.p * gains.smoothing * float(model.domain.noise)  # of the force in a sample, rms
    jump = jump / top if model.input_map.one_sided else jump
    # the noise may move the voltage by a third of the largest step of a sample
    return bool(gains.time_constant >= seconds and jump <= slew * dt / 3)


def _shortest(tuned, first: float, dt: float, sensitivity: float, calm: Model | None = None) -> PIGains:
    """Find the shortest closed-loop time constant within a maximum sensitivity, starting at `first` (s).

    `calm`: a model whose sample time, noise and slew limit it respects as well.

    Raises:
        BadInput: none exists.
    """

    def is_allowed(gains: PIGains) -> bool:
        return gains.max_sensitivity <= sensitivity and (calm is None or _is_calm(calm, gains, dt))

    gains = tuned(first)
    while not is_allowed(gains):
        if gains.time_constant > 1e3 * first:
            raise BadInput(
                f"no PI controller: no time constant up to {1e3 * first:.2g} s keeps the maximum sensitivity "
                f"below {sensitivity:g}{_ALONE}"
            )
        gains = tuned(_FINER * gains.time_constant)
    while gains.time_constant > dt:
        shorter = tuned(gains.time_constant / _FINER)
        if not is_allowed(shorter):
            break
        gains = shorter
    return gains


def operating_points(model: Model, dt: float) -> tuple[list[Plant], list[float]]:
    """Linearise the model about the equilibria of its stroke; return each with its stiffness dF/dx.

    Raises:
        BadInput: no equilibrium exists, or the model has no derivatives at one.
    """
    late = total_delay(model.effects)
    # held by dry friction or within its play a machine does not respond: the loop is tuned for the one that slides
    still = [e.delays or e.spec.resolved or e.name == "backlash" for e in model.effects]
    model = replace(model, effects=tuple(e for e, s in zip(model.effects, still, strict=True) if not s))
    forward = steps.predict(model, dt, held=True)
    square, way = model.input_map.one_sided, float(sign(model))
    points, stiffness = [], []
    for point in equilibria(model):
        # after a snap no voltage holds it still: the loop is not tuned about it
        if point.stiffness > 0:
            u = point.voltage
            state = forward.start(jnp.asarray(from_model(model, point.displacement)), jnp.asarray(u))
            points.append((state, u, way / (2 * u) if square else way))  # dx/dF = dx/du du/dF, F = u^2
            stiffness.append(point.stiffness)
    if not points:
        raise BadInput(
            f"no PI controller: no voltage in the model's range holds a displacement within its stroke{_ALONE}"
        )

    def run(state, voltage):
        after, out = forward.run(state, voltage[None])
        return after, out[0]

    return linearised(run, points, dt, model.natural_frequency, late), stiffness
