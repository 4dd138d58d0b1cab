"""Define the mechanics of a virtual actuator: hyperelastic membrane, relaxation, mass and Maxwell stress.

With the distance z = z_eq + x from the undeformed shape, and the squared stretch q(z) beyond the prestretch,

    cone:  q = 1 + (z / w)^2,      roll:  q = (1 + z / w)^2,      q' = dq/dz,      L = q(z) / q(z_eq),

    m x'' = m g + C/2 u^2 q' - d x'
            - q' [ K/2 J/(J - I) (p^2 - 1/(p^4 q^2)) + sum_i K_i/(4 q) (L/b_i - b_i/L) + D q'/(4 q^2) x' ],
    I     = p^2 q + p^2 + 1/(p^4 q) - 3,
    b_i'  = (L - b_i^2 / L) / (2 tau_i),      b_i(0) = 1.

The bracket holds the Gent spring (neo-Hookean as J -> inf; incompressible, prestretch p both ways, the hoop kept
there), the Maxwell branches with squared viscous stretch b_i (energy K_i (L/b_i + b_i/L - 2)/4), and the Kelvin-Voigt
damping of the membrane; d is the friction of guide and air. The ideal dielectric has the capacitance C q. z_eq balances
gravity at u = 0. Nothing here is a polynomial in x, and no model in this package has the states b_i, so the actuator
differs from every model.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

GRAVITY = 9.81  # m/s^2


def _root(function, low: float, high: float) -> float:
    """Find the root of a function of z (m) between two ends at which it has opposite signs."""
    return float(cast(float, brentq(function, low, high, xtol=1e-15)))


@dataclass(frozen=True)
class ConeGeometry:
    """A membrane of radial width w (m) pulled out of its plane by z: squared stretch q = 1 + (z/w)^2.

    Attributes:
        width: distance w from the central disk to the frame in m.
    """

    width: float

    def stretch(self, z):
        """Compute the squared active stretch q and its slope dq/dz (1/m) at the distance z (m) from the flat shape."""
        return 1.0 + (z / self.width) ** 2, 2.0 * z / self.width**2


@dataclass(frozen=True)
class RollGeometry:
    """A roll of active length w (m) elongated by z: squared stretch q = (1 + z/w)^2.

    Attributes:
        width: active length w in m.
    """

    width: float

    def stretch(self, z):
        """Compute the squared active stretch q and its slope dq/dz (1/m) at the elongation z (m)."""
        return (1.0 + z / self.width) ** 2, 2.0 * (1.0 + z / self.width) / self.width


@dataclass(frozen=True)
class Plant:
    """A virtual actuator: the constants of its equations of motion and of its sensor.

    Attributes:
        name: its name in `plant`.
        rate_hz: sampling rate of the paper's experiment in Hz.
        mass: moved mass m in kg.
        max_voltage: rating in V; the equations are well-behaved up to it.
        noise_std: standard deviation of the sensor noise in m.
        sensor_range: the sensor reads -sensor_range ... +sensor_range (m) in 16 bit.
        scale: a typical displacement in m; the integration works in multiples of it.
        geometry: relation between stretch and displacement.
        prestretch: p, in both directions of the plane.
        spring: K = shear modulus times volume of elastomer, in J.
        limit: Gent's limit J of I.
        branches: (K_i in J, tau_i in s) of each Maxwell branch.
        membrane_damping: D in J s.
        friction: d in N s/m.
        capacitance: C in F, at q = 1.
    """

    name: str
    rate_hz: float
    mass: float
    max_voltage: float
    noise_std: float
    sensor_range: float
    scale: float
    geometry: ConeGeometry | RollGeometry
    prestretch: float
    spring: float
    limit: float
    branches: tuple[tuple[float, float], ...]
    membrane_damping: float
    friction: float
    capacitance: float

    @cached_property
    def rest_position(self) -> float:
        """Return the rest position z_eq (m) from the undeformed shape: relaxed, under gravity, at 0 V."""
        return _root(lambda z: self.relaxed_force(z, 0.0), 0.0, self.last_position)

    @cached_property
    def last_position(self) -> float:
        """Return the largest usable position (m): where the Gent spring is at 99 % of its limit, or four widths."""
        # I grows with z beyond the prestretch, so z may move below the first point over the limit
        z = np.linspace(0.0, 4.0 * self.geometry.width, 4001)
        return float(z[np.searchsorted(self._invariant(self.geometry.stretch(z)[0]), 0.99 * self.limit) - 1])

    def _invariant(self, q):
        """Compute the strain invariant I_1 - 3 of the membrane at the squared stretch q."""
        # stretches p sqrt(q), p and, because the elastomer keeps its volume, 1 / (p^2 sqrt(q)), squared
        p2 = self.prestretch**2
        return p2 * q + p2 + 1.0 / (p2**2 * q) - 3.0

    def relaxed_force(self, z, u):
        """Compute the total force (N) towards larger z (m) at standstill, after all creep, under u (V); any shape."""
        p2 = self.prestretch**2
        q, slope = self.geometry.stretch(z)
        gent = self.limit / (self.limit - self._invariant(q))  # stiffens without bound as the chains lock
        # energy U(q): the force is U' dq/dz; of the capacitor, C q u^2 / 2 at constant voltage, in the same way
        spring = 0.5 * self.spring * gent * (p2 - 1.0 / (p2 * q) ** 2) * slope
        return self.mass * GRAVITY - spring + 0.5 * self.capacitance * u**2 * slope

    def stretch_ratio(self, x):
        """Compute the squared stretch at the displacement x (m), relative to that at rest."""
        return self.geometry.stretch(self.rest_position + x)[0] / self.geometry.stretch(self.rest_position)[0]

    def static(self, u):
        """Solve for the displacement (m) at a constant voltage after all creep.

        Args:
            u: voltage in V, any shape.

        Returns:
            Displacement in m, the shape of `u`.
        """
        u = np.asarray(u, dtype=np.float64)
        rest, last = self.rest_position, self.last_position
        # voltage only increases z; half the rest position is below every root, because gravity dominates there
        roots = [_root(lambda z, v=v: self.relaxed_force(z, v), 0.5 * rest, last) - rest for v in u.ravel()]
        return np.asarray(roots).reshape(u.shape)[()]

    def derivative(self, state, u):
        """Compute the derivative of the state (x / scale, x' / (scale/s), b_i - 1) under u (V), (2 + branches,)."""
        # b_i - 1, so that the state at rest is zero and small creep keeps its digits
        x, v = state[0] * self.scale, state[1] * self.scale
        strength, tau = jnp.asarray(self.branches, dtype=state.dtype).T
        q, slope = self.geometry.stretch(self.rest_position + x)
        ratio = self.stretch_ratio(x)
        b = 1.0 + state[2:]
        branch = jnp.sum(strength * (ratio / b - b / ratio)) * slope / (4.0 * q)
        damping = (self.membrane_damping * (0.5 * slope / q) ** 2 + self.friction) * v
        force = self.relaxed_force(self.rest_position + x, u) - branch - damping
        mechanics = jnp.stack([state[1], force / (self.mass * self.scale)])
        return jnp.concatenate([mechanics, (ratio - b**2 / ratio) / (2.0 * tau)])

    def linearised(self, u: float = 0.0) -> np.ndarray:
        """Compute the Jacobian of `derivative` at the equilibrium under u (V), shape (2 + branches, 2 + branches)."""
        x = float(self.static(u))
        grown = self.stretch_ratio(x)  # relaxed: every branch has followed, b_i = L
        with jax.enable_x64(True):
            state = jnp.asarray([x / self.scale, 0.0] + [grown - 1.0] * len(self.branches))
            return np.asarray(jax.jacfwd(self.derivative)(state, u))

    @cached_property
    def resonance_hz(self) -> float:
        """Return the resonance frequency (Hz) at 0 V for small motions."""
        return float(abs(max(np.linalg.eigvals(self.linearised()), key=np.imag)) / (2.0 * np.pi))
