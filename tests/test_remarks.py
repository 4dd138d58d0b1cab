"""What an identification leaves open is told in words, with what to record: each against a plant that is known."""

import numpy as np
import pytest
from scipy.signal import chirp, lsim
from typed import of_kind

from pitp_jax import ComputationFailed, Record
from pitp_jax.method.identify import identification
from pitp_jax.method.identify.identification import identify
from pitp_jax.method.identify.linear_ode import bounded_response
from pitp_jax.method.identify.output_error import Problem

DT, SAMPLES = 5e-3, 4000
TIME = np.arange(SAMPLES) * DT
CHIRP = chirp(TIME, 0.1, TIME[-1], 6.0, phi=-90)
PUSHED = (1 + CHIRP) * np.minimum(TIME / 0.5, 1)  # from rest, with a mean
MODE = ([350.0], [1.0, 5.6, 350.0])  # 3 Hz, damping 0.15


def noise(size, seed=0):
    return size * np.random.default_rng(seed).standard_normal(SAMPLES)


def response(system, drive=PUSHED):
    return of_kind(tuple, lsim(system, drive, TIME))[1]


def held_up(damping, spring, gain, rate, fine=20):
    """x'' = u - damping x' - spring x in a loop u = gain (reference - x) - rate x': drive and motion."""
    x = v = 0.0
    rows = []
    for reference in CHIRP:
        u = gain * (reference - x) - rate * v
        rows.append((u, x))
        for _ in range(fine):
            v += DT / fine * (u - damping * v - spring * x)
            x += DT / fine * v
    return np.array(rows).T


@pytest.fixture(scope="module")
def plain():
    """A record of the mode alone, and its identification."""
    record = Record("r", TIME, PUSHED, response(MODE) + noise(0.01))
    return record, identify([record], input_map="linear")


def said(x, drive=PUSHED, **options):
    return identify([Record("r", TIME, drive, x)], input_map="linear", **options).remarks


@pytest.mark.parametrize(
    ("plant", "pole", "leave_out"),
    [((0.2, -9.0, 60.0, 8.0), "+2.9 1/s", ("delay",)), ((-2.0, 60.0, 40.0, 12.0), "+1 +- 7.68j 1/s", ())],
)
def test_an_unstable_plant_is_told_with_the_closed_loop_to_record(plant, pole, leave_out):
    """With delays among the candidates, and with half as many fits without them."""
    drive, x = held_up(*plant)
    (line,) = said(x + noise(1e-4), drive, leave_out=leave_out)
    assert f"The plant is unstable: with a pole at {pole}" in line and "Identify the closed loop instead" in line


def test_from_its_reference_it_is_identified():
    """What the line asks for: 60 / (s^2 + 8.2 s + 51)."""
    _, x = held_up(0.2, -9.0, 60.0, 8.0)
    found = identify([Record("loop", TIME, CHIRP, x + noise(1e-4))], input_map="linear")
    assert found.chosen.order == 2 and not any("unstable" in line for line in found.remarks)
    np.testing.assert_allclose(found.chosen.coefficients * 60, [51.0, 8.2, 1.0], rtol=0.03)


def test_a_bounded_response_solves_the_equation():
    """Poles +2 and -30: SciPy's run from zero, and free motions e^2t and e^-30t that keep it bounded."""
    size = 1000
    found, free = bounded_response(np.array([2.0, -30.0 + 0j]) * DT, CHIRP[:size])
    system = ([-60.0], [1.0, 28.0, -60.0])
    run = of_kind(tuple, lsim(system, CHIRP[:size], TIME[:size]))[1]
    columns = np.exp(np.outer(TIME[:size], [2.0, -30.0]))
    left = (found - run) - columns @ np.linalg.lstsq(columns, found - run, rcond=None)[0]
    assert np.abs(left).max() < 1e-6 and np.abs(found).max() < 3
    np.testing.assert_allclose(free, columns / [columns[-1, 0], 1.0], atol=1e-9)


