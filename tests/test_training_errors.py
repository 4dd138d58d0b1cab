"""Which model training hands back: never worse than the nominal on a training record; leave-one-out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from test_train import KEY, TINY, plant

from pitp_jax._errors import BadInput
from pitp_jax._metrics import e_rms_percent
from pitp_jax._simulate.prediction import predict
from pitp_jax._train import errors as judging
from pitp_jax._train.cross_validation import cross_validate
from pitp_jax._train.errors import Candidate, Judge, kept
from pitp_jax._train.training import train

__all__ = ["plant"]
QUICK = replace(TINY, epochs=1, stages=1)


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


@pytest.mark.parametrize(
    ("between", "expected", "says"),
    [([(1.9, 3.0), (1.8, 3.5), (2.0, 4.0)], (1.9, 3.0), "between"), ([(2.5, 1.0), (2.0, 4.0)], (2.0, 4.0), "itself")],
)
def test_worse_on_one_record_is_not_handed_back(candidate, monkeypatch, between, expected, says):
    """The best model towards the nominal that is worse on none, else the nominal; and it is told."""
    left = iter(between)
    monkeypatch.setattr(judging, "errors", lambda *_: np.array(next(left)))
    judged, models = Judge([], np.array([2.0, 4.0]), np.zeros(2)), [candidate((0.0, 0.0)).model] * len(between)
    chosen, problems = kept(candidate((3.0, 0.2)), judged, lambda _: models)
    assert tuple(chosen.trained) == expected
    assert len(problems) == 1 and says in problems[0] and "a (3 % of range instead of 2)" in problems[0]
    assert kept(candidate((0.3, 0.4)), judged, lambda _: models)[1] == []


def test_training_that_fails_hands_back_the_nominal(plant):
    """An encoder driven wild by its learning rate: what comes back runs as the nominal does, and says so."""
    nominal, records, _ = plant
    wild = replace(QUICK, rate=3.0, epochs=3)
    found = train(nominal, records, settings=wild, key=KEY)
    assert any("handed back" in line for line in found.problems)
    runs = zip(predict(found.model, records), records, found.errors, strict=True)
    for p, r, e in runs:
        assert e.trained == pytest.approx(e_rms_percent(p.displacement, r.displacement), rel=1e-3)
        assert e.trained <= 1.01 * e.nominal and not e.worse


def test_left_out_is_a_split_made_by_hand(plant):
    nominal, records, _ = plant
    whole = train(nominal, records, settings=QUICK, key=KEY).model
    found = cross_validate(nominal, records, whole, settings=QUICK, key=KEY)
    others = train(nominal, [records[0], records[2]], settings=QUICK, key=KEY).model
    by_hand = [
        e_rms_percent(predict(m, [records[1]])[0].displacement, records[1].displacement) for m in (whole, others)
    ]
    assert [h.name for h in found] == [r.name for r in records]
    np.testing.assert_allclose([found[1].fitted, found[1].predicted], by_hand, rtol=1e-3)


def test_a_split_that_cannot_be_trained_is_told(plant):
    def refuses(records):
        raise BadInput("not identifiable")

    nominal, records, _ = plant
    (one, _) = cross_validate(refuses, records[:2], nominal, settings=QUICK, key=KEY)
    assert one.suspect and one.problem == "not identifiable" and one.predicted == np.inf
    with pytest.raises(BadInput, match="at least two"):
        cross_validate(nominal, records[:1], nominal, settings=QUICK, key=KEY)
