"""The noise's density in a residual: white and coloured noise of known density, beside lines that are no noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pitp_jax.method.numerics.noise_spectrum import band_edges, band_levels

DT, SAMPLES, DRAWS = 2e-3, 20_000, 40
EDGES = band_edges(int(0.6 * SAMPLES), DT)  # the tail that is looked at
MIDDLE = (EDGES[1:] + EDGES[:-1]) / 2
WIDE = MIDDLE > 12  # bands of some fifty bins and more; the quartile of two dozen, its colour from them too, reads high


def density(colour, beside=0.0):
    """Mean over draws of every band's level."""
    draws = (np.random.default_rng(k).standard_normal(SAMPLES) for k in range(DRAWS))
    seen = np.ones(SAMPLES, bool)
    return np.mean([band_levels(np.asarray(lfilter([1.0], colour, e)) + beside, seen, DT, EDGES) for e in draws], 0)


def test_bands_cover_all_frequencies_with_two_dozen_bins_each():
    assert EDGES[0] == 0 and EDGES[-1] == pytest.approx(0.5 / DT)
    assert (np.diff(EDGES) * int(0.6 * SAMPLES) * DT > 24 - 1e-9).all()


@pytest.mark.parametrize(("colour", "tone"), [([1.0], 0.0), ([1.0], 100.0), ([1.0, -0.95], 0.0)])
def test_a_band_has_its_noises_density(colour, tone):
    """2 dt / |A(exp(i w dt))|^2 of AR noise; a tone a hundred times as large fills few bins and moves no quartile.

    AR(0.95) has fifteen hundred times as much at the bottom as at the top.
    """
    levels = density(colour, tone * np.sin(2 * np.pi * 50.0 * np.arange(SAMPLES) * DT))
    response = np.polyval(np.array(colour)[::-1], np.exp(-2j * np.pi * MIDDLE * DT))
    ratio = levels / (2 * DT / np.abs(response) ** 2)
    np.testing.assert_allclose(ratio[WIDE], 1.0, atol=0.08)
    assert 0.9 < ratio.min() and ratio.max() < 1.45
