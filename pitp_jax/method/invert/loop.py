"""Compute the margins of a sampled PI loop from linearisations of the plant about its operating points.

    L(z) = (p + i dt z / (z - 1)) z^-1 G(z),   G(z) = (C (z - A)^-1 B + D) e^(-j w late),   z = e^(j w dt)
    maximum sensitivity M = max |1 / (1 + L)|,   gain margin = min 1 / |L| where L crosses the negative real axis

The loop is stable if f(z) = (1 + L) (z - 1) / z has no zero outside the unit circle. By the argument principle
the number of these zeros is P - (turn of f over the upper half circle) / pi, with P the unstable poles of the plant.

Astrom and Hagglund (2006), Advanced PID Control, section 4.6.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...common.errors import BadInput
from ..model.programs import full_precision

# relative to a resonance: dense where a weakly damped one turns the phase by pi
_PEAK = np.concatenate([-np.geomspace(0.2, 1e-3, 40), [0.0], np.geomspace(1e-3, 0.2, 40)])
_COARSE, _RESONANCES = 500, 12  # frequencies over the whole band; resonances with additional frequencies
_ROUNDING = 1e-7  # of a pole's modulus: a constant state has a pole at 1


@dataclass(frozen=True)
class Plant:
    """The frequency response of a plant, linearised about one operating point.

    Attributes:
        frequency: rad/s, rising.
        response: G, output one sample after the input, shape (frequencies,).
        poles: of the sampled plant.
    """

    frequency: np.ndarray
    response: np.ndarray
    poles: np.ndarray


def linearised(
    step: Callable, points: Sequence[tuple[Any, float, float]], dt: float, natural: float, late: float = 0.0
) -> list[Plant]:
    """Linearise a plant about several states; return its frequency response about each.

    Args:
        step: (state, input) -> (state, output one sample later).
        points: the state (a pytree of arrays), the input, and d(input) / d(output of the controller) of each point.
        dt: s.
        natural: a frequency of the plant, rad/s; the band starts far below it.
        late: a further delay, s.

    Returns:
        a plant for each point.

    Raises:
        BadInput: it has no finite derivatives at a point.
    """
    kind, unravel = jnp.result_type(float), ravel_pytree(points[0][0])[1]

    def run(state, value):
        after, out = step(unravel(state), value)
        return jnp.append(ravel_pytree(after)[0].astype(kind), out)

    states = jnp.stack([ravel_pytree(state)[0].astype(kind) for state, _, _ in points])
    values = jnp.asarray([value for _, value, _ in points], kind)
    slopes = jax.jit(full_precision(jax.vmap(jax.jacfwd(run, (0, 1)))))(states, values)
    plants = []
    for by_state, by_value, (_, _, gain) in zip(*map(np.asarray, slopes), points, strict=True):
        if not (np.isfinite(by_state).all() and np.isfinite(by_value).all()):
            raise BadInput("no stability margin: the plant has no finite derivatives at an operating point")
        plants.append(responding(by_state, gain * by_value, dt, natural, late))
    return plants


def responding(by_state: np.ndarray, by_value: np.ndarray, dt: float, natural: float, late: float = 0.0) -> Plant:
    """Compute the frequency response of a plant from its matrices [[A], [C]] and [B, D]."""
    A, B, C, D = by_state[:-1], by_value[:-1], by_state[-1], by_value[-1]
    poles = np.linalg.eigvals(A)
    frequency = _frequencies(poles, dt, natural)
    z = np.exp(1j * frequency * dt)[:, None, None]
    inner = np.linalg.solve(z * np.eye(len(A)) - A, np.broadcast_to(B[:, None], (len(z), len(A), 1)).astype(complex))
    response = ((C @ inner[..., 0].T) + D) * np.exp(-1j * frequency * late)
    return Plant(frequency, response, poles)


def _frequencies(poles: np.ndarray, dt: float, natural: float) -> np.ndarray:
    """Return frequencies (rad/s) up to half the sampling rate, dense about every resonance."""
    # one pole of each pair; a positive real pole, or one of a delay at z = 0, has no resonance
    turning = poles[(np.abs(poles) > 1e-3) & (np.angle(poles) > 1e-6)]
    top = np.pi / dt
    coarse = np.geomspace(min(1e-5 * natural, 1e-3 * top), 0.9999 * top, _COARSE)
    near = [w * (1 + _PEAK) for w in np.angle(turning)[:_RESONANCES] / dt]
    return np.unique(np.clip(np.concatenate([coarse, *near]), 0, 0.9999 * top))[1:]


def margins(plants: Sequence[Plant], p: float, i: float, dt: float, smoothing: float = 1.0) -> tuple[float, float]:
    """Compute gain margin and maximum sensitivity, each the worst over all operating points.

    `smoothing`: the part k of its difference from the error that the controller's average moves in a sample.

    Returns:
        The gain margin and the maximum sensitivity; the sensitivity is infinite if a loop is unstable.
    """
    margin, sensitivity = np.inf, 1.0
    for plant in plants:
        z = np.exp(1j * plant.frequency * dt)
        L = (p + i * dt * z / (z - 1)) * plant.response / z
        L *= smoothing * z / (z - 1 + smoothing)
        stable = _is_stable((1 + L) * (z - 1) / z, int((np.abs(plant.poles) > 1 + _ROUNDING).sum()))
        crossings, largest = _crossings(L), np.inf
        if stable:
            # It may cross beyond -1 and return; there a lower gain is dangerous, so it is not a gain margin.
            crossings, largest = crossings[crossings > -1], float(np.abs(1 / (1 + L)).max())
        margin = min(margin, *(-1 / crossings), np.inf)
        sensitivity = max(sensitivity, largest)
    return float(margin), float(sensitivity)


def _is_stable(f: np.ndarray, unstable: int) -> bool:
    turn = np.angle(f[1:] / f[:-1])
    if not (np.abs(turn) < np.pi / 2).all():  # a larger phase change between two frequencies is not resolved
        return False
    # it starts on the real axis, at z = 1
    start = np.angle(f[0] * np.sign(f[0].real))
    return round(unstable - (start + turn.sum()) / np.pi) == 0


def _crossings(L: np.ndarray) -> np.ndarray:
    """Return the values at which the loop gain L crosses the negative real axis, by interpolation."""
    real, imaginary = np.real(L), np.imag(L)
    above = np.sign(imaginary)
    at = np.flatnonzero((above[1:] * above[:-1] <= 0) & (above[1:] != above[:-1]))
    part = imaginary[at] / (imaginary[at] - imaginary[at + 1])
    crossing = real[at] + part * (real[at + 1] - real[at])
    return crossing[crossing < 0]
