"""Errors with a memory: made white, projected on columns, and averaged over blocks."""

import numpy as np
from scipy.signal import lfilter

from pitp_jax.method.numerics.coloured_noise import block_means, criterion, project, whitener


def test_an_autoregression_is_made_white():
    """AR(1) of 0.9: correlation at lag 1 of 0.9 before, none after, and the innovations' size."""
    rng = np.random.default_rng(0)
    w = 0.3 * rng.standard_normal(40_000)
    e = np.asarray(lfilter([1.0], [1.0, -0.9], w))
    white = whitener(e)(e)
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1] - 0.9) < 0.01
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.02
    np.testing.assert_allclose(white[10:].std(), 0.3, rtol=0.02)


def test_a_constant_pays_only_where_the_error_has_none():
    """BIC takes a level that is there and leaves one that slow noise merely resembles, in 19 of 20 draws at least."""
    rng, wrong = np.random.default_rng(1), 0
    for _ in range(20):
        e = np.asarray(lfilter([1.0], [1.0, -0.98], rng.standard_normal(4000)))
        whiten = whitener(e)
        for level, pays in ((0.0, False), (60.0, True)):
            y, ones = whiten(e + level), whiten(np.ones((4000, 1)))
            wrong += (criterion(project(y, ones)[1], 1) < criterion(y, 0)) != pays
    assert wrong <= 2


def test_projection_is_least_squares_whatever_the_columns_scale():
    rng = np.random.default_rng(2)
    columns, truth = rng.standard_normal((200, 3)) * [1e-9, 1.0, 1e9], np.array([2e9, -1.0, 3e-9])
    found, left = project(columns @ truth, columns)
    np.testing.assert_allclose(found, truth, rtol=1e-9)
    assert np.abs(left).max() < 1e-9


def test_projection_fits_what_counts_and_leaves_dependent_columns_out():
    """The same column twice, in another unit; a sample that does not count is far off and changes nothing."""
    rng, counts = np.random.default_rng(3), np.arange(200) != 7
    columns, truth = rng.standard_normal((200, 2)), rng.standard_normal((2, 5))
    values = columns @ truth + 1e9 * ~counts[:, None]
    found, left = project(values, np.column_stack([columns, 1e6 * columns[:, 0]]), counts)
    np.testing.assert_allclose(found[:2] + [1e6 * found[2], np.zeros(5)], truth, rtol=1e-9)
    np.testing.assert_allclose(left, 1e9 * ~counts[:, None] * np.ones(5), atol=1e-6)


def test_block_means_weigh_and_leave_the_incomplete_block():
    values, weight = np.arange(7.0), np.array([1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    means, share = block_means(values, weight, 3)
    np.testing.assert_allclose(means, [1.0, 3.0])
    np.testing.assert_allclose(share, [2 / 3, 1 / 3])
