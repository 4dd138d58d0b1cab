"""What a diagnosis says of plants simulated here, by public names alone, whatever the package is inside."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from test_edge import TOP, reading, response, sweep

import pitp_jax as pitp

RATE, HZ, ZETA, STROKE = 500.0, 7.4, 0.1, 1e-3


def driven(voltage, force=lambda x, v: 0.0, hz=HZ, zeta=ZETA, rate=RATE):
    """Stroke (m) of x'' + 2 zeta w x' + w^2 x = w^2 (u / TOP)^2 + force(x, v), x in strokes, time in 1/w; from rest."""
    steps = 4
    x, v, h, out = 0.0, 0.0, 2 * np.pi * hz / rate / steps, []
    for now, later in zip(voltage, np.append(voltage[1:], voltage[-1]), strict=True):
        out.append(x)
        for k in range(steps):
            u = now + (later - now) * (k + 0.5) / steps
            v += h * ((u / TOP) ** 2 - x - 2 * zeta * v + force(x + h / 2 * v, v))
            x += h * v
    return STROKE * np.array(out)


def played(name, voltage, noise=3e-6, seed=0, **plant):
    x = driven(voltage, **plant)
    rng = np.random.default_rng(seed)
    return pitp.Record(name, np.arange(len(x)) / RATE, voltage, x + noise * rng.standard_normal(len(x)))


@pytest.fixture(scope="module")
def nominal():
    return pitp.identify([reading("sweep", sweep(RATE), RATE)], order=2, hold="foh").model


def sine(hz, top, seconds=6.0):
    t = np.arange(int(seconds * RATE)) / RATE
    return top / 2 * (1 - np.cos(2 * np.pi * hz * t))


@pytest.mark.slow
def test_names_of_files_decide_nothing(nominal):
    """Four sines of one frequency, an end stop beyond 0.15 strokes: the same figures under other names."""
    stop: dict[str, Any] = {"force": lambda x, v: -4.0 * max(x - 0.15, 0.0)}
    drives = [sine(3.0, top, 3.0) for top in (500.0, 800.0, 1100.0, 1500.0)]
    told = []
    for names in ("abcd", "bdac"):
        found = pitp.diagnose(
            nominal, [played(n, u, seed=k, **stop) for k, (n, u) in enumerate(zip(names, drives, strict=True))]
        )
        told.append((found.verdict, found.gap.before, found.gap.after))
    assert len({verdict for verdict, *_ in told}) == 1
    np.testing.assert_allclose([t[1:] for t in told], [told[0][1:]] * 2, rtol=0.02)


@pytest.mark.slow
def test_the_interval_of_what_is_closed_lies_between_minus_one_and_one(nominal):
    """A sweep alone, damping that grows with the stroke: the floor is as large as the gap."""
    rough: dict[str, Any] = {"force": lambda x, v: -2 * ZETA * 12 * x * x * v}
    found = pitp.diagnose(nominal, [played("sweep", sweep(RATE, 6.0), **rough)], refit_nominal=False)
    for ends in [found.gap.ci95, *(row.ci95 for row in found.ranking)]:
        assert ends is None or -1 <= ends[0] <= ends[1] <= 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pulses", "least", "named"),
    [
        (((2900, 2.0),), 0.8, False),  # out of fold one record cannot be foreseen
        (((2900, 2.0), (2800, 2.3), (2850, 2.6)), 0.5, True),
    ],
)
def test_the_error_of_a_number_that_few_pulses_tell_is_not_below_what_noise_allows(nominal, pulses, least, named):
    """A clip at 2600 V, sines below it, pulses of 0.3 s beyond: from `least` Cramer-Rao bounds of its level on."""
    t, noise, rng = np.arange(3000) / RATE, 3e-6, np.random.default_rng(1)
    beyond = [top * np.exp(-(((t - at) / 0.15) ** 2)) for top, at in pulses]

    def clipped(level, u):
        return np.asarray(response((np.minimum(u, level) / TOP) ** 2, HZ, ZETA, RATE))

    records = [
        pitp.Record(f"r{k}", t, u, clipped(2600.0, u) + noise * rng.standard_normal(len(t)))
        for k, u in enumerate([*(sine(hz, 2500.0) for hz in (1.0, 3.0, 6.0, 9.0)), *beyond])
    ]
    found = pitp.diagnose(nominal, records)
    assert not named or found.effects[0] == "voltage_clip"
    (number,) = [p for row in found.ranking if row.effect == "voltage_clip" for p in row.parameters.values()]
    bound = noise / np.linalg.norm([clipped(2601.0, u) - clipped(2600.0, u) for u in beyond])
    level, error = 1 / number["value"], number["stderr"] / number["value"] ** 2  # 1 / V is what the row holds
    assert abs(level - 2600) < 5 * bound + 5
    assert least * bound < error < 10 * bound


