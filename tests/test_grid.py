"""Jitter and lost samples onto the uniform grid; what is worse is refused."""

import numpy as np
import pytest
from record_files import refused, save_csv, save_npz

from pitp_jax import read

COUNT = 2000
TIME = np.arange(COUNT) / 1000


def signals(t):
    """A drive of 5 Hz, and an output smooth enough to be known between its samples."""
    return 1000 + 500 * np.sin(2 * np.pi * 5 * t), 1e-3 * np.sin(2 * np.pi * 5 * t + 0.3)


def write(path, t, clock=None, **changes):
    u, x = signals(t)
    save_npz(path, {"time_s": t if clock is None else clock, "voltage_V": u, "displacement_m": x, **changes})
    return path


@pytest.mark.parametrize("size", [0.02, 0.1, 0.3, 0.49])
def test_jitter_of_up_to_half_a_sample_is_put_on_the_grid(tmp_path, size):
    t = TIME + size * 1e-3 * np.random.default_rng(0).uniform(-1, 1, COUNT)
    (record,) = read(write(tmp_path / "a.npz", t))
    assert record.samples == COUNT and record.missing == 0
    assert np.ptp(np.diff(record.time)) < 1e-9
    np.testing.assert_allclose(record.time, TIME, atol=1e-4 * size)
    u, x = signals(record.time)
    np.testing.assert_allclose(record.voltage[1:-1], u[1:-1], atol=500 * 1e-3)
    np.testing.assert_allclose(record.displacement[1:-1], x[1:-1], atol=1e-3 * 1e-3)
    assert record.recognised["jitter"] == pytest.approx(size, rel=0.2)
    assert "jitters" in record.recognised["remarks"][0]


def test_an_hour_of_a_clock_within_one_percent_is_left_as_it_is(tmp_path):
    t = TIME + 0.9e-5 * np.random.default_rng(0).uniform(-1, 1, COUNT)
    (record,) = read(write(tmp_path / "a.npz", t))
    np.testing.assert_array_equal(record.time, t)
    assert record.recognised["remarks"] == []


def test_times_rounded_to_equal_ones_keep_their_samples(tmp_path):
    t = np.arange(COUNT) / 2000 + 1e-9
    u, x = signals(t)
    (record,) = read(write(tmp_path / "a.npz", t, clock=np.round(t, 3)))
    np.testing.assert_array_equal(record.displacement, x)
    assert record.dt == pytest.approx(1 / 2000, rel=1e-3)


@pytest.mark.parametrize("lost", [[700], [100, 101, 102, 1500], list(range(300, 315))])
def test_lost_samples_are_filled_in_as_missing(tmp_path, lost):
    keep = np.setdiff1d(np.arange(COUNT), lost)
    (record,) = read(write(tmp_path / "a.npz", TIME[keep]))
    assert record.samples == COUNT
    np.testing.assert_array_equal(np.flatnonzero(~record.observed), lost)
    u, x = signals(TIME)
    np.testing.assert_allclose(record.displacement[keep], x[keep], atol=1e-12)
    np.testing.assert_allclose(record.voltage, u, atol=20 if len(lost) > 4 else 5)
    assert record.recognised["lost"] == len(lost)


def test_a_gap_longer_than_a_tenth_of_the_drives_period_splits_the_record(tmp_path):
    keep = np.setdiff1d(np.arange(COUNT), np.arange(900, 925))  # 25 ms of 200
    first, second = read(write(tmp_path / "a.npz", TIME[keep]))
    assert (first.name, second.name) == ("a.1", "a.2")
    assert (first.samples, second.samples) == (900, 1075)
    assert second.time[0] == pytest.approx(0.925)
    keep = np.setdiff1d(keep, np.arange(950, COUNT))
    (alone,) = read(write(tmp_path / "a.npz", TIME[keep]))
    assert alone.samples == 900 and "25 samples of pieces that are too short" in alone.recognised["remarks"][-1]


