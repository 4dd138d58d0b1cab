"""Plants with zeros, made by SciPy: identify says which, at which frequency; without zeros it says nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import chirp, lsim

from pitp_jax import Record
from pitp_jax.common.errors import ComputationFailed
from pitp_jax.method.identify import identification
from pitp_jax.method.identify.beginnings import find_beginnings
from pitp_jax.method.identify.frequency_response import FrequencyResponse
from pitp_jax.method.identify.identification import _better, identify
from pitp_jax.method.identify.linear_ode import mode
from pitp_jax.method.identify.rational_fit import fit_rational, needs_resonance
from pitp_jax.method.identify.remarks import UNSTABLE

DT = 0.01
TIME = np.arange(1500) * DT
SWEEP = chirp(TIME, 0.1, TIME[-1], 12.0, method="logarithmic", phi=-90)
W = 2 * np.pi * np.array([2.0, 3.0])  # rad/s
MODE = [1 / W[0] ** 2, 2 * 0.2 / W[0], 1.0]


def record(numerator, denominator, drive=SWEEP, noise=1e-3):
    y = lsim((numerator, denominator), drive, TIME)[1]
    y = y + noise * np.std(y) * np.random.default_rng(0).standard_normal(len(y))
    return Record("r", TIME, drive, y, voltage_unit="V", displacement_unit="rad")


@pytest.mark.parametrize(
    ("numerator", "denominator", "line", "leave_out"),
    [
        ([0.4, 1.0], MODE, "a zero at 0.39", ("delay",)),
        ([1 / W[1] ** 2, 0.0, 1.0], np.polymul(MODE, [0.5, 1.0]), "a pair of zeros at 3 Hz (an antiresonance)", ()),
        ([1.0, 0.0], MODE, "a zero at 0 Hz (a velocity)", ()),
        ([1.0, 0.0, 0.0], MODE, "two zeros at 0 Hz (an acceleration)", ("delay",)),
    ],
)
def test_zeros_are_told_with_their_frequency_and_no_other_reason(numerator, denominator, line, leave_out):
    """With delays among the candidates, and with half as many fits without them."""
    found = identify([record(numerator, denominator)], input_map="linear", leave_out=leave_out)
    assert found.warning is not None and line in found.warning and "and a mode at 2" in found.warning
    assert "`pitp fit`" in found.warning and found.remarks == ()
    assert not any(fit.identifiable for fit in (found.chosen, *found.orders))


def hardening():
    """y'' = u - y - y^3 in units of the mode: a spring that hardens has no zeros."""
    y, v, rows = 0.0, 0.0, []
    for u in 3 * SWEEP:
        rows.append(y)
        for _ in range(20):
            v += DT / 20 * (W[0] ** 2 * (u - y - y**3) - 0.4 * W[0] * v)
            y += DT / 20 * v
    return Record("r", TIME, 3 * SWEEP, np.array(rows), voltage_unit="V", displacement_unit="rad")


@pytest.mark.parametrize("made", [hardening, lambda: record([2.5, 1.3], np.polymul(MODE, [2.5, 1.0]))])
def test_a_hardening_spring_and_creep_are_not_called_zeros(made):
    found = identify([made()], input_map="linear")
    assert found.warning is None or "zero" not in found.warning


def test_one_sine_determines_two_numbers():
    wave = np.sin(2 * np.pi * 0.64 * TIME)
    (one, two) = (identify([record([1.0], MODE, drive)], input_map="linear") for drive in (wave, wave + SWEEP))
    assert one.warning is not None and "one frequency, 0.64 Hz, which determines two numbers" in one.warning
    assert not one.chosen.identifiable and two.warning is None and two.chosen.identifiable


@pytest.mark.parametrize("drive", [pytest.param(SWEEP, marks=pytest.mark.slow), 1.5 + 1.5 * SWEEP])
def test_the_input_map_is_the_one_that_leaves_clearly_less(drive):
    """A voltage that moves a length linearly: the square is usual, and given it stays, with a word on the other."""
    linear = replace(record([1.0], [0.3, 1.0], drive), displacement_unit="m")
    chosen, given = identify([linear], order=1), identify([linear], order=1, input_map="square")
    assert chosen.model.input_map.name == "linear" and given.model.input_map.name == "square"
    assert chosen.remarks[0].startswith("With --input-map linear, ") and "was chosen" in chosen.remarks[0]
    assert given.remarks[0].startswith("With --input-map linear, ") and "was chosen" not in given.remarks[0]
    squared = replace(record([1.0], MODE, drive**2), voltage=drive, displacement_unit="m")
    assert identify([squared], order=2).model.input_map.name == "square"


def test_another_map_that_is_no_better_is_not_described(monkeypatch):
    """Noise of a fifth of the motion makes the other map a candidate; its remarks could not be reported."""
    squared = replace(record([1.0], MODE, SWEEP**2, noise=0.2), voltage=SWEEP, displacement_unit="m")
    maps, told = [], identification.remarks
    monkeypatch.setattr(identification, "find_beginnings", lambda r, m: maps.append(m) or find_beginnings(r, m))
    monkeypatch.setattr(identification, "remarks", lambda *a, **k: maps.append("told") or told(*a, **k))
    assert identify([squared], order=2).model.input_map.name == "square"
    assert maps == ["square", "told", "linear"]


def test_no_plant_is_unstable_that_is_stable_with_the_other_map():
    found = identify([record([1.0], MODE)], input_map="linear")
    unstable = replace(found, remarks=(f"{UNSTABLE}: ...",))
    assert _better(unstable, unstable, "linear", given=True).remarks == unstable.remarks
    (line,) = _better(unstable, found, "linear", given=True).remarks
    assert "unstable" not in line and "--input-map linear" in line
    with pytest.raises(ComputationFailed, match="no order from 1 to 6 .* --input-map linear"):
        _better(ComputationFailed(f"{UNSTABLE}: ..."), found, "linear", given=True)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("roots", [[-1.0, -40.0], [-2 + 12j, -2 - 12j], [0.0, -3 + 20j, -3 - 20j]])
def test_modes_add_up_to_a_plant_with_a_zero(roots, hold):
    roots, drive = np.array(roots), 1 + SWEEP
    residues = [np.polyval([0.3, 1.0], p) / np.prod(p - roots[roots != p]) for p in roots]
    y = sum(np.real(r * DT * mode(p * DT, drive, hold)) for p, r in zip(roots, residues, strict=True))
    truth = lsim(([0.3, 1.0], np.poly(roots).real), drive, TIME, interp=hold == "foh")[1]
    np.testing.assert_allclose(y, truth, atol=1e-9 * np.ptp(truth))


def response(numerator, denominator, delay=0.0):
    hz = np.geomspace(0.1, 10.0, 80)
    s = 2j * np.pi * hz
    value = np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-s * delay) * np.sinc(hz * DT) ** 2
    return FrequencyResponse(hz, value, 1e-3 * np.abs(value), np.ones(len(hz)))


def test_a_rational_fit_finds_the_poles_zeros_and_delay_of_a_response():
    found = fit_rational(response([1 / W[1] ** 2, 0.0, 1.0], np.polymul(MODE, [0.5, 1.0]), 0.05), DT, 3, 2)
    assert found.error < 1e-3 and found.delay == pytest.approx(0.05, rel=1e-3)
    np.testing.assert_allclose(np.sort(np.abs(found.poles)), [2.0, W[0], W[0]], rtol=1e-3)
    np.testing.assert_allclose(np.abs(found.zeros), W[1], rtol=1e-3)


@pytest.mark.parametrize(
    ("denominator", "delay", "needed"),
    [
        (MODE, 0.0, True),
        (MODE, 0.4, True),
        ([0.4, 1.0], 0.4, False),
        ([0.4, 1.0, 0.0], 0.0, False),
        ([1.0], 0.1, False),
    ],
)
def test_a_resonance_is_a_pole_pair_that_the_response_needs(denominator, delay, needed):
    assert needs_resonance(response([1.0], denominator, delay), DT) == needed


def test_an_output_equal_to_the_input_has_a_gain_of_one():
    """The poles wander at a constant residual, and must not overflow."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, 30), 40)
    found = identify([Record("r", TIME[:1200], u, u.copy(), "rad", "rad")], input_map="linear")
    assert abs(found.chosen.coefficients[0] - 1.0) < 0.01
