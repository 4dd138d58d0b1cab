"""Metrics against closed forms."""

import numpy as np
import pytest

from pitp_jax import e_rms_percent, nrmse_percent, rmhe_percent, rmse

PHASE = np.arange(1000) / 1000 * 2 * np.pi
SINE = 2.0 * np.sin(PHASE)


def test_closed_forms():
    assert rmse(SINE + 0.5, SINE) == pytest.approx(0.5)
    assert e_rms_percent(SINE + 0.4, SINE) == pytest.approx(10.0)  # range 4
    assert nrmse_percent(SINE + 0.5, SINE) == pytest.approx(100 * 0.5 / np.sqrt(2))
    assert nrmse_percent(np.zeros(1000), SINE) == pytest.approx(100.0)
    assert e_rms_percent(SINE, SINE) == 0.0


def test_missing_samples_do_not_count():
    holed = SINE.copy()
    holed[100:300] = np.nan
    predicted = SINE + 0.4
    predicted[100:300] = 1e9
    assert rmse(predicted, holed) == pytest.approx(0.4)
    assert e_rms_percent(predicted, holed) == pytest.approx(100 * 0.4 / (np.nanmax(holed) + 2.0))
    mask = np.arange(1000) >= 500
    predicted[:500] = np.nan
    assert rmse(predicted, holed, mask) == pytest.approx(0.4)
    assert e_rms_percent(predicted, holed, mask) == pytest.approx(20.0, rel=1e-3)  # range 2 in that half


def test_divergence_is_infinite_and_never_left_out():
    predicted = SINE.copy()
    predicted[-1] = np.nan
    assert rmse(predicted, SINE) == np.inf
    assert e_rms_percent(predicted, SINE) == np.inf
    predicted[-1] = 1e200
    assert np.isfinite(nrmse_percent(predicted, SINE))


def test_nothing_to_compare():
    assert np.isnan(rmse(SINE, np.full(1000, np.nan)))
    assert np.isnan(e_rms_percent(SINE, np.full(1000, np.nan)))
    assert np.isnan(e_rms_percent(SINE, np.full(1000, 0.1)))
    assert np.isnan(nrmse_percent(SINE, np.full(1000, 0.1)))
    assert np.isnan(rmhe_percent(SINE, np.zeros(1000)))


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.3, np.pi / 2])
@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_rmhe_of_a_lag_is_its_sine(lag, gain):
    measured = gain * 2.0 * np.sin(PHASE - lag) + 0.3
    assert rmhe_percent(SINE, measured) == pytest.approx(100 * np.sin(lag), abs=0.1)
    long_reference, long_measured = np.tile(SINE, 3), np.tile(measured, 3)
    long_measured[:1000] += 5.0
    assert rmhe_percent(long_reference, long_measured, 1000) == pytest.approx(100 * np.sin(lag), abs=0.1)


def test_rmhe_of_a_parallelogram():
    """A play of half width r: x_e follows x_r at a distance r; the loop is 2 r wide in x_r."""
    reference = np.concatenate([np.linspace(-1, 1, 501), np.linspace(1, -1, 501)[1:-1]])
    measured = np.empty_like(reference)
    state = -0.9
    for _ in range(2):
        for k, r in enumerate(reference):
            state = min(max(state, r - 0.1), r + 0.1)
            measured[k] = state
    assert rmhe_percent(reference, measured) == pytest.approx(10.0, rel=0.01)


def test_rmhe_skips_missing():
    measured = 2.0 * np.sin(PHASE - 0.3)
    measured[10:12] = np.nan
    assert rmhe_percent(SINE, measured) == pytest.approx(100 * np.sin(0.3), abs=0.2)
