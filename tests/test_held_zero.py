"""Records that begin under a held drive say what the static curve is; they do not bend it to what the nominal says."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.signal import lsim
from typed import of_kind

from pitp_jax import Record, identify, train
from pitp_jax.method.signal.initial_state import Beginning
from pitp_jax.method.simulate.beginnings import settled_states, with_zero_at_rest
from pitp_jax.method.train.settings import preset_of

DT, SAMPLES = 5e-3, 2400
TIME = np.arange(SAMPLES) * DT
ZERO, NOISE = -0.7, 1e-3
# x'' / 400 + 0.03 x' + x + 0.4 (x - y) = u^2,  2 y' = x - y: 1.4 times as stiff at once as when settled
PLANT = ([[0, 1, 0], [-560, -12, 160], [0.5, 0, -0.5]], [[0], [400], [0]], [[1, 0, 0]], [[0]])


def recorded(name, u, settled):
    x = of_kind(tuple, lsim(PLANT, u**2 - settled**2, TIME))[1] + settled**2
    return Record(name, TIME, u, x + ZERO + NOISE * np.random.default_rng(len(name)).standard_normal(SAMPLES))


def biased(name, size, hz):
    return recorded(name, 1.2 + size * np.sin(2 * np.pi * hz * TIME), 1.2)


def from_rest(name, size, hz):
    return recorded(name, (0.8 + size * np.sin(2 * np.pi * hz * TIME)) * np.minimum(TIME / 0.3, 1), 0.0)


def settled_at(model, volts):
    states = settled_states(model, np.array([volts]), DT, np.zeros(1))
    return float(states[0, 0]) * float(model.scales.state[0])


@pytest.mark.slow
def test_held_records_do_not_bend_the_static_curve():
    sweep = recorded("sweep", 1.2 + 0.2 * np.sin(2 * np.pi * (0.3 * TIME + 0.25 * TIME**2)), 1.2)
    nominal = identify([sweep], order=2).model
    assert settled_at(nominal.model, 1.2) < 0.8 * 1.44  # the stiffness of a sweep is not the settled one
    held = [biased("held1", 0.2, 0.6), biased("held22", 0.3, 2.0)]
    rest = [from_rest("rest333", 0.5, 0.5), from_rest("rest4444", 0.4, 1.9)]
    quick = replace(preset_of("default"), stages=1, epochs=8, starts=1, refine_steps=6)
    found = train(nominal, [*held, *rest], settings=quick, key=jax.random.key(0)).model
    assert settled_at(found.model, 1.2) == pytest.approx(1.44, rel=0.02)
    assert float(found.model.output.offset) == pytest.approx(ZERO, abs=0.01)


def test_a_sensor_zeroed_anew_under_the_held_drive_keeps_its_own_zero():
    rest = Beginning("rest", 1.0, ZERO, 1e-3)
    held, anew = (Beginning("held", 1.0, zero, 1e-3, level=zero + 1.04) for zero in (ZERO + 0.4, ZERO - 1.04))
    told = with_zero_at_rest([rest, held, anew])
    assert [(b.zero, b.free) for b in told] == [(ZERO, False), (ZERO, False), (ZERO - 1.04, True)]
    assert all(b.free for b in with_zero_at_rest([held, anew]))  # none at rest
