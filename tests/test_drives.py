"""Which records stand for all: even in line and strength, and every kind."""

import numpy as np
import pytest

from pitp_jax import Record
from pitp_jax.application.check.one_record import facts
from pitp_jax.application.plan.excitation import multisine, sine, steps, sweep
from pitp_jax.method.signal.excitation_kind import kind, loudest, spread_over_kinds

DT = 1e-3


def of(name, waveform):
    time = np.arange(4000) * DT
    voltage = np.asarray(waveform(time) if callable(waveform) else waveform)
    return Record(name, time, voltage, np.zeros(len(time)))


def tone(hertz, amplitude):
    return of(f"{hertz:g}Hz_{amplitude:g}", lambda t: amplitude * (1 + np.sin(2 * np.pi * hertz * t)))


GRID = [tone(f, a) for f in range(1, 13) for a in (100.0, 200.0, 300.0)]


@pytest.mark.parametrize("hertz", [1.0, 7.0, 33.0])
def test_the_loudest_line(hertz):
    assert loudest(tone(hertz, 100.0)) == pytest.approx(hertz, abs=0.26)
    assert kind(tone(hertz, 100.0)) == "sine"


RATE, LEVELS = 1 / DT, [3.0, 1.0, 2.0, 0.5, 2.5]
UP = sweep(0.5, 10.0, 10.0, RATE, 1.0, 1.0)[1]
KINDS = [
    ("sweep", sweep(0.1, 20.0, 20.0, RATE, 1.0, 1.0, rest_s=20.0)[1]),
    ("sweep", sweep(5.0, 10.0, 20.0, RATE, 1.0, 1.0, rest_s=3.0)[1]),
    ("sweep", np.hanning(len(UP)) * UP),
    ("sweep", np.concatenate([UP, UP[::-1]])),
    ("sweep", UP[::-1]),
    ("sine", sine(3.0, 10.0, RATE, 1.0, 1.0, rest_s=20.0)[1]),
    ("sine", np.append(np.zeros(9000), sine(0.5, 6.0, RATE, 1.0, 1.0)[1])),
    ("sine", sine(0.1, 20.0, RATE, 1.0, 1.0)[1]),
    ("steps", steps(LEVELS, 1.0, RATE, rise=0.05, rest_s=30.0)[1]),
    ("steps", steps([1.0], 5.0, RATE, rise=0.1, rest_s=20.0)[1]),
    ("steps", steps(list(range(1, 9)), 1.0, RATE, rise=0.1)[1]),
    ("steps", np.sign(np.sin(0.9 * np.arange(5000) + 0.1))),
    ("broadband", multisine((1.0, 10.0), 8.0, RATE, 1.0, 1.0, seed=4, rest_s=10.0)[1]),
]


@pytest.mark.parametrize(("wanted", "voltage"), KINDS)
def test_rests_do_not_change_the_kind_of_an_input(wanted, voltage):
    """Nor a taper, a second pass in reverse, or a third of a decade instead of two."""
    record = Record("a", np.arange(len(voltage)) * DT, voltage, np.zeros(len(voltage)))
    assert kind(record) == wanted


def test_noise_is_no_sweep():
    """Of 200 random courses none passes, whatever their band."""
    rng = np.random.default_rng(0)
    found = [kind(of("noise", np.convolve(rng.standard_normal(4400), np.hanning(n), "valid")[:4000])) for n in
             np.tile((5, 20, 80, 300), 50)]  # fmt: skip
    assert "sweep" not in found


def test_only_steps_may_have_few_samples_a_period():
    """A square wave of 7 samples a period is sampled at its flanks, a sine of 7 is coarse."""
    answer = np.random.default_rng(1).standard_normal(4000)
    sines = 100 * np.sin(2 * np.pi * np.arange(4000) / 7 + 0.1)
    said = [" ".join(facts(Record("a", np.arange(4000) * DT, u, answer)).problems) for u in (sines, np.sign(sines))]
    assert "samples in a period" in said[0] and "samples in a period" not in said[1]


def test_all_are_kept_where_they_fit():
    assert spread_over_kinds(GRID, 36) == list(range(36))
    assert spread_over_kinds(GRID[:3], 10) == [0, 1, 2]


@pytest.mark.parametrize("count", [6, 12, 18])
def test_the_chosen_cover_the_grid(count):
    """Every amplitude has its share, no gap along the frequency is wide, and neighbours differ."""
    chosen = spread_over_kinds(GRID, count)
    assert len(set(chosen)) == count and chosen == sorted(chosen)
    hertz, amplitudes = np.array(chosen) // 3, np.array(chosen) % 3
    assert np.bincount(amplitudes, minlength=3).min() >= count // 6
    assert np.diff([-1, *np.unique(hertz), 12]).max() <= max(18 // count + 1, 2)
    assert len({(a, b) for a, b in zip(amplitudes[:-1], amplitudes[1:], strict=True)}) >= 3


def test_a_drive_of_its_own_kind_is_among_the_first():
    still = of("steps", np.repeat([0.0, 300.0, 100.0, 200.0], 1000))
    assert kind(still) == "steps"
    assert 36 in spread_over_kinds([*GRID, still], 3)


def test_equal_records_are_chosen_once():
    assert spread_over_kinds([GRID[4]] * 5, 3) == sorted(set(spread_over_kinds([GRID[4]] * 5, 3)))
