"""`pitp fit`: what training is called with, its progress, and every way it ends."""

import io
import json
import sys
from dataclasses import dataclass, replace

import jax.numpy as jnp
import pytest
from cli_cases import refused, tree

import pitp_jax as pitp
from pitp_jax.application.commands.console import ProgressLine, say
from pitp_jax.common.errors import BadInput, ComputationFailed
from pitp_jax.files.model_file import model_file
from pitp_jax.method.model.encoder import CompactEncoder
from pitp_jax.method.train import training
from pitp_jax.method.train.cross_validation import HeldOut
from pitp_jax.method.train.settings import PARTS, PRESETS


@pytest.fixture
def trainer(monkeypatch):
    """`train` that only notes what it was called with; set `.result` or `.error` to change its end."""

    @dataclass
    class Trainer:
        calls: list
        error: BaseException | None = None
        interrupted: bool = False

        def __call__(self, nominal, records, **options):
            self.calls.append((nominal, [r.name for r in records], options))
            for step in (1, 2):
                options["progress"](training.Progress("stage 1", step, 2, 1.5, 0.25, 0.125))
            options["progress"](training.Progress("free runs", 1, 1, None, 0.1, 0.1))
            if self.error:
                raise self.error
            encoder = CompactEncoder(2, 0, width=4, key=options["key"])
            learned = tuple(PARTS[part](jnp.asarray(0.004)) for part in options["settings"].parts)
            model = replace(nominal, encoder=encoder, effects=learned)
            found = training.RecordError("sine2", 4.0, 0.3), training.RecordError("sine4", 0.2, 0.5)
            told = {"seconds": 1.0}
            return training.Training(
                model, ({"stage": 1, "physics": 0.5},), self.interrupted, told, found, ("not converged",)
            )

    fake = Trainer([])
    monkeypatch.setattr("pitp_jax.application.commands.fit.train", fake)
    return fake


def test_fit_from_a_nominal(call, bench, tmp_path, trainer, quick_identify):
    out = tmp_path / "model"
    options = ["--nominal", bench / "nominal", "--order", "2", "--input-map", "square", "--preset", "paper"]
    code, text, err = call("fit", bench / "records", "--out", out, "--seed", "7", *options)
    assert code == 0
    assert quick_identify == []
    _, names, given = trainer.calls[0]
    assert names == ["sine2", "sine4", "sweep"]
    assert given["settings"] == PRESETS["paper"]
    assert "stage 1: 2/2  box 1.5  loss 0.25  best 0.125\n" in err
    assert "free runs: 1/1  loss 0.1  best 0.1\n" in err
    assert type(model_file.load(out).encoder) is CompactEncoder
    assert "physics 0.5" in text


def test_fit_says_first_that_training_failed(call, bench, tmp_path, trainer, monkeypatch):
    def failed(*args, **options):
        made = trainer(*args, **options)
        return replace(made, notes={**made.notes, "fallback": "the nominal itself"}, fallback="the nominal itself")

    monkeypatch.setattr("pitp_jax.application.commands.fit.train", failed)
    options = ["--nominal", bench / "nominal", "--json", tmp_path / "j"]
    code, text, _ = call("fit", bench / "records", "--out", tmp_path / "model", *options)
    assert code == 0
    assert text.startswith("Training failed: this file holds the linear model")
    assert json.loads((tmp_path / "j").read_text())["fallback"] == "the nominal itself"


@pytest.mark.parametrize(("trained", "said", "ends"), [(34.0, "explains nothing", 3), (25.0, "only a part", 0)])
def test_fit_says_first_that_its_model_explains_little(
    call, bench, tmp_path, trainer, monkeypatch, trained, said, ends
):
    """A sine's standard deviation is 35 % of its range."""

    def poor(*args, **options):
        return replace(trainer(*args, **options), errors=(training.RecordError("sine2", 36.0, trained),))

    monkeypatch.setattr("pitp_jax.application.commands.fit.train", poor)
    options = ["--nominal", bench / "nominal", "--json", tmp_path / "j"]
    code, text, _ = call("fit", bench / "records", "--out", tmp_path / "model", *options)
    assert code == ends and (tmp_path / "model").exists()
    assert text.startswith("warning: ") and said in text.splitlines()[0]
    assert said in json.loads((tmp_path / "j").read_text())["warning"]


@pytest.mark.slow
def test_parts_to_learn(call, bench, tmp_path, trainer):
    options = ["--nominal", bench / "nominal", "--learn", "sensor_lag", "--learn", "delay", "--learn", "delay"]
    options += ["--report", tmp_path / "page"]
    code, text, _ = call("fit", bench / "records", "--out", tmp_path / "model", *options)
    assert code == 0
    assert trainer.calls[0][2]["settings"] == replace(PRESETS["default"], parts=("sensor_lag", "delay"))
    assert "with delay (pure): time 0.004 s" in text
    assert "Free runs of" in (tmp_path / "page" / "report.html").read_text(encoding="utf-8")


