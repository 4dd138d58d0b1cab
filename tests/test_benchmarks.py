"""The benchmark's clock, its table and its torch copies; the figures themselves are no test."""

import importlib.util
import json
import time

import jax.numpy as jnp
import numpy as np
import pytest
from motions import DT, respond

import pitp_jax as pitp
from benchmarks.__main__ import main, run
from benchmarks.blocks import duration, pages, table, written
from benchmarks.clock import row, take_turns
from benchmarks.machine import floor, operations
from benchmarks.rows import ROWS

WANTED = {"inverse_default", "inverse_paper", "rollout_batch", "fit_cone",
          "fit_roll", "identify", "diagnose", "import"}  # fmt: skip
KEYS = {"median_ms", "p10_ms", "p90_ms", "compile_s", "peer", "peer_median_ms", "ratio"}


def slow_first(seconds, later):
    calls = []

    def run():
        calls.append(None)
        time.sleep(seconds if len(calls) == 1 else later)

    return run


def test_first_call_apart_medians_and_ratio():
    found = take_turns({"ours": slow_first(0.06, 0.002), "theirs": lambda: time.sleep(0.006)}, 0.1)
    line = row(found, "ours", "theirs", {"theirs": 10.0}, steps=3)
    assert KEYS <= line.keys()
    assert 0.03 < line["compile_s"] < 0.5
    assert 2 <= line["median_ms"] < 30
    assert line["p10_ms"] <= line["median_ms"] <= line["p90_ms"]
    assert line["ratio"] == pytest.approx(10 * found["theirs"]["median_ms"] / line["median_ms"])
    assert line["steps"] == 3


@pytest.mark.parametrize(("ms", "text"), [(0.0216, "21.6 us"), (3.302, "3.3 ms"), (71234.0, "71.2 s"), (None, "-")])
def test_durations(ms, text):
    assert duration(ms) == text


def test_a_block_goes_between_its_marks():
    text = "a\n<!-- it -->\nold\n<!-- end -->\n<!-- that -->\nold\n<!-- end -->\nb\n"
    assert written(text, "it", "new") == text.replace("old", "\nnew\n", 1)
    with pytest.raises(ValueError, match="no lines <!-- other -->"):
        written(text, "other", "new")


def test_pages_have_the_figures_of_the_file():
    """After a change of `figures.json`, run `python -m benchmarks --write`."""
    for file, text in pages().items():
        assert file.read_text(encoding="utf-8") == text


def test_rows_and_unknown_ones(tmp_path):
    assert set(ROWS) >= WANTED
    with pytest.raises(SystemExit, match="unknown row nothing"):
        main(["--only", "nothing"])


def test_table_and_file_keep_earlier_rows(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("benchmarks.__main__.run", lambda name, seconds, _: {"skipped": f"{name} {seconds:g}"})
    file = tmp_path / "rows.json"
    file.write_text('{"accuracy": 1}')
    main(["--only", "identify", "--json", str(file), "--seconds", "3"])
    main(["--only", "import,diagnose", "--json", str(file)])
    assert json.loads(file.read_text()) == {"accuracy": 1, "rows": {
        "identify": {"skipped": "identify 3"}, "import": {"skipped": "import 10"},
        "diagnose": {"skipped": "diagnose 10"}}}  # fmt: skip
    printed = capsys.readouterr().out
    assert printed.count("skipped") == 4
    line = {"median_ms": 2.0, "p10_ms": 1.0, "p90_ms": 3.0, "compile_s": 0.5, "peer": "it", "peer_median_ms": 9.0,
            "ratio": 4.5, "peak_mb": 100}  # fmt: skip
    assert "| 9 ms" in table({"a": line}) and "| 4.5" in table({"a": line})
    assert "| 25%" in table({"a": line | {"floor_ms": 0.5}})


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_every_row_runs(name):
    line = run(name, 0.1, smoke=True)
    assert "skipped" not in line, line["skipped"]
    assert KEYS | {"peak_mb", "machine"} <= line.keys() and line["median_ms"] > 0
    if importlib.util.find_spec("torch") and name in ("inverse_default", "inverse_paper", "realtime"):
        assert line["peer"].startswith("PyTorch") and line["ratio"] > 0


def test_the_step_of_training_runs_as_the_table_times_it(linear):
    from benchmarks.fit import step_ways
    from pitp_jax import Settings

    time = np.arange(1500) * DT
    drive = 500 * (1 - np.cos(2 * np.pi * 2 * time))
    model = linear(2)
    ways, why = step_ways(model, [pitp.Record("sine", time, drive, respond(model, drive)[:, 0])], Settings())
    run, steps = ways["pitp_jax"]
    assert steps >= 1 and np.isfinite(run()).all()
    assert why or len(ways) == 2


def test_operations_are_those_of_the_arithmetic():
    """A product of 8 x 16 and 16 x 4 has 2 * 8 * 16 * 4; the floor is what it takes at the matrix rate."""
    a, b = jnp.ones((8, 16)), jnp.ones((16, 4))
    assert operations(jnp.matmul, a, b) == pytest.approx(2 * 8 * 16 * 4, rel=0.05)
    found = floor(1e9, 1.0)
    assert found["floor_ms"] == pytest.approx(1e3 / found["rates"]["gflops"])


@pytest.mark.parametrize("preset", ["default", pytest.param("paper", marks=pytest.mark.slow)])
def test_torch_copies_are_the_same_model(preset):
    torch = pytest.importorskip("torch")
    from benchmarks import subjects
    from benchmarks.torch_model import Inverse, tensor
    from pitp_jax.method.invert.equation import force_along

    model = getattr(subjects, preset)()
    rng = np.random.default_rng(0)
    equation = rng.normal(0, 0.3, (20, 3)).astype(np.float32)
    memory = rng.normal(0, 0.3, (20, model.memory.size)).astype(np.float32)
    force = np.asarray(force_along(model, jnp.asarray(equation), jnp.asarray(memory)))
    with torch.inference_mode():
        film = Inverse(model)(tensor(np.concatenate([equation[:, :-1], memory], 1).T), tensor(equation.T)).numpy()
    np.testing.assert_allclose(film**2 / model.scales.force, np.maximum(force, 0), rtol=0, atol=1e-5)
