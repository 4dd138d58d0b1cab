"""What a diagnosis says of plants simulated here, by public names alone, whatever the package is inside."""

from typing import Any

import numpy as np
import pytest
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
    drives = [sine(3.0, top) for top in (500.0, 800.0, 1100.0, 1500.0)]
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
    found = pitp.diagnose(nominal, [played("sweep", sweep(RATE), **rough)])
    for ends in [found.gap.ci95, *(row.ci95 for row in found.ranking)]:
        assert ends is None or -1 <= ends[0] <= ends[1] <= 1


@pytest.mark.slow
def test_the_error_of_a_number_that_few_pulses_tell_is_not_below_what_noise_allows(nominal):
    """A clip at 2600 V that three pulses of 0.3 s meet: at least half of the Cramer-Rao bound of its level."""
    t = np.arange(3000) / RATE
    pulses = [top * np.exp(-(((t - at) / 0.15) ** 2)) for top, at in ((2900, 2.0), (2800, 2.3), (2850, 2.6))]
    drives = [sine(hz, 2500.0) for hz in (1.0, 3.0, 6.0, 9.0)] + pulses
    noise = 3e-6

    def clipped(level, u):
        return np.asarray(response((np.minimum(u, level) / TOP) ** 2, HZ, ZETA, RATE))

    rng = np.random.default_rng(1)
    records = [
        pitp.Record(f"r{k}", t, u, clipped(2600.0, u) + noise * rng.standard_normal(len(t)))
        for k, u in enumerate(drives)
    ]
    found = pitp.diagnose(nominal, records)
    assert found.effects[0] == "voltage_clip"
    (told,) = [p for row in found.ranking if row.effect == "voltage_clip" for p in row.parameters.values()]
    slope = np.concatenate([clipped(2601.0, u) - clipped(2600.0, u) for u in pulses])
    bound = noise / np.sqrt((slope**2).sum())
    level, error = 1 / told["value"], told["stderr"] / told["value"] ** 2  # 1 / V is what the row holds
    assert abs(level - 2600) < 5 * bound + 5
    assert 0.5 * bound < error < 10 * bound
