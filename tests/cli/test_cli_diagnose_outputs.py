"""`pitp diagnose` around the diagnosis itself: options, files whole or not at all, and everything that is refused."""

import io
import json
from dataclasses import dataclass, replace

import diagnosis_cases
import numpy as np
import pytest
from cli_cases import columns_of, motion, refused, tree, truth, write_record

from pitp_jax.application.commands import diagnose as command
from pitp_jax.application.commands.console import ProgressLine
from pitp_jax.common.errors import BadInput, ComputationFailed
from pitp_jax.files.model_file import model_file
from pitp_jax.method.diagnose.diagnosis import Diagnosis
from pitp_jax.method.diagnose.next_experiment import Experiment


@pytest.fixture
def quick(monkeypatch):
    """`diagnose` that only notes its call: set `.found` or `.error` to change its end."""

    @dataclass
    class Quick:
        found: Diagnosis
        calls: list
        error: BaseException | None = None

        def __call__(self, model, records, **options):
            self.calls.append((model, [r.name for r in records], options))
            options["progress"]("fit: step 1, 2.000 %")
            if self.error:
                raise self.error
            return self.found

    fake = Quick(diagnosis_cases.explained(truth().model), [])
    monkeypatch.setattr(command, "run_diagnosis", fake)
    return fake


def test_options_reach_the_diagnosis(bench, quick, call):
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal", "--refit-nominal"]
    code, out, _ = call(*argv, "--input-column", "voltage_kV", "--output-column", "displacement_mm")
    assert code == 0
    model, names, options = quick.calls[0]
    assert (model.order, sorted(names), options["refit_nominal"]) == (2, ["sine2", "sine4", "sweep"], True)
    assert "wrote" not in out


@pytest.mark.parametrize(("error", "code"), [(RuntimeError("no ink"), 0), (KeyboardInterrupt(), 130)])
def test_a_page_that_fails_loses_nothing_else(bench, quick, call, tmp_path, monkeypatch, error, code):
    """Model and JSON are there before the page; an error is reported, an interrupt ends the command."""

    def broken(*_):
        raise error

    monkeypatch.setattr(command, "report", broken)
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal", "--json", tmp_path / "j"]
    ended, _, err = call(*argv, "--out", tmp_path / "d")
    assert ended == code and ("report.html failed (RuntimeError: no ink)" in err) == (code == 0)
    written = set(tree(tmp_path / "d"))
    assert {command.MODEL, command.JSON} <= written and command.REPORT not in written
    assert ("figures/where.png" in written) == (code == 0)
    assert json.loads((tmp_path / "j").read_text())["effects"] == list(quick.found.effects)
    model_file.load(tmp_path / "d" / command.MODEL)


def test_an_interrupted_diagnosis_writes_the_best_so_far(bench, quick, call, tmp_path):
    quick.found = replace(quick.found, interrupted=True)
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal", "--out", tmp_path / "d"]
    code, out, err = call(*argv)
    assert code == 130 and f"the best result so far is in {tmp_path / 'd'}" in err
    assert {command.MODEL, command.JSON, command.REPORT} <= set(tree(tmp_path / "d"))
    assert quick.found.effects[0] in out


@pytest.mark.slow
def test_an_experiment_is_written_and_named_and_an_old_one_goes(bench, quick, call, tmp_path):
    time = np.arange(500) / 500
    experiment = Experiment(("electrode_rc", "delay"), "a sine of 5 Hz", time, 900 * np.sin(10 * np.pi * time), 12.0)
    parts = ("electrode_rc", "delay", "parameters")
    quick.found = replace(quick.found, equivalent=("delay",), next_experiment=experiment, handed_back=parts)
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal", "--json", tmp_path / "j"]
    code, out, _ = call(*argv, "--out", tmp_path / "d")
    assert code == 0
    csv = tmp_path / "d" / "next_experiment.csv"
    told = json.loads((tmp_path / "j").read_text())["next_experiment"]
    assert told == {"separates": ["electrode_rc", "delay"], "excitation": "a sine of 5 Hz", "csv": str(csv)}
    header, values = columns_of(csv)
    assert header == ["time_s", "voltage_V"]
    np.testing.assert_allclose(values[:, 1], experiment.voltage, atol=1e-5)
    assert (tmp_path / "d" / "figures" / "next_experiment.png").is_file()
    assert "Next: play and record next_experiment.csv: a sine of 5 Hz for 1.00 s, to separate electrode_rc" in out
    assert out.splitlines()[-1] == (
        f"wrote {tmp_path / 'd' / 'report.html'} with its figures, {csv} and {tmp_path / 'd' / 'model_augmented'} "
        "(with electrode_rc, delay and parameters)"
    )
    assert call(*argv)[0] == 0
    assert json.loads((tmp_path / "j").read_text())["next_experiment"]["csv"] is None
    quick.found = replace(quick.found, verdict="no_gap", effects=(), next_experiment=None)
    (tmp_path / "d" / "notes.txt").write_text("mine")
    code, out, _ = call(*argv, "--out", tmp_path / "d")
    assert code == 0 and f"removed from {tmp_path / 'd'}, of an earlier diagnosis:" in out
    assert "next_experiment.csv" in out.partition("removed")[2]
    left = {
        "figures",
        "figures/gap.png",
        "figures/gap.csv",
        "model_augmented",
        "diagnosis.json",
        "index.html",
        "notes.txt",
        "report.html",
    }
    assert set(tree(tmp_path / "d")) == left


