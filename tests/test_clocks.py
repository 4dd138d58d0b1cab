"""Clocks that users bring: uneven loops, packets, overflows, rows out of order; read beside the true motion."""

import numpy as np
import pytest
from record_files import refused, save_npz

from pitp_jax import read, read_voltage

NOISE = 1e-4
T_END = 20.0


def command(t):
    """A chirp from 0.2 to 4 Hz, in rad."""
    return np.sin(2 * np.pi * (0.2 * t + 0.095 * t**2))


def motion(t):
    """An output that differs from the command and is smooth, in rad."""
    return 0.7 * np.sin(2 * np.pi * (0.2 * (t - 0.02) + 0.095 * (t - 0.02) ** 2)) + 0.1


def log(path, true, stamps=None, **changes):
    """A log of rows taken at the true times, with the stamps that were written."""
    noise = NOISE * np.random.default_rng(5).standard_normal(len(true))
    stamps = true if stamps is None else stamps
    save_npz(path, {"time_s": stamps, "command_rad": command(true), "angle_rad": motion(true) + noise, **changes})
    return path


def off(record, late=0.0):
    """The rms difference of a record from the true motion."""
    seen = record.observed
    return float(np.std(record.displacement[seen] - motion(record.time[seen] - late)))


def loop(low, high, seed=0):
    t = np.cumsum(np.random.default_rng(seed).uniform(low, high, 4000))
    return t[t < T_END]


