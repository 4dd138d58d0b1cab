"""The error to expect: closed forms for a sine, and no figure where nothing was left out."""

from dataclasses import replace

import numpy as np
import pytest

from pitp_jax._model.expected_error import expected_error
from pitp_jax._model.fitted import Fitted
from pitp_jax._model.model import linear_model
from pitp_jax._model.origin import Origin, OutOfFold
from pitp_jax._model_file.parts import describe
from pitp_jax._model_file.plausible import header_problems
from pitp_jax._train.cross_validation import HeldOut, with_left_out

MODEL = linear_model([1e7, 2e5, 1e4], dt=1e-3)
SINE = np.append(1e-3 * np.sin(2 * np.pi * np.arange(1000) / 1000), np.nan)
IDENTIFIED = Origin(lineage=({"step": "identify"},), out_of_fold=OutOfFold((1.0, 2.0, 4.0), (0.3, 0.4), (3.0, 4.0)))


def test_identified_model_gives_the_ratio_of_its_parts_left_out():
    found = expected_error(Fitted(MODEL, IDENTIFIED), SINE)
    # a tenth of the output's rms; a sine's standard deviation is its range over sqrt(8)
    assert found is not None and found.percent == pytest.approx(100 * 0.1 / np.sqrt(8), rel=1e-3)


def test_trained_model_gives_the_median_of_the_recordings_left_out():
    trained = Fitted(MODEL, replace(IDENTIFIED, training={}, lineage=({"step": "identify"}, {"step": "fit"})))
    assert expected_error(trained, SINE) is None
    errors = [HeldOut(f"r{k}", 0.1, e) for k, e in enumerate((1.0, 2.0, 6.0))]
    kept = with_left_out(trained, [*errors, HeldOut("lost", 0.1, np.inf, "diverged")])
    found = expected_error(kept, SINE)
    assert found is not None and found.percent == 2.0 and "3 recordings" in found.source and "1 to 6 %" in found.source
    assert header_problems({**describe(kept), "leaves": []}) == []


@pytest.mark.parametrize("origin", [Origin(), replace(IDENTIFIED, lineage=(*IDENTIFIED.lineage, {"step": "diagnose"}))])
def test_no_figure_where_none_was_measured(origin):
    assert expected_error(Fitted(MODEL, origin), SINE) is None
