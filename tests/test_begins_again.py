"""How a record begins is decided once more under the model of the order and delay that were chosen."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pitp_jax import Record
from pitp_jax._identify.identification import identify

RATE, POLE, LATE = 500.0, 25.0, 6  # samples of delay


@pytest.mark.parametrize("noise", [5e-4, 2e-3])
def test_a_start_in_motion_behind_a_delay(noise):
    """A first-order plant behind six samples, cut out of a sweep: order 2 without a delay took it for settled.

    What arrives within the delay was played before the record: it bends neither pole nor delay.
    """
    time = np.arange(int(20 * RATE)) / RATE
    drive = np.sin(2 * np.pi * (0.2 * time + 24.8 * time**2 / 40))
    keep = np.exp(-POLE / RATE)
    x = np.asarray(lfilter([0.0, 1 - keep], [1.0, -keep], np.append(np.zeros(LATE), drive)[: len(drive)]))
    x = x + noise * np.random.default_rng(0).standard_normal(len(x))
    found = identify([Record("cut", time[650:], drive[650:], x[650:])], input_map="linear")
    chosen = found.chosen
    assert (found.beginnings["cut"].begins, chosen.order, chosen.hold) == ("moving", 1, "zoh")
    assert abs(chosen.delay - LATE / RATE) < 4 * chosen.delay_stderr
    assert chosen.natural_hz[0] == pytest.approx(POLE / (2 * np.pi), rel=5 * noise)
