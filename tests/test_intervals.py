"""What a diagnosis promises of its figures: intervals that cover, blocks that are many, and what may be explained."""

from dataclasses import replace

import numpy as np
import pytest
from played import SAMPLES, nominal_of, play
from scipy.signal import lfilter

from pitp_jax._diagnose.bootstrap import means, memory
from pitp_jax._diagnose.case import build_case
from pitp_jax._diagnose.effect_selection import Attribution
from pitp_jax._diagnose.evaluation import Judged
from pitp_jax._diagnose.fit import Candidate
from pitp_jax._diagnose.noise import Noise
from pitp_jax._diagnose.result import Gap, _interval, closed
from pitp_jax._diagnose.verdict import rezeroed, verdict
from pitp_jax._effects import lookup

# rms, % of range: of the sensor's noise, of the nominal's gap, of what an effect leaves of it
NOISE, GIVEN, LEFT = 0.3, 3.0, 0.5
DRAWS = 300


@pytest.fixture(scope="module")
def case(linear):
    """Two held-out records where everything counts."""
    nominal = nominal_of(linear)
    built = build_case(nominal, play(nominal, noise=0.0)[:2])
    return replace(built, series=tuple(replace(s, weight=np.ones(SAMPLES), fitted=False) for s in built.series))


def coloured(rng, size, pole=0.9):
    """Two records of an autoregression with this rms: a few samples of it say the same."""
    white = rng.standard_normal((2, SAMPLES + 400))
    return size * np.sqrt(1 - pole**2) * np.asarray(lfilter([1.0], [1.0, -pole], white))[:, 400:]


def judged(errors):
    rms = float(np.sqrt(np.mean(errors**2)))
    return Judged(Candidate((), (), (), np.ones(3), False), tuple(errors), rms, rms)


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.9, 0.97])
def test_a_95_percent_interval_holds_the_truth_in_95_of_100_draws(case, pole):
    rng, truth = np.random.default_rng(2), closed(np.hypot(GIVEN, NOISE), np.hypot(LEFT, NOISE), NOISE)
    held = 0
    for _ in range(DRAWS):
        noise = coloured(rng, NOISE)
        low = NOISE * (1 + 0.03 * rng.standard_normal())
        given, after = (judged(coloured(rng, size, pole) + noise) for size in (GIVEN, LEFT))
        ends = _interval(case, given, after, low, (0, 1), 0.03)
        assert truth is not None and ends is not None
        held += ends[0] <= truth <= ends[1]
    assert 0.92 <= held / DRAWS <= 0.98


def test_blocks_are_drawn_as_the_mean_of_a_record_scatters(case):
    """The bootstrap's standard deviation of a mean of squares is that over fresh draws of the records."""
    rng, told, seen = np.random.default_rng(3), [], []
    for _ in range(200):
        errors = coloured(rng, 1.0)
        seen.append(np.mean(errors**2))
        told.append(means(case, (0, 1), lambda k, e=errors: e[k] ** 2).std())
    assert np.mean(told) == pytest.approx(np.std(seen), rel=0.1)


def test_the_memory_of_a_signal_is_its_integrated_autocorrelation():
    """(1 + p) / (1 - p) of an autoregression, one of white noise or of a constant."""
    rng = np.random.default_rng(5)
    for pole in (0.0, 0.9):
        e = np.asarray(lfilter([1.0], [1.0, -pole], rng.standard_normal(200_000)))
        assert memory(e) == pytest.approx((1 + pole) / (1 - pole), rel=0.1)
    assert memory(np.ones(50)) == 1.0


def found(after, ties=0):
    candidate = Candidate((lookup("stiffening"),), ((0.3,),), (), np.ones(3), False)
    best = Judged(candidate, (), after, after)
    tied = tuple(f"effect {k}" for k in range(ties))
    return Attribution(best, best, (best,), (), best, tied, (), Noise(1e-3, 1e-3, np.zeros((1, 2)), ""))


@pytest.mark.parametrize(
    ("floors", "share", "said"),
    [
        (1.4, 0.6, "explained"), (1.4, 0.45, "unknown"), (2.0, 0.7, "unknown"), (2.0, 0.75, "explained"),
        (3.5, 0.75, "unknown"), (3.5, 0.85, "explained"),
    ],
)  # fmt: skip
def test_what_leaves_more_than_the_floor_must_close_its_share(floors, share, said):
    assert verdict(Gap(10.0, floors, 10.0, 1.0, "", share, None), found(floors), 1.0) == said


@pytest.mark.parametrize(
    ("after", "floor", "share", "level", "ties", "said"),
    [
        (10.5, 9.0, 0.95, 40.0, 0, "unknown"), (9.5, 3.0, 0.95, 40.0, 0, "explained"),  # 10 % of range
        (5.5, 4.0, 0.78, 40.0, 0, "unknown"), (4.5, 4.0, 0.78, 40.0, 0, "explained"),  # 5 % of range
        (2.0, 1.0, 0.9, 1.9, 0, "unknown"), (2.0, 1.0, 0.9, 2.2, 0, "explained"),  # zeros alone do as much
        (1.0, 1.0, 1.0, 1.05, 0, "no_gap"), (1.25, 1.0, 0.99, 1.3, 0, "no_gap"),  # zeros leave noise
        (1.0, 1.0, 1.0, 1.3, 0, "explained"),  # and here they do not
        (1.0, 1.0, 1.0, 9.0, 4, "unknown"), (1.0, 1.0, 1.0, 9.0, 3, "explained"),  # names tied
    ],
)  # fmt: skip
def test_what_is_large_or_a_zero_or_one_of_many_is_not_explained(after, floor, share, level, ties, said):
    assert verdict(Gap(40.0, after, 40.0, floor, "", share, None), found(after, ties), 1.0, level) == said


@pytest.mark.parametrize("direction", [1, -1])
def test_a_zero_and_a_direction_are_taken_out_record_by_record(case, direction):
    """Errors of a run that is right but for both leave the noise alone."""
    noise = coloured(np.random.default_rng(4), NOISE)
    errors = []
    for k, s in enumerate(case.series):
        measured = 100 * (s.run - s.error) / s.span
        errors.append((direction - 1) * measured + noise[k] + 5 + k)
    assert rezeroed(case, judged(np.stack(errors)), (0, 1)) == pytest.approx(np.sqrt(noise.var(1).mean()), rel=1e-6)
