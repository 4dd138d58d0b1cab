"""Which model training hands back: the better one over all training records (`test_train` has whole ones)."""

from dataclasses import replace

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
        return Candidate(model, ("a", "b"), np.array(nominal), np.array(trained), np.array(noise))

    return make


@pytest.mark.parametrize(
    ("trained", "held_out", "converged"),
    [((0.3, 0.4), np.inf, True), ((2.1, 0.4), 0.5, True), ((2.0, 3.9), np.inf, False), ((9.0, np.inf), np.inf, False),
     ((0.3, 0.4), -0.1, False)],
)  # fmt: skip
def test_a_start_converged(candidate, trained, held_out, converged):
    """Better over all recordings and on held-out blocks, and small or halved; a worse record alone is no failure."""
    assert replace(candidate(trained), held_out=held_out).converged == converged


def test_what_the_sensor_adds_is_no_failure(candidate):
    """5 % of noise on a record that the nominal meets to the noise."""
    assert candidate((4.98, 4.98), (5.0, 5.0), (4.99, 4.99)).converged
    assert not candidate((4.98, 4.98), (5.0, 5.0)).converged


def test_an_added_error_below_the_noise_makes_no_record_worse(candidate):
    """Two errors that add as squares: the nominal's, all noise (1 %), and what the trained model adds."""
    for added, worse in ((0.3, False), (0.98, False), (1.1, True)):
        found = candidate((np.hypot(1.0, added), 0.2), (1.0, 4.0), (1.0, 0.1))
        assert found.errors[0].worse == worse


@pytest.mark.parametrize(("trained", "held_out", "where"), [((3.0, 3.5), np.inf, "a (3 % of range instead of 2)"),
                                                            ((0.3, 0.4), np.log(0.8), "held-out blocks")])  # fmt: skip
def test_worse_over_all_records_or_held_out_is_not_handed_back(candidate, monkeypatch, trained, held_out, where):
    """The nominal comes back, and it is told; a model as good as the nominal to 1 % stays."""
    monkeypatch.setattr(judging, "errors", lambda *_: np.array([2.0, 4.0]))
    monkeypatch.setattr(judging, "with_offset", lambda model, _: model)
    judged, nominal = Judge([], np.array([2.0, 4.0]), np.zeros(2)), candidate((2.0, 4.0)).model
    chosen, problems, fallback = kept(replace(candidate(trained), held_out=held_out), judged, nominal)
    assert tuple(chosen.trained) == (2.0, 4.0) and fallback == "the nominal itself"
    assert len(problems) == 1 and where in problems[0] and "times the nominal's" in problems[0]
    same = replace(candidate((2.0, 4.0)), held_out=-0.005)
    assert kept(same, judged, nominal)[0] is same and kept(same, judged, nominal)[2] is None


def test_a_better_model_is_kept_and_the_record_on_which_it_is_worse_named(candidate):
    """A sweep 0.07 % of range worse beside a record that fell to a tenth; a diverged record outweighs any other."""
    found = candidate((2.07, 0.4))
    chosen, problems, fallback = kept(found, Judge([], found.nominal, found.noise), found.model)
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
    assert found.model.dt == coarse.dt and found.trained < 0.05