def test_a_recording_under_the_name_of_the_experiment_stays(bench, quick, call, tmp_path):
    """One plays next_experiment.csv and saves what was measured under that name, beside the report."""
    (tmp_path / "d").mkdir()
    write_record(tmp_path / "d" / "next_experiment.csv", *motion("sine2"))
    (tmp_path / "d" / "report.html").write_text("<style>:root{--ink:#000}</style>")
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal", "--out", tmp_path / "d"]
    assert "was not written by pitp" in refused(call(*argv))
    assert quick.calls == [] and "displacement" in (tmp_path / "d" / "next_experiment.csv").read_text()[:80]


def test_figures_that_are_not_finite_are_null(bench, quick, call, tmp_path):
    gap = replace(quick.found.gap, after=float("inf"), noise_floor=None, closed_fraction=float("nan"), ci95=None)
    quick.found = replace(quick.found, gap=gap)
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal", "--json", tmp_path / "j"]
    assert call(*argv)[0] == 0
    told = json.loads((tmp_path / "j").read_text(), parse_constant=pytest.fail)["gap"]
    assert [told[k] for k in ("after", "noise_floor", "closed_fraction", "ci95")] == [None] * 4


def test_bad_input_is_one_line_and_writes_nothing(bench, quick, call, tmp_path):
    real, nominal = bench / "records", bench / "nominal"
    outputs = ["--out", tmp_path / "d", "--json", tmp_path / "j"]
    assert "No such file" in refused(call("diagnose", real, "--nominal", tmp_path / "none", *outputs))
    assert "not a pitp_jax model" in refused(call("diagnose", real, "--nominal", real / "sine2.csv", *outputs))
    refused(call("diagnose", tmp_path / "nothing", "--nominal", nominal, *outputs))
    refused(call("diagnose", real, "--nominal", nominal, "--input-column", "voltage_mV", *outputs))
    volts = tmp_path.parent / f"{tmp_path.name}-volts.csv"
    write_record(volts, *motion("sine2")).write_text(volts.read_text().replace("displacement_m", "displacement_V"))
    assert "predicts m" in refused(call("diagnose", volts, "--nominal", nominal, *outputs))
    assert quick.calls == [] and tree(tmp_path) == []


def test_outputs_do_not_replace_inputs_or_each_other(bench, quick, call, tmp_path):
    (tmp_path / "d").mkdir()
    model_file.save(tmp_path / "d" / "model_augmented", truth())
    start = ["diagnose", bench / "records", "--nominal", tmp_path / "d" / "model_augmented"]
    assert "would overwrite" in refused(call(*start, "--out", tmp_path / "d"))
    assert "is also given as" in refused(call(*start, "--json", tmp_path / "d" / "model_augmented"))
    nominal = ["diagnose", bench / "records", "--nominal", bench / "nominal"]
    refused(call(*nominal, "--out", tmp_path / "d", "--json", tmp_path / "d" / "report.html"))
    refused(call(*nominal, "--json", tmp_path / "no" / "j"))
    assert quick.calls == [] and tree(tmp_path) == ["d", "d/model_augmented"]


@pytest.mark.parametrize("more", [["--order", "2"], ["--input-map", "square"], ["--refit"], ["--seed", "1"]])
def test_what_the_nominal_decides_is_no_option(bench, call, more):
    assert "--help" in refused(call("diagnose", bench / "records", "--nominal", bench / "nominal", *more))


def test_a_nominal_is_required(bench, call):
    assert "--nominal" in refused(call("diagnose", bench / "records"))
    assert call("diagnose", "--help")[0] == 0


@pytest.mark.parametrize(
    ("error", "code"),
    [(BadInput("no"), 2), (ComputationFailed("no"), 3), (MemoryError(), 3), (KeyboardInterrupt(), 130)],
)
def test_a_failed_diagnosis_leaves_nothing(bench, quick, call, tmp_path, error, code):
    quick.error = error
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal"]
    got, out, err = call(*argv, "--out", tmp_path / "d", "--json", tmp_path / "j")
    assert (got, out, tree(tmp_path)) == (code, "", [])
    assert err.splitlines()[-1].startswith("pitp: interrupted" if code == 130 else "pitp: error: ")


@pytest.mark.slow
@pytest.mark.parametrize("files", [1, 2, 3])
def test_a_full_disk_leaves_nothing(bench, quick, call, tmp_path, full_disk, files):
    full_disk(files)
    argv = ["diagnose", bench / "records", "--nominal", bench / "nominal"]
    assert "No space left" in refused(call(*argv, "--out", tmp_path / "a" / "d", "--json", tmp_path / "j"))
    assert tree(tmp_path) == []


def test_steps_are_shown_in_place_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    status = ProgressLine()
    status.update("screening every form")
    for step in range(100):
        status.update(f"fit: step {step}")
    status.close()
    drawn = terminal.getvalue().split("\r\x1b[K")
    assert drawn[1] == "pitp: screening every form\n" and drawn[2] == "fit: step 0" and drawn[-1] == ""
    assert len(drawn) < 20
