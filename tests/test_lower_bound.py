"""Coordinates without bounds: the inverse of each other, smooth, and never below the bound."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pitp_jax.method.fit.lower_bound import UNBOUNDED, LowerBound

BOUND = LowerBound(np.array([-6.0, -np.inf, 2.0]))
numbers = st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=3).map(np.array)


@given(numbers)
def test_parameters_stay_above_their_bound(v):
    p = BOUND.parameters(v)
    assert (p >= BOUND.least).all() and p[1] == v[1]
    far = v >= BOUND.least + 1
    np.testing.assert_array_equal(p[far], v[far])


@given(numbers.filter(lambda v: (v > np.array([-19.0, -99.0, -11.0])).all()))
def test_coordinates_are_the_inverse(v):
    """As far as the difference to the bound is above the rounding of the bound."""
    np.testing.assert_allclose(BOUND.coordinates(BOUND.parameters(v)), v, atol=1e-6)


@given(numbers)
def test_slopes_are_the_derivative(v):
    h = 1e-6
    central = (BOUND.parameters(v + h) - BOUND.parameters(v - h)) / (2 * h)
    np.testing.assert_allclose(BOUND.slopes(v), central, atol=1e-5)


def test_without_a_bound_nothing_changes():
    v = np.array([-3.0, 0.0, 70.0])
    np.testing.assert_array_equal(UNBOUNDED.parameters(v), v)
    np.testing.assert_array_equal(UNBOUNDED.coordinates(v), v)
    np.testing.assert_array_equal(UNBOUNDED.slopes(v), np.ones(3))


def test_a_start_below_its_bound_begins_above_it():
    v = BOUND.coordinates(np.array([-8.0, 0.0, 2.0]))
    assert np.isfinite(v).all() and (BOUND.parameters(v) > BOUND.least).all()
