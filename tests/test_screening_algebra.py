"""Regression on Gram matrices is least squares on the columns they were made of."""

import numpy as np
import pytest

from pitp_jax._diagnose.regress import Screening, pairs, singles
from pitp_jax._effects import lookup
from pitp_jax._effects.spec import Start

SAMPLES, NUISANCE = 400, 3
WIDE = {1: Start((1.0,), (1e-6,), (1e6,)), 3: Start((1.0, 0.7, 2.0), (1e-6, 0.3, 2.0), (1e6, 3.0, 2.0))}
FORMS = (lookup("stiffening"), lookup("stiffening"), lookup("sensor_gain"), lookup("drag", "power"))
VALUES = ((0.5,), (0.25,), (0.1,), (0.3, 0.7, 2.0))


def data(rng):
    """The error in the first column, what may be regressed out, then a column a point."""
    nuisance, columns = rng.standard_normal((SAMPLES, NUISANCE)), rng.standard_normal((SAMPLES, len(FORMS)))
    error = nuisance @ [0.2, -0.1, 0.3] + columns @ [0.1, 0.9, 0.3, 0.6] + 0.05 * rng.standard_normal(SAMPLES)
    return np.column_stack([error, nuisance, columns])


def regressed(fitted, held, which):
    """By lstsq: what is left on both sides, the nuisance's numbers and the strengths."""
    chosen = [*range(1, 1 + NUISANCE), *(1 + NUISANCE + k for k in which)]
    found = np.linalg.lstsq(fitted[:, chosen], fitted[:, 0], rcond=None)[0]
    left = [np.mean((rows[:, 0] - rows[:, chosen] @ found) ** 2) for rows in (fitted, held)]
    return *left, found[:NUISANCE], found[NUISANCE:]


@pytest.fixture(scope="module")
def screened():
    rng = np.random.default_rng(4)
    fitted, held = data(rng), data(rng)
    points = tuple((f, v, WIDE[len(v)]) for f, v in zip(FORMS, VALUES, strict=True))
    near, far = (rows.T @ rows / SAMPLES for rows in (fitted, held))
    return fitted, held, Screening(points, near, far, NUISANCE, np.array([1.0, 1.1, 0.9]))


def agrees(row, which, fitted, held):
    train, heldout, nuisance, strengths = regressed(fitted, held, which)
    np.testing.assert_allclose([row.train, row.heldout], [train, heldout], rtol=1e-8)
    np.testing.assert_allclose(row.factors, np.array([1.0, 1.1, 0.9]) * (1 - nuisance), rtol=1e-8)
    for k, s, values in zip(which, strengths, row.values, strict=True):
        np.testing.assert_allclose(values, (VALUES[k][0] * s, *VALUES[k][1:]), rtol=1e-8)


def test_single_forms_are_regressed_at_their_best_points(screened):
    fitted, held, found = screened
    rows = singles(found)
    assert [r.forms for r in rows] == [(lookup("stiffening"),), (lookup("drag", "power"),), (lookup("sensor_gain"),)]
    for row, which in zip(rows, ([1], [3], [2]), strict=True):
        agrees(row, which, fitted, held)


def test_pairs_are_regressed_together(screened):
    fitted, held, found = screened
    rows = pairs(found, 10)
    assert [set(r.forms) for r in rows] == [
        {lookup("stiffening"), lookup("drag", "power")},
        {lookup("stiffening"), lookup("sensor_gain")},
        {lookup("sensor_gain"), lookup("drag", "power")},
    ]
    for row, which in zip(rows, ([1, 3], [1, 2], [2, 3]), strict=True):
        agrees(row, which, fitted, held)
