"""What the sensor makes of the motion (port OUT), and what a session makes of the spring (port T).

sensor_gain       y = (1 + d) x
sensor_lag        tau y' = x - y, once or twice;  tau^2 y'' + 2 zeta tau y' + y = x
stiffness_drift   f = -k d (1 - exp(-t / T)) x  or  -k d t / T x,  t the session's clock
"""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._model.drive import slope
from .base import AbstractForceEffect, AbstractSensorEffect, Instant, Parameter, Surroundings, bounded, nothing
from .lags import lag_starts, lags_in_a_row, lead, oscillate


class SensorGain(AbstractSensorEffect):
    """A wrong scale factor."""

    name, form, family, port = "sensor_gain", "share", "sensor", "OUT"
    only = True
    PARAMETERS = (Parameter("d", positive=False, neutral=0.0),)
    d: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Any sign: the output is linear in d."""
        return [bounded((0.05,), (-0.9,), (5.0,))]

    def initial(self, x):
        """None."""
        return nothing()

    def advance(self, states, x, after, h):
        """None."""
        return states

    def reading(self, states, x):
        """Scaled."""
        return (1 + self.d) * x

    def undo(self, y, dt):
        """By division."""
        return y / (1 + self.d)


class _SensorLag(AbstractSensorEffect):
    """Lags in a row."""

    name, family, port = "sensor_lag", "sensor", "OUT"
    PARAMETERS = (Parameter("tau", "s", neutral=0.0, linear=False),)
    sections: ClassVar[tuple[float, ...]]
    tau: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Around and below the time scale of the resonance."""
        return lag_starts(s)

    @property
    def _taus(self):
        return [share * self.tau for share in self.sections]

    def initial(self, x):
        """Settled at X."""
        return jnp.full((len(self.sections),), x)

    def advance(self, states, x, after, h):
        """Exact for the first lag; its output is taken as linear for the next."""
        return lags_in_a_row(states, x, after, self._taus, h)

    def reading(self, states, x):
        """The last lag's output."""
        return jnp.where(self.tau > 0, states[-1], x)

    def undo(self, y, dt):
        """By lead, lag by lag."""
        return lead(y, self._taus, dt)


class SensorLag(_SensorLag):
    """One lag."""

    form, states, sections = "one lag", 1, (1.0,)


class SensorFilter(_SensorLag):
    """Two equal lags."""

    form, states, sections = "two lags", 2, (0.5, 0.5)


class SecondOrderSensor(AbstractSensorEffect):
    """tau^2 y'' + 2 zeta tau y' + y = x: a low-pass filter, or a head on a soft mount."""

    name, form, family, port, states = "sensor_lag", "second order", "sensor", "OUT", 2
    PARAMETERS = (Parameter("tau", "s", neutral=0.0, linear=False), Parameter("zeta"))
    tau: Float[Array, ""]
    zeta: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Around and below the time scale of the resonance."""
        low, high = min(0.2 * s.dt, 0.003 / s.omega), 5.0 / s.omega
        return [bounded((0.25 / s.omega, 0.8), (low, 0.35), (high, 3.0))]

    def initial(self, x):
        """Settled at X."""
        return jnp.stack([jnp.asarray(x), jnp.zeros_like(x)])

    def advance(self, states, x, after, h):
        """By the mean displacement of the step."""
        return oscillate(states, (x + after) / 2, 1 / jnp.maximum(self.tau, 1e-6), self.zeta, h)

    def reading(self, states, x):
        """The filter's output."""
        return jnp.where(self.tau > 0, states[0], x)

    def undo(self, y, dt):
        """By lead."""
        first = slope(y, dt)
        return y + 2 * self.zeta * self.tau * first + self.tau**2 * slope(first, dt)


class _Drift(AbstractForceEffect):
    """A spring that changes over the session; its state is the session's age."""

    name, family, port, states = "stiffness_drift", "drift", "T", 1

    def initial(self, x, age):
        """The session's clock."""
        return jnp.reshape(jnp.asarray(age, jnp.result_type(x)), (1,))

    def advance(self, states, x, after, h):
        """Time passes."""
        return states + h


class SettlingDrift(_Drift):
    """d (1 - exp(-t / T))."""

    form = "settling"
    PARAMETERS = (Parameter("d", positive=False, neutral=0.0), Parameter("time", "s"))
    d: Float[Array, ""]
    time: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """Within the session; where it is no longer than a record, its clock is not known."""
        if s.session <= 1.5 * s.duration:
            return []
        low, high = (-2.0, s.duration), (0.9, 5 * s.session)
        return [bounded((0.1, max(share * s.session, 1.2 * s.duration)), low, high) for share in (0.1, 0.5)]

    def act(self, states, now: Instant, tokens, offset):
        """What is gone of the spring."""
        gone = self.d * -jnp.expm1(-states[0] / self.time)
        return tokens, offset - now.coefficients[0] * gone * now.state[0]


class LinearDrift(_Drift):
    """d t, d a share of k per second."""

    form = "steady"
    PARAMETERS = (Parameter("rate", "1/s", positive=False, neutral=0.0),)
    rate: Float[Array, ""]

    @classmethod
    def starts(cls, s: Surroundings):
        """A tenth of k over the session."""
        if s.session <= 1.5 * s.duration:
            return []
        return [bounded((0.1 / s.session,), (-2 / s.session,), (0.9 / s.session,))]

    def act(self, states, now: Instant, tokens, offset):
        """What is gone of the spring."""
        return tokens, offset - now.coefficients[0] * self.rate * states[0] * now.state[0]
