"""A time shift between the columns, taken out of the records."""

import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax.method.diagnose.clocks import Fault

TIME = np.arange(500) / 100.0


def motion(t):
    return 1e-3 * np.sin(2 * np.pi * 1.7 * t)


@pytest.mark.parametrize("early", [0.02, 0.013, 0.004])
def test_an_output_that_was_early_is_put_back(early):
    """Also by parts of a sample: the motion itself, and the voltage as it was; a missing sample stays missing."""
    seen = motion(TIME + early)
    seen[100] = np.nan
    (found,) = Fault(early).corrected([pitp.Record("r", TIME, np.cos(TIME), seen)])
    there = np.isfinite(found.displacement)
    np.testing.assert_allclose(found.displacement[there], motion(found.time)[there], atol=2e-8)
    np.testing.assert_allclose(found.voltage, np.cos(found.time))
    assert (~there).sum() == 1 and len(TIME) - found.samples == np.ceil(early * 100 - 1e-6)
