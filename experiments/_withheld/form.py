"""What a withheld effect may do to the plant, port by port; nothing of `pitp_jax.method.effects` is read here.

    V = drive(u),  F = coupling(V^2, x)
    x'' = limit((F + push - x - 2 zeta x' - force(x, x', s, t)) / inertia)
    s' = rates(u, x, x', s),   y = sensor(x, s) + p add,   s(0) = 0

Films begin uncharged, branches relaxed, bristles straight. Dimensionless: x in X = U^2 / a_0, the static displacement
under the largest voltage U; u, V in U; time in 1/w0 (the session clock t in s). `p` is the form's one strength, found
by search on the gap; `c` holds its other draws.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Stats:
    """Of the healthy plant under the drives of the case, all dimensionless but f0 and length.

    Attributes:
        top, bottom: largest and smallest x.
        third: the third largest of the records' largest x.
        speed: largest |x'|.
        fall: largest -x''.
        slew: largest |u'| but for the fastest 0.1 % of samples.
        level: largest u.
        zeta: damping ratio.
        f0: resonance in Hz.
        length: of a record in s (the sweep is twice as long).
    """

    top: float
    bottom: float
    third: float
    speed: float
    fall: float
    slew: float
    level: float
    zeta: float
    f0: float
    length: float


def _draw(rng: np.random.Generator, stats: Stats) -> dict[str, float]:
    return {}


def _arrays(rng: np.random.Generator, time: np.ndarray, stats: Stats) -> dict[str, np.ndarray]:
    return {}


@dataclass(frozen=True)
class Form:
    """One form of one effect; what a port does not name stays as it was.

    Attributes:
        name: which form, for the opened label.
        span: smallest and largest strength p searched.
        draw: other constants of the form from (rng, stats).
        arrays: disturbances per record from (rng, time in s, stats), shape (T,): `push` (force) and `add` (output)
            times p, `gate` (the drive becomes (1 - p gate) u).
        states: how many states s it brings.
        lasts: whether these states go on from recording to recording (a rest does not mend the material).
        stiff: Runge-Kutta steps per 1/w0, where the form needs more than the plant.
        delay: (p, c) to a delay of the drive in 1/w0, rounded to whole Runge-Kutta steps; None: no delay.
        drive, coupling, force, inertia, limit, rates, sensor: the ports of the equation above.
    """

    name: str
    span: tuple[float, float]
    draw: Callable = _draw
    arrays: Callable = _arrays
    states: int = 0
    lasts: bool = False
    stiff: float = 30.0
    delay: Callable | None = None
    drive: Callable = lambda p, c, u, s: u
    coupling: Callable = lambda p, c, force, x: force
    force: Callable = lambda p, c, x, v, s, t: 0.0
    inertia: Callable = lambda p, c: 1.0
    limit: Callable = lambda p, c, a: a
    rates: Callable = lambda p, c, u, x, v, s: ()
    sensor: Callable = lambda p, c, x, s: x
