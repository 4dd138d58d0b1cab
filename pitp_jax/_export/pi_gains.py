"""Tune a PI controller on the force, from the model and one number, the closed-loop time constant (IMC).

    F = F_ff + P e + I int e dt,   I = a_0 / lambda,   P = (a_1 / a_0) I,   e = wanted - measured (model coordinates)
    L(z) = (P + I dt z / (z - 1)) z^-1 G(z),   G = dx/dF of the sampled decoder with its effects
    maximum sensitivity M = max |1 / (1 + L)|,   gain margin = min 1 / |L| where L < 0

The controller's zero cancels a_0 + a_1 s, so that below the resonance L = 1 / (lambda s). At the resonance |L| is
1 / (2 zeta lambda w_0): with the default lambda = 2 / (zeta w_0) a quarter. Acting on the force, u = map^-1(F), keeps L
the same at every voltage. G is linearised about three displacements, a_0 is the least stiffness among them.

Rivera, Morari and Skogestad (1986), Internal model control: PID controller design.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from .._effects.kernels import total_delay
from .._errors import BadInput
from .._model.coordinate import from_model, sign
from .._model.fitted import Fitted, model_of
from .._model.model import Model
from .._model.programs import in_double
from . import steps

SENSITIVE = 2.0  # a gain margin of 2 and a phase margin of 29 degrees at least (Astrom and Hagglund)
_CHOSEN = 1.7  # what the default time constant keeps to, below the limit: a model is not the actuator
_LEVELS = (0.25, 0.6, 1.0)  # of the stroke
_PEAK = np.concatenate([-np.geomspace(0.2, 1e-3, 40), [0.0], np.geomspace(1e-3, 0.2, 40)])


@dataclass(frozen=True)
class PIGains:
    """A PI controller on the force, and how robust its loop is.

    Attributes:
        p: V^2 / m (V / m where the input is linear), in the model's direction.
        i: V^2 / (m s).
        time_constant: of the closed loop, s; also that of the back-calculation.
        gain_margin: by how much the plant's gain may grow.
        max_sensitivity: largest |1 / (1 + L)|; nan where the model has no linearisation.
    """

    p: float
    i: float
    time_constant: float
    gain_margin: float
    max_sensitivity: float


def pi_gains(model: Model | Fitted, dt: float | None = None, time_constant: float | None = None) -> PIGains:
    """Tune a PI controller on the force from a model.

    Args:
        model: identified or trained, with any effects.
        dt: s between two samples of the controller; None: the model's own.
        time_constant: of the closed loop, s; None: 2 / (zeta w_0) of the slowest resonance (2 time constants where the
            model has none), doubled while the maximum sensitivity is above 1.7.

    Returns:
        the gains, the gain margin and the maximum sensitivity.

    Raises:
        BadInput: the maximum sensitivity is above 2 at this time constant.

    Examples:
        >>> gains = pitp.pi_gains(model)
        >>> gains.max_sensitivity < 2 < gains.gain_margin
        True
    """
    model = model_of(model)
    dt = model.dt if dt is None else dt
    a = model.physical_coefficients
    poles = np.roots(a[::-1])
    pairs = poles[np.abs(poles.imag) > 0.1 * np.abs(poles)]
    slowest = 2 / np.abs((pairs if len(pairs) else poles).real).min()
    with jax.enable_x64(True):
        loops, stiffness = _linearised(in_double(model), dt)
    a0 = min([a[0], *stiffness])
    tuned = partial(_tuned, a0, a[1] / a[0], loops, dt)
    if time_constant is None:
        gains = tuned(slowest)
        for _ in range(8):
            if not gains.max_sensitivity > _CHOSEN:
                return gains
            gains = tuned(2 * gains.time_constant)
        return gains
    gains = tuned(time_constant)
    if gains.max_sensitivity > SENSITIVE:
        enough = time_constant
        while tuned(enough).max_sensitivity > SENSITIVE and enough < 1e3 * slowest:
            enough *= 1.1
        raise BadInput(
            f"--time-constant {time_constant:g} s: the maximum sensitivity would be {gains.max_sensitivity:.3g}, above "
            f"{SENSITIVE:g} (gain margin {gains.gain_margin:.3g}); {enough:.2g} s keeps it"
        )
    return gains


def _tuned(a0: float, zero: float, loops: list, dt: float, time_constant: float) -> PIGains:
    i = float(a0 / time_constant)
    p = float(zero * i)
    margin, sensitivity = np.inf, 1.0 if loops else np.nan
    for frequency, response in loops:
        z = np.exp(1j * frequency * dt)
        L = (p + i * dt * z / (z - 1)) * response / z
        # between two frequencies L crosses the real axis: by the line between them
        rise = np.sign(L.imag)
        at = np.flatnonzero((rise[1:] * rise[:-1] <= 0) & (rise[1:] != rise[:-1]))
        part = L.imag[at] / (L.imag[at] - L.imag[at + 1])
        crossing = L.real[at] + part * (L.real[at + 1] - L.real[at])
        margin = min(margin, *(1 / -c for c in crossing if c < 0), np.inf)
        # the plant alone is stable: the loop is, as long as no crossing has passed -1
        sensitivity = max(sensitivity, float(np.abs(1 / (1 + L)).max()) if margin > 1 else np.inf)
    return PIGains(p, i, float(time_constant), float(margin), float(sensitivity))


def _linearised(model: Model, dt: float) -> tuple[list, list[float]]:
    """Linearise: (rad/s, G) about each displacement that a voltage holds, and dF/dx between them."""
    late = total_delay(model.effects)
    model = replace(model, effects=tuple(e for e in model.effects if not e.delays))
    forward, back = steps.predict(model, dt, held=True), jax.jit(partial(_holding, steps.inverse(model, dt)))
    square, way = model.input_map.one_sided, float(sign(model))
    reach = stroke(model)
    loops, stiffness = [], []
    for level in _LEVELS:
        y, step = from_model(model, level * reach), 1e-3 * reach * way
        u, above = float(back(y)), float(back(y + step))
        forces = model.input_map.force(np.array([u, above]))
        slope = float(np.diff(forces)[0]) / (1e-3 * reach)
        # past a snap the held equilibrium is not stable (slope <= 0): no loop is tuned about it
        if not (np.isfinite(u) and np.isfinite(slope) and slope > 0 and (u > 0 or not square)):
            continue
        stiffness.append(slope)
        A, B, C, D = _state_space(forward, y, u)
        gain = way / (2 * u) if square else way  # dx/dF = dx/du du/dF, F = u^2
        frequency = _grid(A, dt, model.natural_frequency)
        z = np.exp(1j * frequency * dt)[:, None, None]
        inner = np.linalg.solve(
            z * np.eye(len(A)) - A, np.broadcast_to(B[:, None], (len(z), len(A), 1)).astype(complex)
        )
        response = gain * ((C @ inner[..., 0].T) + D) * np.exp(-1j * frequency * late)
        if np.isfinite(response).all():
            loops.append((frequency, response))
    return loops, stiffness


def stroke(model: Model) -> float:
    """Find the largest displacement of the training, m, else the static one under its largest voltage."""
    if len(model.domain.region):
        return float(np.abs(model.domain.region[0]).max() * model.scales.state[0])
    high = max(map(abs, model.domain.voltage_range))
    force = float(model.input_map.force(np.asarray(high))) if np.isfinite(high) else float(model.scales.force)
    return force / float(model.physical_coefficients[0])


def _holding(step: steps.Step, y):
    """Find the voltage that holds a displacement: of the inverse, begun under itself."""
    still = jnp.zeros(step.inputs).at[0].set(y)
    voltage = jnp.zeros(())
    # again under what it gave: states of the drive (a lag, a leak) are then those of a held voltage
    for _ in range(3):
        voltage = step.run(step.start(jnp.asarray(y), voltage), still)[1][0]
    return voltage


def _state_space(step: steps.Step, y: float, u: float):
    """Differentiate one step about an actuator held at y under u: (A, B, C, D)."""
    flat, unravel = ravel_pytree(step.start(jnp.asarray(y), jnp.asarray(u)))
    flat = flat.astype(jnp.float64)

    def run(state, voltage):
        after, out = step.run(unravel(state), voltage[None])
        return jnp.append(ravel_pytree(after)[0].astype(jnp.float64), out[0])

    by_state, by_voltage = map(np.asarray, jax.jit(jax.jacfwd(run, (0, 1)))(flat, jnp.asarray(u)))
    return by_state[:-1], by_voltage[:-1], by_state[-1], by_voltage[-1]


def _grid(A: np.ndarray, dt: float, natural: float) -> np.ndarray:
    """Choose frequencies in rad/s up to half the sampling rate, dense about every resonance."""
    turning = np.linalg.eigvals(A)
    turning = turning[(np.abs(turning) > 1e-3) & (np.angle(turning) > 1e-6)]
    resonances = np.angle(turning) / dt
    top = np.pi / dt
    coarse = np.geomspace(min(1e-5 * natural, 1e-3 * top), 0.9999 * top, 500)
    near = [w * (1 + _PEAK) for w in resonances[:12]]
    return np.unique(np.clip(np.concatenate([coarse, *near]), 0, 0.9999 * top))[1:]
