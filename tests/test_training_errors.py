"""Which model training hands back: the better one over all training records (`test_train` has whole ones)."""

import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax import Record
from pitp_jax.method.train import errors as judging
from pitp_jax.method.train.errors import Candidate, Judge, kept


@pytest.fixture(scope="module")
def candidate(linear):
    """fn(errors of two records): a candidate; the nominal's errors are 2 and 4 %."""
    model = linear(2)

    def make(trained, nominal=(2.0, 4.0), noise=(0.1, 0.1)):
        return Candidate(model, ("a", "b"), *map(np.array, (nominal, trained, noise)))

    return make


@pytest.mark.parametrize(
    ("trained", "converged", "nearly"),
    [((0.3, 0.4), True, False), ((2.1, 0.4), False, True), ((2.0, 3.9), False, False), ((9.0, np.inf), False, False)],
)
def test_a_start_converged_or_nearly(candidate, trained, converged, nearly):
    found = candidate(trained)
    assert (found.converged, found.nearly) == (converged, nearly)


def test_what_the_sensor_adds_is_no_failure(candidate):
    """5 % of noise on a record that the nominal meets to the noise."""
    assert candidate((5.01, 5.0), (5.0, 5.0), (4.99, 4.99)).converged
    assert not candidate((5.01, 5.0), (5.0, 5.0)).converged


def test_an_added_error_below_the_noise_rejects_nothing(candidate):
    """Two errors that add as squares: the nominal's, all noise (1 %), and what the trained model adds."""
    for added, worse in ((0.3, False), (0.98, False), (1.1, True)):
        found = candidate((np.hypot(1.0, added), 0.2), (1.0, 4.0), (1.0, 0.1))
        assert found.errors[0].worse == worse == bool(found.rank[0])


def test_a_larger_mean_is_rejected_whatever_the_noise(candidate, monkeypatch):
    found = candidate((1.2, 4.0), (1.0, 4.0), (1.0, 4.0))
    assert not any(e.worse for e in found.errors) and found.rank[0] == 1
    monkeypatch.setattr(judging, "errors", lambda *_: np.array([1.0, 4.0]))
    judged = Judge([], np.array([1.0, 4.0]), np.array([1.0, 4.0]))
    chosen, problems, fallback = kept(found, judged, lambda m: [m])
    assert tuple(chosen.trained) == (1.0, 4.0) and fallback is not None and "average" in problems[0]


@pytest.mark.parametrize(
    ("between", "expected", "says"),
    [([(1.9, 3.0), (1.8, 3.5), (2.0, 4.0)], (1.9, 3.0), "between"), ([(2.5, 1.0), (2.0, 4.0)], (2.0, 4.0), "itself")],
)
def test_worse_over_all_records_is_not_handed_back(candidate, monkeypatch, between, expected, says):
    """The best model towards the nominal that is worse on none, else the nominal; and it is told."""
    left = iter(between)
    monkeypatch.setattr(judging, "errors", lambda *_: np.array(next(left)))
    judged, models = Judge([], np.array([2.0, 4.0]), np.zeros(2)), [candidate((0.0, 0.0)).model] * len(between)
    chosen, problems, fallback = kept(candidate((3.0, 3.5)), judged, lambda _: models)
    assert tuple(chosen.trained) == expected
    assert fallback is not None and says in fallback
    assert len(problems) == 1 and says in problems[0] and "a (3 % of range instead of 2)" in problems[0]
    assert kept(candidate((0.3, 0.4)), judged, lambda _: models)[1:] == ([], None)


def test_a_better_model_is_kept_and_the_record_on_which_it_is_worse_named(candidate):
    """A sweep 0.07 % of range worse beside a record that fell to a tenth; a diverged record outweighs any other."""
    found = candidate((2.07, 0.4))
    chosen, problems, fallback = kept(found, Judge([], found.nominal, found.noise), lambda m: [])
    assert chosen is found and fallback is None
    assert len(problems) == 1 and "worse than the nominal model on a (2.07 % of range instead of 2)" in problems[0]
    assert candidate((np.inf, 0.01)).gain < 0 < found.gain
    assert candidate((0.001, 4.0), noise=(2.0, 0.1)).gain == 0  # below the noise nothing is gained


def test_a_model_of_means_is_judged_at_the_rate_of_the_records(linear):
    """The hold of the records counts there too: SciPy's held voltage is met, by straight lines it would not be."""
    fine, coarse = linear(2, hz=20.0, hold="zoh"), linear(2, hz=20.0).sampled(0.01, "foh")
    time = np.arange(2000) * 1e-3
    voltage = np.repeat(np.random.default_rng(0).uniform(0, 1000, 400), 5)
    x = lsim(([1.0], fine.physical_coefficients[::-1]), voltage**2, time, interp=False)[1]
    found = judging.judge(fine, [Record("r", time, voltage, x, "V", "m")])(coarse)
    assert found.model is coarse and found.trained < 0.05
