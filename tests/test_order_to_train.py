"""A model that will be trained starts with a mass where the recordings show one as well as none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax import Record, identify
from pitp_jax.application.commands import fit
from pitp_jax.method.identify.identification import trains_from_order_two

TIME = np.arange(3000) * 2e-3


def recorded(*hz):
    """A plant of these real poles, driven by a chirp; a tenth of a percent of noise."""
    poles = np.ones(1)
    for f in hz:
        poles = np.convolve(poles, [1 / (2 * np.pi * f), 1.0])
    voltage = 600 * (1 - np.cos(2 * np.pi * (0.3 + 0.4 * TIME) * TIME))
    x = 1e-9 * lsim(([1.0], poles), voltage**2, TIME)[1]
    noise = 1e-3 * np.ptp(x) * np.random.default_rng(0).standard_normal(len(x))
    return [Record("chirp", TIME, voltage, x + noise, "V", "m")]


@pytest.fixture(scope="module")
def overdamped():
    return identify(recorded(1.5, 12.0))


@pytest.mark.parametrize(
    ("heldout", "known", "expected"), [(1.02, True, True), (1.05, True, False), (0.9, False, False)]
)
def test_order_two_takes_the_place_of_one_where_it_is_as_good_and_known(overdamped, heldout, known, expected):
    one, two, *_ = overdamped.orders
    assert (overdamped.chosen.order, trains_from_order_two(overdamped)) == (2, False)
    two = replace(two, heldout=heldout * one.heldout, poles_known=known)
    assert trains_from_order_two(replace(overdamped, chosen=one, orders=(one, two))) == expected


def test_a_plant_without_mass_gets_none():
    found = identify(recorded(1.5))
    assert found.chosen.order == 1 and not trains_from_order_two(found)


def test_fit_identifies_again_unless_the_order_is_given(overdamped, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(fit, "identify", lambda records, order, **_: asked.append(order) or overdamped)
    monkeypatch.setattr(fit, "trains_from_order_two", lambda found: True)
    fit._identified(recorded(1.5), order="auto", input_map=None)
    assert asked == ["auto", 2] and "cannot add the mass" in capsys.readouterr().err
    fit._identified(recorded(1.5), order=1, input_map=None)
    assert asked == ["auto", 2, 1]
