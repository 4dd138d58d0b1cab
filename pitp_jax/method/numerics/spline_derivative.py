"""Differentiate a sampled path by recursive filters that equal an interpolating spline away from the ends.

    x = b * c,   x^(i)_t = dt^-i sum_j c_{t-j} B^(i)(j)              B: B-spline of odd degree, b_j = B(j)
    c = g (forward then backward) of y_t = x_t + sum_k p_k y_{t-k},  poles z of b inside the unit circle (Unser, 1993)

Start-up errors decay like max|z|^t, 0.43 (quintic) or 0.54 (septic), so they vanish in float64 after R = 51 or 67
samples from either side. Near the two ends of a path the spline itself is used. Equal to `derivatives` to rounding, and
local: a path may come in pieces. One spline over all takes 30 times as long (docs/decisions/decoder.md).
"""

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ...common.errors import BadInput


def derivatives(x: np.ndarray, dt: float, order: int) -> np.ndarray:
    """Differentiate a sampled path by an interpolating spline; return [x, ..., x^(order)], (T, order + 1)."""
    # odd, so that knots are samples; at least order + 3, so that x^(order) itself is twice differentiable
    degree = 2 * ((order + 3) // 2) + 1
    if len(x) <= degree:
        raise BadInput(f"the target has {len(x)} samples; order {order} needs more than {degree}")
    t = np.arange(len(x)) * dt
    spline = scipy.interpolate.make_interp_spline(t, x, k=degree)
    return np.stack([x] + [spline.derivative(i)(t) for i in range(1, order + 1)], -1)


class _Spline(NamedTuple):
    """The filter of a spline: gain, denominator, the B-spline's derivatives at the samples, and the reach R."""

    gain: float
    recursion: np.ndarray
    slopes: np.ndarray
    reach: int


@lru_cache
def _spline(order: int) -> _Spline:
    half = (order + 3) // 2  # degree 2 half + 1, as in `derivatives`
    j = np.arange(-half, half + 1.0)
    basis = scipy.interpolate.BSpline.basis_element(np.arange(2 * half + 3) - (half + 1.0), extrapolate=False)
    sampled = np.asarray(basis(j))
    roots = np.roots(sampled)
    poles = roots[np.abs(roots) < 1].real  # b is symmetric: z and 1 / z are roots, all real; one of each is stable
    slopes = np.stack([np.asarray(basis.derivative(i)(-j)) for i in range(1, order + 1)])
    reach = int(np.ceil(np.log(1e-17) / np.log(np.abs(poles).max()))) + 2 * half  # below float64's rounding
    return _Spline(float(np.prod(-poles) / sampled[0]), np.poly(poles), slopes, reach)


def reach(order: int) -> int:
    """Return the number of samples R that a derivative uses on either side."""
    return _spline(order).reach


def inner(x: Float[np.ndarray, " time"], dt: float, order: int) -> Float[np.ndarray, "kept tokens"]:
    """Differentiate the samples R ... T - R - 1 of a path; return [x, x', ..., x^(order)]."""
    s = _spline(order)
    half, kept = s.slopes.shape[1] // 2, len(x) - 2 * s.reach
    # the stable half of 1 / b forward in time, the other half backward; both start from zero, hence R
    back = np.asarray(scipy.signal.lfilter([1.0], s.recursion, x))[::-1]
    c = np.asarray(scipy.signal.lfilter([s.gain], s.recursion, back))[::-1]
    tokens = np.empty((kept, order + 1))
    tokens[:, 0] = x[s.reach : s.reach + kept]  # the spline interpolates, so x has no rounding of its own
    for i, weights in enumerate(s.slopes, start=1):
        # B is even, so B^(i)(-j) = (-1)^i B^(i)(j): half the products, and none at 0 for odd i
        sign, total = 1.0 - 2.0 * (i % 2), np.zeros(kept)
        for k in range(1, half + 1):
            behind, ahead = c[s.reach - k :][:kept], c[s.reach + k :][:kept]
            total += weights[half - k] * (behind + sign * ahead)
        if i % 2 == 0:
            total += weights[half] * c[s.reach :][:kept]
        tokens[:, i] = total / dt**i
    return tokens


def fast_derivatives(x: Float[np.ndarray, " time"], dt: float, order: int) -> Float[np.ndarray, "time tokens"]:
    """Differentiate a whole path as `derivatives`, but faster; return [x, x', ..., x^(order)]."""
    return np.concatenate(list(derivatives_of_blocks([np.asarray(x, np.float64)], dt, order)))


def derivatives_of_blocks(blocks: Iterable[np.ndarray], dt: float, order: int) -> Iterator[np.ndarray]:
    """Yield rows [x, ..., x^(n)] of the samples in order; the last samples wait until later ones arrive."""
    r, held, begun = reach(order), np.zeros(0), False
    for block in blocks:
        held = np.concatenate([held, block])
        if len(held) <= 6 * r:
            continue
        if not begun:  # the filters' start-up reaches R samples in, so the spline itself is used there
            yield derivatives(held[: 3 * r], dt, order)[:r]
        yield inner(held[r:] if begun else held, dt, order)
        held, begun = held[-3 * r :], True
    if not begun:
        yield derivatives(held, dt, order)
        return
    if len(held) > 3 * r:
        yield inner(held[r:], dt, order)
    yield derivatives(held[-3 * r :], dt, order)[-r:]