def packets(size, stamp):
    """True times at 250 Hz, and stamps of the arrival of packets."""
    true = np.arange(5000 // size * size) / 250
    arrival = np.repeat(true[size - 1 :: size], size)
    arrival += np.repeat(np.random.default_rng(1).uniform(0, 3e-3, len(true) // size), size)
    return true, arrival + stamp * np.tile(np.arange(size), len(true) // size)


@pytest.mark.parametrize("steps", [(0.015, 0.035), (0.012, 0.039), (0.0055, 0.018)])
def test_an_uneven_loop_is_resampled_on_its_median_step(tmp_path, steps):
    t = loop(*steps)
    (record,) = read(log(tmp_path / "a.npz", t))
    assert record.dt == pytest.approx(np.median(np.diff(t)))
    assert record.time[-1] - record.time[0] == pytest.approx(np.ptp(t), abs=record.dt)
    assert off(record) < 0.01
    assert f"{len(t)} rows of an uneven clock resampled" in record.recognised["remarks"][0]
    (record,) = read(tmp_path / "a.npz", rate=100)
    assert record.dt == pytest.approx(0.01) and off(record) < 0.01


def test_the_command_is_held_when_it_is_resampled(tmp_path):
    """The held command keeps its integral, so that a slow plant answers as it did."""
    t = loop(0.015, 0.035)
    held = np.random.default_rng(3).standard_normal(len(t))
    (record,) = read(log(tmp_path / "a.npz", t, command_rad=held))
    truth = np.append(0.0, np.cumsum(held[:-1] * np.diff(t)))
    ours = np.cumsum(record.voltage)[:-1] * record.dt
    np.testing.assert_allclose(ours, np.interp(record.time[1:], t, truth), atol=1e-9)


def test_a_stall_masks_the_output_and_a_long_one_splits(tmp_path):
    t = loop(0.004, 0.009)
    stalls = np.append(0.0, np.cumsum(np.where(np.arange(len(t) - 1) % 500 == 400, 0.014, 0.0)))
    (record,) = read(log(tmp_path / "a.npz", t + stalls))
    assert 3 < record.missing < 40 and off(record) < 2e-3
    assert "masked" in " ".join(record.recognised["remarks"])
    t[1000:] += 0.5
    first, second = read(log(tmp_path / "a.npz", t))
    assert second.time[0] - first.time[-1] > 0.5 and first.dt == second.dt
    assert max(off(first), off(second)) < 2e-3
    pause = np.arange(len(t)) > 1000
    still = np.where(pause, 0.0, command(t)) * (np.arange(len(t)) < 998)
    assert len(read(log(tmp_path / "a.npz", t, command_rad=still))) == 1  # the command did not move in the gap


def test_gaps_everywhere_are_refused(tmp_path):
    t = loop(0.004, 0.009)
    t += 0.5 * (np.arange(len(t)) // 50)
    assert "less than half of the rows" in refused(log(tmp_path / "a.npz", t))


def test_uneven_files_of_a_set_share_one_rate(tmp_path):
    for k in range(3):
        log(tmp_path / f"{k}.npz", loop(0.015, 0.033 + 0.002 * k, seed=k))
    first, *others = read(tmp_path)
    assert all(other.dt == pytest.approx(first.dt, rel=1e-12) for other in others)
    log(tmp_path / "even.npz", np.arange(0, T_END, 0.02))
    assert {round(record.dt, 12) for record in read(tmp_path)} == {0.02}


@pytest.mark.parametrize(("size", "stamp"), [(2, 2e-4), (5, 0.0), (10, 2e-4), (25, 0.0), (40, 2e-4)])
def test_packets_are_spread_evenly(tmp_path, size, stamp):
    true, arrival = packets(size, stamp)
    (record,) = read(log(tmp_path / "a.npz", true, arrival))
    assert record.samples == len(true) and 1 / record.dt == pytest.approx(250, rel=2e-3)
    assert "packets" in record.recognised["remarks"][0]
    (record,) = read(tmp_path / "a.npz", rate=250)
    assert 1 / record.dt == pytest.approx(250, rel=1e-9)
    shift = float(np.mean(record.time - true))
    assert off(record, shift) < 0.01


def test_a_packet_that_did_not_come_is_lost(tmp_path):
    true, arrival = packets(5, 2e-4)
    kept = np.setdiff1d(np.arange(len(true)), np.r_[2000:2005, 3000:3005])
    (record,) = read(log(tmp_path / "a.npz", true[kept], arrival[kept]))
    assert record.samples == len(true) and record.recognised["lost"] == 10


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_rows_that_a_counter_skips_are_lost(tmp_path, bits):
    """Without a clock, at a stated rate: the last rows came 0.5 s early. A counter that steps by ten is not used."""
    t = np.arange(4000) / 200
    kept = np.setdiff1d(np.arange(len(t)), np.r_[500:505, 1800:1890, 3000:3005])
    numbers = ((kept + 2**bits - 700) % 2**bits).astype(float)
    values = {"command_rad": command(t[kept]), "angle_rad": motion(t[kept])}
    save_npz(tmp_path / "a.npz", {"seq": numbers, **values})
    parts = read(tmp_path / "a.npz", rate=200)
    assert [r.samples for r in parts] == [500, 1295, 1110, 995]
    assert [float(r.time[0]) for r in parts] == pytest.approx(t[[0, 505, 1890, 3005]])
    assert max(off(r) for r in parts) < 1e-9
    save_npz(tmp_path / "b.npz", {"seq": 10.0 * np.arange(len(kept)), **values})
    assert read(tmp_path / "b.npz", rate=200)[0].samples == len(kept)


def test_a_few_packets_do_not_determine_the_rate(tmp_path):
    true, arrival = packets(40, 0.0)
    message = refused(log(tmp_path / "a.npz", true[:400], arrival[:400]))
    assert "--rate RATE" in message
    assert 1 / read(tmp_path / "a.npz", rate=250)[0].dt == pytest.approx(250)


def test_a_loop_that_pauses_sends_no_packets(tmp_path):
    t = loop(0.004, 0.009)
    t += 60.0 * (np.arange(len(t)) // 1000)
    assert len(read(log(tmp_path / "a.npz", t))) == len(t) // 1000 + (len(t) % 1000 >= 64)


@pytest.mark.parametrize(
    ("bits", "tick", "rate"), [(32, 1e-6, 200), (16, 1e-3, 100), (16, 1e-6, 2000), (32, 1e-3, 50), (32, 1e-9, 200)]
)
@pytest.mark.parametrize("signed", [False, True])
def test_a_counter_that_overflows_goes_on(tmp_path, bits, tick, rate, signed):
    t = np.arange(2000) / rate
    lowest = -(2 ** (bits - 1)) if signed else 0
    counts = (np.round((t - 0.4 * t[-1]) / tick).astype(np.int64)) % 2**bits + lowest
    (record,) = read(log(tmp_path / "a.npz", t, counts * tick))
    np.testing.assert_allclose(record.time - record.time[0], t, atol=2 * tick)
    assert "of the clock's counter, made continuous" in record.recognised["remarks"][0]
    assert record.samples == len(t) and off(record, record.time[0]) < 2 * NOISE


def test_a_clock_that_starts_again_is_refused_or_overruled(tmp_path):
    t = np.arange(1300) / 200
    stamps = np.where(t < 3.5, t, t - 3.48)
    assert "decreases" in refused(log(tmp_path / "a.npz", t, stamps))
    (record,) = read(tmp_path / "a.npz", rate=200)
    np.testing.assert_allclose(record.time, t, atol=1e-9)
    assert "timed by --rate instead of the clock" in record.recognised["remarks"][0]


def test_rows_that_overtook_one_another_are_sorted(tmp_path):
    t = np.arange(3000) / 200
    order = np.arange(3000)
    order[500:503], order[1700:1702] = [502, 500, 501], [1701, 1700]
    (record,) = read(log(tmp_path / "a.npz", t[order]))
    np.testing.assert_allclose(record.time, t)
    assert off(record) < 2 * NOISE and "5 rows not in the order of time" in record.recognised["remarks"][0]


def test_a_clock_that_was_set_back_keeps_the_order_of_its_rows(tmp_path):
    t = np.arange(3000) / 200
    stamps = t + np.where((t > 5) & (t < 5.05), -0.012, 0.0)
    (record,) = read(log(tmp_path / "a.npz", t, stamps))
    assert record.samples == 3000 and off(record) < 0.01


def test_least_and_greatest_of_one_time_are_averaged(tmp_path):
    rng, t = np.random.default_rng(2), np.arange(1000) / 200
    twice, spread = np.repeat(t, 2), np.tile([-1e-3, 1e-3], 1000)
    spread = spread + 1e-4 * rng.standard_normal(2000)
    path = log(tmp_path / "a.npz", twice, angle_rad=motion(twice) + spread, command_rad=command(twice) + spread)
    (record,) = read(path)
    np.testing.assert_allclose(record.time, t)
    assert off(record) < 2e-4 and record.recognised["jitter"] < 1e-9
    assert "1000 rows with the time of the row before, averaged with it" in record.recognised["remarks"][0]


def test_one_time_that_stands_twice_among_many(tmp_path):
    t = np.arange(2000) / 200
    twice = np.sort(np.append(t, t[[300, 900]]))
    (record,) = read(log(tmp_path / "a.npz", twice))
    assert record.samples == 2000 and off(record) < 2 * NOISE


def test_the_rate_is_taken_with_an_even_clock(tmp_path):
    """1 kHz to 100 Hz: ten rows a step are averaged, so that the noise of the sensor falls."""
    t = np.arange(0, 10, 1e-3)
    (record,) = read(log(tmp_path / "a.npz", t), rate=100)
    assert record.dt == pytest.approx(0.01) and off(record) < 0.6 * NOISE + 2e-4
    assert "resampled as --rate asks" in record.recognised["remarks"][0]


def test_a_voltage_alone_may_have_an_uneven_clock(tmp_path):
    t = loop(0.015, 0.035)
    save_npz(tmp_path / "a.npz", {"time_s": t, "voltage_V": command(t)})
    (drive,) = read_voltage(tmp_path / "a.npz")
    assert np.ptp(np.diff(drive.time)) < 1e-9 and any("uneven" in remark for remark in drive.remarks)