@pytest.mark.slow
def test_the_next_experiment_goes_no_farther_and_no_faster_than_what_was_played():
    """Damping 0.02, sines below the resonance, an electrode that charges late: once 1.7 times the stroke played."""
    light = {"rate": RATE, "zeta": 0.02}
    model = pitp.identify([reading("sweep", sweep(RATE, top=800.0), **light)], order=2, hold="foh").model
    drives, keep = [sine(hz, TOP) for hz in (0.7, 1.3, 1.9, 2.6)], np.exp(-1 / RATE / 4e-3)

    def moved(u):
        return np.asarray(response((np.asarray(lfilter([1 - keep], [1, -keep], u)) / TOP) ** 2, **light))

    rng = np.random.default_rng(0)
    records = [
        pitp.Record(f"r{k}", np.arange(len(u)) / RATE, u, moved(u) + 3e-6 * rng.standard_normal(len(u)))
        for k, u in enumerate(drives)
    ]
    proposed = pitp.diagnose(model, records).next_experiment
    assert proposed is not None and proposed.voltage.max() > 0.3 * TOP
    assert moved(proposed.voltage).max() < 1.1 * max(r.displacement.max() for r in records)
    steepest = max(np.abs(np.diff(u)).max() for u in drives)
    assert np.abs(np.diff(proposed.voltage)).max() <= steepest * (1 + 1e-6)


@pytest.mark.slow
def test_a_long_record_is_diagnosed_to_its_end():
    """300,000 samples, a resonance that the sweep reaches in the last sixth: the gap is that of the whole record."""
    rate, hz = 10_000.0, 50.0
    clean = reading("clean", sweep(2000.0, 12.0, 1.0, 100.0), 2000.0, hz=hz, zeta=0.05)
    model = pitp.identify([clean], order=2, hold="foh").model
    record = reading("sweep", sweep(rate, 30.0, 1.0, 60.0), rate, hz=hz, zeta=0.08, noise=3e-6)
    whole = pitp.e_rms_percent(pitp.predict(model, [record])[0].displacement, record.displacement)
    told = pitp.diagnose(model, [record], seconds=1.0).gap.before
    assert told == pytest.approx(whole, rel=0.1)


@pytest.mark.slow
def test_slow_noise_is_in_the_error_of_a_zero_read_at_rest():
    """AR(0.98) noise of 0.5 % of range, twelve draws: estimates miss by at most twice what they say, rms."""
    misses, (u, rng) = [], (sweep(RATE, 8.0), np.random.default_rng(0))
    for _ in range(12):
        n = lfilter([np.sqrt(1 - 0.98**2)], [1, -0.98], rng.standard_normal(len(u) + 1000))[1000:]
        clean = reading("sweep", u, RATE)
        record = replace(clean, displacement=clean.displacement + 5e-3 * np.ptp(clean.displacement) * n)
        begun = pitp.identify([record], order=2, hold="foh").beginnings["sweep"]
        misses.append(begun.zero / begun.stderr)
    assert np.sqrt(np.mean(np.square(misses))) < 2
