"""The page of a fit: every record, the worst first; what the memory holds; nothing loaded from anywhere."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax import Fitted, Prediction
from pitp_jax.application.commands.predict import score
from pitp_jax.application.pages.fit_page import fit_page, memory_times


@pytest.fixture(scope="module")
def fitted(nonlinear, bounded):
    """A model with lags of 20 ms and 0.3 s, trained within 2 mm."""
    return bounded(nonlinear(2, ring=(60.0, 0.05)), region=((0.0, 2.0), (-1.0, 1.0), *((0.0, 2.0),) * 4))


def pair(name, hz, error, *, lost=False):
    """A record of a sine and a run that is off by so many percent of its range (rms)."""
    t = np.arange(2000) * 1e-3
    x = 1e-3 * (1 - np.cos(2 * np.pi * hz * t))
    off = np.sqrt(2) * 2e-5 * error * np.sin(2 * np.pi * 7 * t)
    x[5] = np.nan
    run = Prediction(name, np.full(2000, np.nan) if lost else x + off, lost, False, np.ones(2000, bool), 0.1)
    return pitp.Record(name, t, 1000 * np.abs(np.sin(np.pi * hz * t)), x, displacement_unit="mm"), run


@pytest.mark.slow
def test_every_record_stands_there_the_worst_first(fitted):
    pairs = [pair("calm", 2, 0.5), pair("<wild>", 5, 3.0), pair("gone", 3, 0.0, lost=True)]
    records, runs = zip(*pairs, strict=True)
    scores = {r.name: score(r, p) for r, p in pairs}
    text = fit_page(Fitted(fitted), records, runs, scores, "model.pitp").html()
    table = text[text.index("Recordings, the worst first") :]
    assert table.index("gone") < table.index("&lt;wild&gt;") < table.index("calm")
    assert "3.00" in table and "0.500" in table and "diverged" in table and "<wild>" not in text
    assert text.count("<svg") == 5 and "<script" not in text and "http" not in text
    assert (
        re.search("<li>0.0[0-9.]+ s(, not determined)?</li><li>0.[0-9.]+ s", text) and "second mass at 9.55 Hz" in text
    )


def test_an_identified_model_has_a_page_without_tokens(actuator):
    record, run = pair("only", 2, 1.0)
    text = fit_page(Fitted(actuator), [record], [run], {"only": score(record, run)}, "nominal").html()
    assert text.count("<svg") == 3 and "at most 1.0" in text


@pytest.mark.slow
def test_memory_times_that_the_records_do_not_determine_are_marked(fitted):
    """A lag longer than the records, and every lag without a drive; no lag has an error, which the network hides."""
    t, rng = np.arange(3000) * 1e-3, np.random.default_rng(3)
    model = replace(fitted, memory=replace(fitted.memory, log_tau=jnp.log(jnp.array([0.02, 5.0], jnp.float32))))
    record = pitp.Record("r", t, 1500 * np.abs(np.sin(2 * np.pi * t)), np.sin(t), displacement_unit="mm")
    (run,) = pitp.predict(model, [record])
    noise = rng.standard_normal(len(t))
    measured = replace(record, displacement=run.displacement + 1e-7 * noise)
    assert memory_times(model, [measured], [run]) == ["0.020 s", "5.0 s, longer than the recordings"]
    calm = pitp.Record("c", t, 0 * t, 1e-7 * noise, displacement_unit="mm")
    lines = memory_times(model, [calm], pitp.predict(model, [calm]))
    assert all("not determined" in line for line in lines)
