"""The public names: short reprs, mistakes told in one line, and docstrings whose examples run."""

import doctest
import inspect
import subprocess
import sys
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

import pitp_jax as pitp
from pitp_jax.files.recordings.writing import write_csv
from pitp_jax.method.model.fitted import fitted_of, model_of
from pitp_jax.method.simulate.decoder import rollout_batch

TIME = np.arange(2000) / 1000


@pytest.fixture(scope="module")
def known(linear, bounded):
    return bounded(linear(2))


@pytest.fixture(scope="module")
def records(known):
    voltage = 1000 * (1 - np.cos(2 * np.pi * (0.3 * TIME + 2 * TIME**2)))
    x = lsim(([1.0], known.physical_coefficients[::-1]), voltage**2, TIME)[1]
    noise = 1e-6 * np.random.default_rng(0).standard_normal(len(TIME))
    return [pitp.Record("sweep", TIME, voltage, x + noise, displacement_unit="mm")]


def public():
    return {name: getattr(pitp, name) for name in dir(pitp) if not name.startswith("_")}


def test_dir_shows_public_names_only():
    code = "import pitp_jax; print([n for n in dir(pitp_jax) if n.startswith('_') or n == 'lazy_loader'])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"
    assert {"check", "rollout", "predict", "read_voltage"} <= set(public())


def test_every_public_function_says_what_it_takes_gives_and_shows():
    missing = []
    for name, f in public().items():
        if not inspect.isfunction(f):
            continue
        doc, signature = f.__doc__ or "", inspect.signature(f)
        wanted = ["Examples:"] + (["Args:"] if signature.parameters else [])
        wanted += [] if signature.return_annotation in (None, "None") else ["Returns:"]
        missing += [f"{name}: {part}" for part in wanted if part not in doc]
    assert missing == []


@pytest.mark.slow
def test_examples_run(known, records, tmp_path):
    record = records[0]
    write_csv(tmp_path / "drive.csv", {"time_s": record.time, "voltage_V": record.voltage})
    wanted = 1e-3 * (0.5 - 0.5 * np.cos(np.pi * np.clip(TIME, 0, 1)))
    write_csv(tmp_path / "target.csv", {"time_s": TIME, "displacement_mm": 1e3 * wanted})
    names = {"pitp": pitp, "np": np, "jnp": jnp, "jax": jax, "model": known, "records": records, "folder": tmp_path}
    names["target"] = pitp.Target(TIME, wanted)
    runner, run = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS), 0
    for name, f in public().items():
        if inspect.isfunction(f):
            for example in doctest.DocTestFinder(recurse=False).find(f, name, globs=dict(names)):
                assert example.examples, name
                runner.run(example)
                run += any(doctest.SKIP not in e.options for e in example.examples)
    assert runner.failures == 0
    assert run > 24


def test_reprs_are_short(known, records, explained):
    found = pitp.identify(records, order=2, hold="foh")
    shown = [records[0], known, found, pitp.predict(known, records)[0], explained, pitp.check(records)]
    for value in shown:
        text = repr(value)
        lines, letters = (10, 1200) if value is explained else (4, 700)  # a diagnosis begins with its model's numbers
        assert len(text.splitlines()) <= lines and "array" not in text and len(text) < letters, text
    assert "2000 samples at 1000 Hz" in repr(records[0]) and "mm" in repr(records[0])
    assert "order 2" in repr(known) and "5 Hz" in repr(known)
    assert "1 at rest" in repr(found)


_MISTAKES = """
import numpy as np, pitp_jax as pitp
from types import SimpleNamespace
t = np.arange(100) / 1e3
r = pitp.Record("one", t, np.sin(30 * t), np.sin(30 * t))
for f in (
    lambda: pitp.predict([r], [r]),
    lambda: pitp.identify("sweep.csv"),
    lambda: pitp.identify([r, 3]),
    lambda: pitp.check(r),
    lambda: pitp.check(7),
    lambda: pitp.rollout("nominal", t),
):
    try:
        f()
    except pitp.BadInput as error:
        print(error)
"""