def test_errors_of_every_record(call, bench, tmp_path, trainer, monkeypatch):
    """Table and JSON hold the nominal's, the trained model's and the predicted errors; failures are warned of."""

    def left_out(nominal, records, model, **options):
        assert (nominal.order, options["key"], len(records)) == (2, trainer.calls[0][2]["key"], 3)
        return HeldOut("sine2", 0.3, 0.4), HeldOut("sine4", 0.5, 7.0)

    monkeypatch.setattr("pitp_jax.application.commands.fit.run_cross_validate", left_out)
    options = ["--nominal", bench / "nominal", "--cross-validate", "--json", tmp_path / "errors.json"]
    code, text, err = call("fit", bench / "records", "--out", tmp_path / "model", *options)
    assert code == 0
    assert [line.split() for line in text.splitlines() if line.startswith("sine")] == [
        ["sine2", "4", "0.3", "0.4"], ["sine4", "0.2", "0.5", "7"],
    ]  # fmt: skip
    assert ["median", "2.1", "0.4", "3.7"] in [line.split() for line in text.splitlines()]
    assert "warning: not converged" in err and "sine4: predicted 14 times worse" in err
    told = json.loads((tmp_path / "errors.json").read_text())
    row = {"nominal_e_rms_percent": 0.2, "trained_e_rms_percent": 0.5, "left_out_e_rms_percent": 7.0, "problem": None}
    assert told["records"]["sine4"] == row
    assert told["worse_than_nominal"] == ["sine4"] and told["problems"] == ["not converged"]
    kept = pitp.load(tmp_path / "model").origin.training
    assert kept is not None and kept["left_out_errors"] == {"sine2": 0.4, "sine4": 7.0}


def test_progress_is_redrawn_in_place_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    line = ProgressLine()
    for step in range(1, 101):
        line.train(training.Progress("stage 1", step, 100, 1.5, 0.25, 0.125))
    say("done")
    drawn = terminal.getvalue().split("\r\x1b[K")
    assert drawn[1].startswith("stage 1: 1/100  box 1.5")
    assert drawn[-2].startswith("stage 1: 100/100")
    assert drawn[-2].endswith("\n")
    assert drawn[-1] == "pitp: done\n"
    assert 3 <= len(drawn) < 20  # not redrawn faster than can be seen


@pytest.mark.slow
def test_fit_is_reproducible_by_seed(call, bench, tmp_path, trainer):
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        call("fit", bench / "records", "--out", tmp_path / name, "--nominal", bench / "nominal", "--seed", seed)
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c


@pytest.mark.parametrize("found", [["sweep"], []])
def test_fit_identifies_on_sweeps_else_on_all(call, bench, tmp_path, trainer, quick_identify, monkeypatch, found):
    monkeypatch.setattr("pitp_jax.application.commands.fit.is_sweep", lambda record: record.name in found)
    code, _, err = call("fit", bench / "records", "--out", tmp_path / "m", "--order", "2")
    assert code == 0
    assert quick_identify[0][0] == (found or ["sine2", "sine4", "sweep"])
    assert quick_identify[0][1] | {"order": 2, "input_map": None} == quick_identify[0][1]  # identify chooses by unit
    assert ("1 recording (sweep)" if found else "no recording is a sweep") in err
    assert trainer.calls[0][1] == ["sine2", "sine4", "sweep"]


def test_fit_refuses_options_that_contradict_the_nominal(call, bench, tmp_path, trainer):
    start = ["fit", bench / "records", "--out", tmp_path / "m", "--nominal", bench / "nominal"]
    assert "--order 3 contradicts" in refused(call(*start, "--order", "3"))
    assert "--input-map linear contradicts" in refused(call(*start, "--input-map", "linear"))
    assert trainer.calls == []
    assert call(*start, "--order", "auto")[0] == 0


@pytest.mark.slow
def test_fit_that_fails(call, bench, tmp_path, trainer):
    start = ["fit", bench / "records", "--out", tmp_path / "m", "--nominal", bench / "nominal"]
    trainer.error = ComputationFailed("the loss became nan\nin stage 1")
    assert "nan in stage 1" in refused(call(*start), code=3)
    trainer.error = MemoryError()
    assert "out of memory" in refused(call(*start), code=3)
    trainer.error = BadInput("nothing usable")
    refused(call(*start))
    trainer.error = ZeroDivisionError("a bug")
    code, _, err = call(*start)
    assert code == 3
    assert "unexpected ZeroDivisionError: a bug" in err
    assert tree(tmp_path) == []


def test_interrupted_fit(call, bench, tmp_path, trainer):
    start = ["fit", bench / "records", "--out", tmp_path / "m", "--nominal", bench / "nominal"]
    trainer.error = KeyboardInterrupt()
    code, out, err = call(*start)
    assert (code, out, tree(tmp_path)) == (130, "", [])
    assert err.splitlines()[-1] == "pitp: interrupted"
    trainer.error, trainer.interrupted = None, True
    code, out, err = call(*start)
    assert (code, out) == (130, "")
    assert err.splitlines()[-1] == f"pitp: interrupted; the best complete model is in {tmp_path / 'm'}"
    assert model_file.load(tmp_path / "m").order == 2
