"""The evidence of out-of-fold residuals: one variance per record, paired draws of records and of blocks within them."""

import numpy as np
import pytest
from typed import some

from pitp_jax.method.diagnose.evidence import evidence, probability
from pitp_jax.method.diagnose.gap import interval

FLOORS = np.full(3, 1e-6)


def noise(sizes, scale, seed=0):
    rng = np.random.default_rng(seed)
    return [s * rng.standard_normal(n) for n, s in zip(sizes, scale, strict=True)]


def test_the_score_is_the_geometric_mean_over_records():
    rows = noise((4000, 4000, 4000), (1.0, 10.0, 100.0))
    assert evidence(rows, FLOORS).rms == pytest.approx(10.0, rel=0.05)


def test_a_large_record_does_not_decide_alone():
    """Better by a half in two of three records, worse by a tenth in the one whose squares are most of all."""
    sizes = (3000, 3000, 3000)
    first = noise(sizes, (0.5, 0.5, 110.0))
    second = noise(sizes, (1.0, 1.0, 100.0), 1)
    assert sum(np.sum(r**2) for r in first) > sum(np.sum(r**2) for r in second)
    assert evidence(first, FLOORS).score < evidence(second, FLOORS).score


def test_what_one_record_knows_is_not_sure():
    """A second effect that a single record shows: draws without that record do not see it."""
    sizes = (2000, 2000, 2000)
    base = noise(sizes, (1.0, 1.0, 1.0))
    helped = [base[0] * 0.5, base[1], base[2]]
    everywhere = [r * 0.5 for r in base]
    assert probability(evidence(helped, FLOORS), evidence(base, FLOORS), 0.99) < 0.8
    assert probability(evidence(everywhere, FLOORS), evidence(base, FLOORS), 0.9) == 1.0


def test_what_one_stretch_knows_is_not_sure():
    """One of thirty stretches is explained, the others a little less: (1 - 1/30)^30 of the draws lack it."""
    base = noise((3000,), (1.0,))[0]
    helped = np.where(np.arange(3000) < 100, 0.1, 1.001) * base
    p = probability(evidence([helped], FLOORS[:1]), evidence([base], FLOORS[:1]))
    assert p == pytest.approx(1 - (1 - 1 / 30) ** 30, abs=0.03)


def test_records_of_unequal_length_are_compared():
    """Numbers of blocks differ from record to record."""
    sizes = (400, 5000, 90)
    base = noise(sizes, (1.0, 2.0, 3.0))
    assert probability(evidence([0.5 * r for r in base], FLOORS), evidence(base, FLOORS)) == 1.0
    assert probability(evidence(base, FLOORS), evidence(base, FLOORS)) == 0.0


def test_missing_samples_do_not_count():
    rows = noise((1000, 1000, 1000), (1.0, 1.0, 1.0))
    holes = [np.where(np.arange(1000) % 3 == 0, np.nan, r) for r in rows]
    assert evidence(holes, FLOORS).rms == pytest.approx(1.0, rel=0.05)


def test_equals_are_even():
    """Noise of one size on either side, drawn apart: P is spread about a half."""
    found = []
    for seed in range(30):
        a, b = (evidence(noise((500, 500, 500), (1.0, 1.0, 1.0), 2 * seed + k), FLOORS) for k in (0, 1))
        found.append(probability(a, b))
    assert 0.3 < np.mean(found) < 0.7 and np.std(found) > 0.15


def test_of_two_records_parts_are_drawn():
    """A set that mends one of two records: drawn whole, that record is missing in every fourth draw."""
    base = noise((600, 600), (1.0, 1.0))
    mended = [base[0], 0.2 * base[1]]
    for parts, sure in ((1, 3 / 4), (2, 15 / 16)):
        after, before = (evidence(rows, FLOORS[:2], parts=parts) for rows in (mended, base))
        assert probability(after, before, 0.9) == pytest.approx(sure, abs=0.03)
        assert after.score == pytest.approx(2 * np.log(0.2) / 2, abs=0.1)


def test_the_interval_of_what_is_closed_holds_the_truth():
    """The errors of eight recordings vary by a third: of 100 sets the interval holds 0.7 in 89, one of 50 % in 48."""
    rng, held = np.random.default_rng(0), 0
    for _ in range(100):
        sizes = np.exp(0.3 * rng.standard_normal((2, 8))) * [[1.0], [0.3]]
        rows = [[s * rng.standard_normal(120) for s in row] for row in sizes]
        before, after = (evidence(r, np.full(8, 1e-9)) for r in rows)
        low, high = some(interval(before, after, np.ones(8), 0.0))
        held += low <= 0.7 <= high
    assert held >= 82