def test_a_result_that_holds_a_model_counts_as_the_model(known):
    fitted = pitp.Fitted(known)
    for held in (known, fitted):
        result = SimpleNamespace(model=held)
        assert model_of(result) is known and fitted_of(result).model is known
    assert fitted_of(SimpleNamespace(model=fitted)) is fitted
    with pytest.raises(pitp.BadInput, match="a SimpleNamespace is not a model"):
        model_of(SimpleNamespace(model="nominal"))


@pytest.mark.slow
def test_mistakes_are_told_in_one_line():
    """Outside pytest's own checks of types."""
    done = subprocess.run([sys.executable, "-c", _MISTAKES], capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 6, done.stderr
    for line, part in zip(
        lines, ("a list is not a model", "pitp.read('sweep.csv')", "a int among", "give a list", "a int is not a list",
                "pitp.load(FILE)"), strict=True,
    ):  # fmt: skip
        assert part in line


def test_rollout_in_physical_units_is_the_scaled_one(known, records):
    u, start = records[0].voltage, pitp.rest_state(known)
    model = eqx.tree_at(lambda m: (m.output.offset, m.output.polarity), known, (np.float64(2e-3), np.float64(-1.0)))
    states = rollout_batch(model, jnp.asarray(u[None], jnp.float32), 1e-3, start[None])[0]
    truth = np.asarray(states[:, 0], np.float64) * model.scales.state[0]
    np.testing.assert_allclose(pitp.rollout(model, u, 1e-3), truth, atol=1e-8)
    np.testing.assert_allclose(pitp.rollout(model, u, 1e-3, zero="sensor"), 2e-3 - truth, atol=1e-8)
    np.testing.assert_allclose(pitp.rollout(model, u, 1e-3, zero=1e-3), 1e-3 + truth, atol=1e-8)
    np.testing.assert_allclose(pitp.rollout(known, u), records[0].displacement, atol=1e-5)
    both = pitp.rollout(known, np.stack([u, 0 * u]))
    assert both.shape == (2, 2000) and np.abs(both[1]).max() == 0


def test_a_held_start_stays_where_it_is(known):
    x = pitp.rollout(known, np.full(300, 1000.0))
    np.testing.assert_allclose(x, 1e-3, rtol=1e-4)
    assert pitp.rollout(known, np.full(300, 1000.0), begins="rest")[0] == 0


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (dict(voltage=np.ones((2, 3, 4))), "shape"),
        (dict(voltage=np.array([1.0, np.nan])), "missing"),
        (dict(voltage=np.ones(9), dt=-1.0), "dt -1.0"),
        (dict(voltage=np.ones(9), begins="rest", dt=0.0), "positive"),
    ],
)
def test_a_bad_voltage_is_told(known, given, word):
    with pytest.raises(pitp.BadInput, match=word):
        pitp.rollout(known, **given)


@pytest.mark.slow
def test_results_show_themselves_in_a_notebook(known, records):
    """A repr of at most ten lines, HTML below 200 kB, and a table that pandas holds."""
    found = pitp.identify(records, order=2)
    target = pitp.Target(TIME, 1e-4 * (1 - np.cos(2 * np.pi * TIME)))
    session = pitp.plan(max_voltage=6000.0, band=(0.5, 10.0))
    for shown, count in (
        (records[0], TIME.size), (found, 1), (pitp.check(records), 1), (pitp.predict(known, records)[0], TIME.size),
        (target, TIME.size), (session, len(session.recordings)), (pitp.feedforward(known, target), None),
    ):  # fmt: skip
        assert len(repr(shown).splitlines()) <= 10, type(shown)
        assert 0 < len(shown._repr_html_()) < 200_000
        table = shown.frame()
        assert len(table) == count if count else len(table) > 0
    assert list(target.frame().columns) == ["time", "displacement"]
    assert "<pre>Model: identified" in known._repr_html_()