def test_a_gap_of_years_takes_no_memory(tmp_path):
    t = TIME.copy()
    t[1000:] += 3e8
    assert len(read(write(tmp_path / "a.npz", t))) == 2


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda t: t[::-1], "decreases"),
        (lambda t: np.where(np.arange(COUNT) >= 500, t - 0.2, t), "decreases"),
        (lambda t: np.cumsum(np.random.default_rng(0).uniform(0, 2e-3, COUNT)), "not uniform"),
        (lambda t: np.zeros(COUNT), "repeat the time of the row before"),
        (lambda t: t * 1e300, "is not a possible time"),
    ],
    ids=["backwards", "back", "random", "still", "endless"],
)
def test_what_is_no_clock_is_refused(tmp_path, change, word):
    assert word in refused(write(tmp_path / "a.npz", TIME, clock=change(TIME)))


def test_missing_output_stays_missing_on_the_grid(tmp_path):
    t = TIME + 2e-4 * np.random.default_rng(0).uniform(-1, 1, COUNT)
    x = signals(t)[1]
    x[400:430] = np.nan
    (record,) = read(write(tmp_path / "a.npz", t, displacement_m=x))
    np.testing.assert_array_equal(np.flatnonzero(~record.observed), np.arange(400, 430))


def test_dates_and_hours_count_as_time(tmp_path):
    for form in ("%Y-%m-%d %H:%M:%S.{ms:03d}", "%d.%m.%Y %H:%M:%S,{ms:03d}", "%H:%M:%S.{ms:03d}"):
        import datetime

        start = datetime.datetime(2026, 11, 23, 23, 59, 59, 500_000)
        stamps = [start + datetime.timedelta(milliseconds=k) for k in range(COUNT)]
        u, x = signals(TIME)
        text = [s.strftime(form).format(ms=s.microsecond // 1000) for s in stamps]
        quoted = [f'"{s}"' for s in text]
        save_csv(tmp_path / "a.csv", {"Zeit": quoted, "U [V]": u, "Weg [m]": x})
        (record,) = read(tmp_path / "a.csv")
        np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-6)
        assert "dates and hours" in record.recognised["time"]


def test_a_row_that_stands_twice_is_left_out(tmp_path):
    twice = np.sort(np.append(np.arange(COUNT), [500, 900]))
    (record,) = read(write(tmp_path / "a.npz", TIME[twice]))
    assert record.samples == COUNT and record.dt == pytest.approx(1e-3, rel=1e-9)
    assert record.recognised["remarks"] == ["a: 2 rows equal to the row before, removed"]


@pytest.mark.parametrize("rate", [700, 800, 900, 1500, 2000])
def test_a_clock_in_whole_milliseconds_loses_no_rows(tmp_path, rate):
    """At 700 Hz it steps by 1 and 2 ms, as a clock of 1 kHz does that loses rows."""
    time = np.arange(COUNT) / rate
    (record,) = read(write(tmp_path / "a.npz", time, np.floor(time * 1e3) / 1e3))
    assert record.samples == COUNT and 1 / record.dt == pytest.approx(rate, rel=1e-4)


def test_too_few_rows_without_those_that_stand_twice(tmp_path):
    """Refused in one line, whatever the name of the file would do to a terminal."""
    twice = np.sort(np.append(np.arange(60), np.arange(10)))
    message = refused(write(tmp_path / "a\x1b[2Jb.npz", TIME[twice]))
    assert "60 in all" in message and message.isprintable()


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("every", [3, 4, 7])
def test_rows_lost_in_turn_are_missing_rows(tmp_path, every, noise):
    """Every third row lost looks like 667 Hz in whole ms: the signals tell which it is."""
    kept = np.arange(COUNT) % every != every - 1
    u, x = signals(TIME)
    x = x + noise * 1e-3 * np.random.default_rng(every).standard_normal(COUNT)
    steps = np.where(np.sin(2 * np.pi * TIME) > 0, 1000.0, 0.0)
    for drive in (u, steps):
        save_npz(tmp_path / "a.npz", {"time_s": TIME[kept], "voltage_V": drive[kept], "displacement_m": x[kept]})
        (record,) = read(tmp_path / "a.npz")
        assert record.dt == pytest.approx(1e-3) and record.recognised["lost"] == record.missing
        assert record.missing == pytest.approx(COUNT / every, abs=1)