@pytest.mark.parametrize(
    ("tau", "line"),
    [(10.0, "Creep (about 11 s) makes up 13 % of the signal"), (100.0, "A slow drift makes up 2.8 % of the signal")],
)
def test_creep_is_told_with_the_time_that_would_show_it(tau, line):
    x = response(MODE) + 0.5 * response(([1.0], [tau, 1.0]))
    (told,) = said(x + noise(0.01), leave_out=("delay",))
    assert line in told and f"Hold a constant input for {34 if tau == 10 else 60} s to " in told


def test_a_drift_of_the_sensor_is_not_called_creep(plain):
    record, found = plain
    assert not any("Creep" in line for line in said(record.displacement + 0.05 * TIME / 20, leave_out=("delay",)))
    assert found.remarks == ()


def test_a_coefficient_without_influence_is_named():
    """Driven far below its resonance the mass hides in the noise; of the rest the damping is known worst."""
    slow = chirp(TIME, 0.05, TIME[-1], 0.25, phi=-90)
    lines = said(response(MODE, slow) + noise(0.1, 3), slow, order=2, leave_out=("delay",), hold="foh")
    assert any("Not known, because without influence on these recordings: a2" in line for line in lines)
    assert any(line.startswith("Least certain coefficient: a1 ") and "larger (one" in line for line in lines)


def test_the_weakest_direction_names_what_moves_together():
    """Near one frequency spring and mass act as a0 - w^2 a2 alone: both may grow together."""
    near = np.sin(2 * np.pi * (2.0 * TIME + 0.1 * TIME**2 / 20)) * np.minimum(TIME, 1)
    lines = said(response(MODE, near) + noise(1.0, 2), near, order=2, leave_out=("delay",), hold="foh")
    (line,) = (line for line in lines if "Least certain combination" in line)
    assert line.count("% larger") >= 2 and "a0 " in line and " with a2 " in line


def test_a_delay_at_its_bound_is_told():
    slow = chirp(TIME, 0.03, TIME[-1], 0.1, phi=-90)
    late = np.interp(TIME - 5.5, TIME, slow, left=0.0)
    lines = said(response(MODE, late) + noise(0.01), slow, order=1, learn=("delay",), hold="foh")
    assert any("The delay is at its upper limit of 5 s" in line for line in lines)


def test_a_pole_at_its_bound_is_told_in_the_refusal():
    """Order 2 of a plant of order 1 whose lag is three samples, asked for: its second pole runs to the fastest."""
    quick = chirp(TIME, 0.1, TIME[-1], 60.0, phi=-90)
    x = response(([1.0], [3 * DT, 1.0]), quick) + noise(1e-3)
    with pytest.raises(ComputationFailed, match="highest frequency that this sampling can show, 95.5 Hz"):
        identify([Record("r", TIME, quick, x)], input_map="linear", order=2, leave_out=("delay",), hold="foh")


def test_the_displacement_at_0_volts_is_not_known_from_a_bias():
    biased = 3 + CHIRP
    a = np.array([2.0, 0.03, 1 / 180])
    x = 4.5 + response(([1.0], a[::-1]), biased**2 - 9.0) + noise(0.01)
    found = identify([Record("biased", TIME, biased, x)], order=2)
    assert any("the output there is not known" in line for line in found.remarks)
    from_rest = identify([Record("rest", TIME, PUSHED, response(([1.0], a[::-1]), PUSHED**2) + noise(0.01))], order=2)
    assert not any("is not known" in line for line in from_rest.remarks)


def test_auto_hands_back_no_order_that_its_records_leave_open(plain, monkeypatch):
    """Where all samples leave open what their means seemed to tell, the next best order is taken, or none."""
    describe = identification.describe
    record, found = plain
    assert found.chosen.order == 2

    def open_at(*orders):
        def described(candidate, problem: Problem):
            fit = describe(candidate, problem)
            return type(fit)(**{**vars(fit), "poles_known": fit.poles_known and fit.order not in orders})

        monkeypatch.setattr(identification, "describe", described)
        return identify([record], input_map="linear", leave_out=("delay",))

    other = open_at(2).chosen
    assert other.poles_known and other.order != 2
    with pytest.raises(ComputationFailed, match="no order from 1 to 6"):
        open_at(1, 2, 3, 4, 5, 6)
