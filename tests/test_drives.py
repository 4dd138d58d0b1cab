"""Which records stand for all: even in line and strength, and every kind."""

import numpy as np
import pytest

from pitp_jax import Record
from pitp_jax._record.excitation_kind import kind, loudest, spread_over_kinds

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
