"""Pieces of long sets: what repeats is taken once, what differs at least once, and never more than a run may take."""

import numpy as np
import pytest
from played import nominal_of

import pitp_jax as pitp
from pitp_jax.method.diagnose import data, pieces

RATE = 200.0


@pytest.fixture(scope="module")
def nominal(linear):
    return nominal_of(linear)


def sine(hz, top, samples, start=0.0):
    t = start + np.arange(samples) / RATE
    return t, top / 2 * (1 - np.cos(2 * np.pi * hz * t))


def recorded(name, t, u):
    return pitp.Record(name, t, u, 1e-6 * u)


def test_a_short_set_is_searched_whole(nominal):
    records = [recorded(str(k), *sine(2.0, 500.0 + k, 1000)) for k in range(4)]
    found, cut = pieces.cut(nominal, records)
    assert cut is None and list(found) == records


def test_of_sines_that_repeat_every_size_and_frequency_is_taken(nominal, monkeypatch):
    """Sixty recordings of 10 s, of three sizes and two frequencies; a run may take a tenth of them."""
    monkeypatch.setattr(pieces, "RUN_STEPS", 12_000)
    kinds = [(hz, top) for hz in (1.0, 4.0) for top in (300.0, 600.0, 1000.0)]
    records = [recorded(str(k), *sine(*kinds[k % 6], 2000)) for k in range(60)]
    found, cut = pieces.cut(nominal, records)
    assert cut is not None and len(cut) == len(found) >= 6
    assert {kinds[int(r.name) % 6] for r in found} == set(kinds)
    k = data.thinning(nominal, data.slots_of(nominal)[0], records, np.inf)
    assert sum(r.samples for r in found) <= 12_000 * k


def test_a_small_stretch_of_a_long_recording_is_found(nominal, monkeypatch):
    """Half an hour at one amplitude, but for half a minute at a quarter of it and at four times the frequency."""
    monkeypatch.setattr(pieces, "RUN_STEPS", 12_000)
    t, u = sine(0.5, 1000.0, 360_000)
    part = slice(200_000, 206_000)
    u[part] = sine(2.0, 250.0, 6000)[1]
    found, cut = pieces.cut(nominal, [recorded("long", t, u)])
    assert cut is not None and len(cut) >= 6
    for piece, r in zip(cut, found, strict=True):
        assert r.name == piece.record == "long"
        assert (r.time[0], r.time[-1]) == pytest.approx((piece.from_s, piece.to_s))
        at = int(round(piece.from_s * RATE))
        np.testing.assert_array_equal(r.voltage, u[at : at + r.samples])
    assert any(p.from_s < part.stop / RATE and p.to_s > part.start / RATE for p in cut)


@pytest.mark.slow
def test_pieces_of_four_recordings_are_left_out_by_recording(nominal, monkeypatch):
    monkeypatch.setattr(pieces, "RUN_STEPS", 3000)
    records = [recorded(str(k), *sine(1.0 + k, 300.0 + 100 * k, 8000)) for k in range(4)]
    found, cut = pieces.cut(nominal, records)
    case = data.build_case(nominal, found, whole=records)
    assert cut is not None and len(case.folds) == 4
    for fold in case.folds:
        assert len({case.series[k].record.name for k in fold}) == 1
