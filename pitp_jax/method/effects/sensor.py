"""Effects of the sensor: from the displacement x to the sensor's reading y (port OUT).

sensor_gain           y = (1 + d) x                    sensor_nonlinearity   y = x + c2 x^2 + c3 x^3,  tanh(c x) / c
sensor_lag            tau y' = x - y, once or twice;   tau^2 y'' + 2 zeta tau y' + y = x
backlash              y follows x as soon as it is width / 2 away, or coasts until x catches it: y'' = -rate y'
second_mode           y = x + gain (z - x),  z'' = omega^2 (x - z) - 2 zeta omega z'
"""

from functools import partial

import jax.numpy as jnp

from ..model.drive import slope
from .drive import TAU, last_lag
from .inertia import MODE
from .kernels import coasting, lag, lead, oscillator, play
from .spec import EffectSpec, Parameter, signed, strength


def _within_play(p, x, z):
    """Return the follower of a play at the displacement x."""
    return jnp.clip(z[0], x - p.width / 2, x + p.width / 2)


_sensor = partial(EffectSpec, family="sensor", port="OUT")  # from the displacement to its reading

_WIDTH = strength("width", "x", length=1)


def _second_order(p, y, dt):
    # the equation itself, solved for x
    first = slope(y, dt)
    return y + 2 * p.zeta * p.tau * first + p.tau**2 * slope(first, dt)


def _across(p, y, dt):
    """Compute x = y + w/2 sgn(y') from the reading: the play is crossed at every reversal of a smooth motion."""
    # the sign of y' smoothed by tanh, because no motion could cross the whole play within a sample; one that crosses it
    # within 50 samples has one direction
    least = jnp.maximum(p.width, 1e-12) / (50 * dt)
    return y + p.width / 2 * jnp.tanh(slope(y, dt) / least)


SENSOR = (
    _sensor(
        "sensor_gain", "share", (signed("d"),), "The sensor's scale factor is off.",
        "y = (1 + d) x", moves="gain", twin="parameter_change",
        law=lambda p, x, z: (1 + p.d) * x,
    ),
    # the curves rise over the range of the records, so within these bounds they can be inverted
    _sensor(
        "sensor_nonlinearity", "quadratic and cubic",
        (
            signed("c2", "1/x", length=-1),
            signed("c3", "1/x^2", length=-2),
        ),
        "The sensor is nonlinear, differently on either side.",
        "y = x + c2 x^2 + c3 x^3", law=lambda p, x, z: x + p.c2 * x**2 + p.c3 * x**3,
    ),
    _sensor(
        "sensor_nonlinearity", "saturating", (strength("c", "1/x", length=-1),),
        "The sensor's sensitivity decreases towards the ends of its range.", "y = tanh(c x) / c",
        law=lambda p, x, z: jnp.where(p.c > 0, jnp.tanh(p.c * x) / jnp.maximum(p.c, 1e-6), x),
        # beyond its range the sensor cannot show the wanted reading: the last possible position
        inverse=lambda p, y, dt: jnp.where(
            p.c > 0, jnp.arctanh(jnp.clip(p.c * y, -0.999, 0.999)) / jnp.maximum(p.c, 1e-6), y
        ),
    ),
    # without a unique inverse: of two displacements with the same reading, the one that is not folded
    _sensor(
        "sensor_nonlinearity", "folded", (Parameter("fold", "x", length=1, positive=False, off=-1e6),),
        "The sensor does not show the direction: beyond a position its reading decreases again.",
        "y = fold + |x - fold|",
        law=lambda p, x, z: x + 2 * jnp.maximum(p.fold - x, 0.0), inverse=lambda p, y, dt: y,
    ),
    EffectSpec(
        "backlash", "play", (_WIDTH,),
        "There is play between what moves and what is measured.", "x - width/2 <= y <= x + width/2, y moved by x alone",
        "dissipation", "OUT", kernel=play(0.5), inverse=_across, law=_within_play,
    ),
    EffectSpec(
        "backlash", "coasting", (_WIDTH, Parameter("rate", "1/s")),
        "There is play between what moves and a load that coasts until it is caught.",
        "y'' = -rate y' within x - width/2 < y < x + width/2, y' = x' at either end", "dissipation", "OUT",
        # without a closed inverse: the load moves freely, and shooting on the rollout corrects for half the width
        kernel=coasting(), inverse=lambda p, y, dt: y, law=_within_play,
    ),
    _sensor(
        "sensor_lag", "one lag", (TAU,), "The sensor responds with a lag.", "tau y' = x - y",
        kernel=lag(), law=last_lag, inverse=lambda p, y, dt: lead(y, dt, p.tau), twin="delay",
    ),
    _sensor(
        "sensor_lag", "second order", (TAU, Parameter("zeta")),
        "The sensor is a low-pass filter, or has a soft mount.",
        "tau^2 y'' + 2 zeta tau y' + y = x",
        kernel=oscillator(lambda p: 1 / jnp.maximum(p.tau, 1e-6)), inverse=_second_order, twin="delay",
        # at tau = 0 the oscillator is at its bound, and would replace x
        law=lambda p, x, z: jnp.where(p.tau > 0, z[0], x),
    ),
    EffectSpec(
        "second_mode", "between film and sensor", (strength("gain"), *MODE),
        "A mass on a spring is between the film and the sensor.", "y = x + gain (z - x), z as of the attached mass",
        "inertia", "OUT", kernel=oscillator(),
        # from gain 1 on the reading has a zero in the right half plane, and shooting on the rollout takes over
        law=lambda p, x, z: x + p.gain * (z[0] - x), solvable=lambda p: p.gain < 0.95,
    ),
)  # fmt: skip
