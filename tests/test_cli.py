"""The command line: results, refusals, exit codes, and outputs that appear whole or not at all."""

import csv
import errno
import io
import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from pitp_jax import _decode, _demo, _demo_files, _file, _identify, _inverse, _train
from pitp_jax._commands import outputs
from pitp_jax._commands.console import ProgressBar, say
from pitp_jax._commands.predict import median_e_rms
from pitp_jax._errors import BadInput, ComputationFailed
from pitp_jax._model.encoder import CompactEncoder
from pitp_jax._model.input_map import SquareInput
from pitp_jax._model.model import Output, Provenance, linear_model
from pitp_jax._record import writing
from pitp_jax.cli import main

OMEGA, DAMPING, STIFFNESS = 2 * np.pi * 5, 0.15, 1e9  # V^2/m: 4 mm at 2 kV
COEFFICIENTS = STIFFNESS * np.array([1.0, 2 * DAMPING / OMEGA, 1 / OMEGA**2])
DRIVES = {"sweep": (0.1, 8.0), "sine2": (2.0, 2.0), "sine4": (4.0, 4.0)}
TIME = np.arange(2000) / 500.0
SCORE_KEYS = {
    "e_rms_percent", "nrmse_percent", "rmse", "rmse_unit", "samples", "missing", "diverged",
    "outside_training_share",
}  # fmt: skip


def motion(name):
    """Voltage in V and noisy displacement in m of a known second-order actuator."""
    first, last = DRIVES[name]
    phase = 2 * np.pi * (first * TIME + (last - first) * TIME**2 / (2 * TIME[-1]))
    voltage = 1000 * (1 - np.cos(phase))
    x = lsim(([1.0], COEFFICIENTS[::-1]), voltage**2, TIME)[1]
    return voltage, x + 1e-6 * np.random.default_rng(len(name)).standard_normal(len(TIME))


def write_record(path, voltage, displacement, units=("V", "m"), time=TIME):
    factor = {"V": 1.0, "kV": 1e-3, "m": 1.0, "mm": 1e3, "um": 1e6}
    header = f"time_s,voltage_{units[0]},displacement_{units[1]}"
    columns = (time, voltage * factor[units[0]], displacement * factor[units[1]])
    rows = [",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def truth(**changes):
    provenance = Provenance(0.002, "mm", "kV", (0.0, 2000.0), 5e4, **changes)
    return linear_model(
        COEFFICIENTS, input_map=SquareInput(), state_scale=1e-3 * OMEGA ** np.arange(3), force_scale=4e6,
        output=Output(), hold="foh", substeps=1, provenance=provenance,
    )  # fmt: skip


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with records and a nominal model: read only."""
    root = tmp_path_factory.mktemp("bench")
    (root / "records").mkdir()
    for name in DRIVES:
        write_record(root / "records" / f"{name}.csv", *motion(name), units=("kV", "mm"))
    _file.save(root / "nominal", truth())
    rise = 0.5 * (1 - np.cos(np.pi * np.clip(TIME / 1.0, 0, 1)))
    wanted = 1e-3 * rise * (1.0 + 0.5 * np.sin(2 * np.pi * TIME))
    (root / "target.csv").write_text(
        "time_s,displacement_mm\n" + "".join(f"{t:.6f},{1e3 * x:.9g}\n" for t, x in zip(TIME, wanted, strict=True))
    )
    return root


@pytest.fixture
def call(capsys):
    """Run `pitp` in this process; the exit code, standard output and error."""

    def run(*argv):
        code = main([str(a) for a in argv])
        return code, *capsys.readouterr()

    return run


def refused(result, code=2):
    """One line on standard error, nothing on standard output."""
    got, out, err = result
    errors = [line for line in err.splitlines() if line.startswith("pitp: error: ")]
    assert (got, len(errors), out) == (code, 1, ""), (got, out, err)
    assert "unexpected" not in errors[0]
    return errors[0]


def tree(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


# ---- usage


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["frobnicate"],
        ["identify"],
        ["identify", "x"],
        ["identify", "x", "--out", "y", "--order", "7"],
        ["identify", "x", "--out", "y", "--order", "0"],
        ["identify", "x", "--out", "y", "--order", "two"],
        ["identify", "x", "--out", "y", "--input-map", "cubic"],
        ["fit", "x", "--out", "y", "--seed", "-1"],
        ["fit", "x", "--out", "y", "--seed", "1.5"],
        ["fit", "x", "--out", "y", "--preset", "best"],
        ["fit", "x", "--out", "y", "--ord", "2"],
        ["predict", "m"],
        ["invert", "m", "t"],
        ["invert", "m", "t", "--out", "v", "--max-voltage", "0"],
        ["invert", "m", "t", "--out", "v", "--max-voltage", "nan"],
        ["invert", "m", "t", "--out", "v", "--max-voltage", "inf"],
        ["invert", "m", "t", "--out", "v", "--max-slew", "-5"],
        ["invert", "m", "t", "--out", "v", "--input-column", "voltage_V"],
        ["demo", "--plant", "sphere"],
        ["info"],
    ],
)
def test_usage_errors(call, argv):
    assert "--help" in refused(call(*argv))


@pytest.mark.parametrize("command", [[], ["identify"], ["fit"], ["predict"], ["invert"], ["info"], ["demo"]])
def test_help(call, command):
    code, out, err = call(*command, "--help")
    assert code == 0
    assert out.startswith("usage: pitp")
    assert err == ""


def test_version(call):
    assert call("--version")[:2] == (0, "pitp 0.1.0\n")


def test_the_parser_needs_no_jax():
    code = (
        "import sys, types, importlib.util as u\n"
        "p = types.ModuleType('pitp_jax'); p.__path__ = u.find_spec('pitp_jax').submodule_search_locations\n"
        "sys.modules['pitp_jax'] = p\n"
        "from pitp_jax.cli import main\n"
        "assert main(['--help']) == 0 and main(['fit']) == 2\n"
        "heavy = {'jax', 'numpy', 'scipy', 'equinox', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    # find_spec of a top-level package does not import it
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_module_is_the_program_and_a_closed_pipe_is_quiet(bench):
    command = f"set -o pipefail; '{sys.executable}' -m pitp_jax info '{bench / 'nominal'}' | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_standard_output_on_a_full_disk(bench):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "pitp_jax", "info", str(bench / "nominal")]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("pitp: error: ")


# ---- identify, info


@pytest.fixture(scope="module")
def identified():
    """A real identification, once."""
    from pitp_jax._record.record import Record

    return _identify.identify([Record("sweep", TIME, *motion("sweep"), "kV", "mm")], order=2)


@pytest.fixture
def quick_identify(monkeypatch, identified):
    """`_identify.identify` that only notes what it was called with."""
    calls = []

    def fake(records, **options):
        calls.append(([r.name for r in records], options))
        return identified

    monkeypatch.setattr(_identify, "identify", fake)
    monkeypatch.setattr("pitp_jax._commands.identify.run_identify", fake)
    return calls


def test_identify_writes_and_reports(call, bench, tmp_path, quick_identify):
    out = tmp_path / "nominal"
    code, text, _ = call("identify", bench / "records", "--out", out, "--order", "2", "--json", tmp_path / "j")
    assert code == 0
    assert quick_identify[0][0] == ["sine2", "sine4", "sweep"]
    assert quick_identify[0][1]["order"] == 2
    assert "2 *" in text
    assert "V^2 s^2/m" in text
    assert "mode at 5 Hz, damping 0.15" in text
    np.testing.assert_allclose(_file.load(out).physical_coefficients, COEFFICIENTS, rtol=1e-2)
    assert json.loads((tmp_path / "j").read_text())["order"] == 2


def test_info(call, tmp_path, identified):
    _file.save(tmp_path / "m", identified.model)
    code, text, err = call("info", tmp_path / "m", "--json", tmp_path / "j")
    told = json.loads((tmp_path / "j").read_text())
    assert (code, err) == (0, "")
    assert told["coefficients_unit"] == ["V^2/m", "V^2 s/m", "V^2 s^2/m"]
    assert all(e > 0 for e in told["coefficients_stderr"])
    assert told["modes"][0]["natural_hz"] == pytest.approx(5, rel=1e-2)
    assert "identified on 1 record (sweep)" in text
    assert "hold foh" in text


def test_info_of_a_trained_model(call, tmp_path):
    training = {
        "records": ["a", "b"], "samples": 9, "seconds": 1.5, "interrupted": True,
        "history": [{"stage": 1, "box": [0.6, 1.5], "physics": 0.1}, {"stage": "free runs", "step": 1, "error": 2.0}],
    }  # fmt: skip
    _file.save(tmp_path / "m", truth(notes=json.dumps({"training": training})))
    code, text, _ = call("info", tmp_path / "m")
    assert code == 0
    assert "trained on 2 records (a, b) (9 samples) in 1.5 s, interrupted" in text
    assert "stage 1: box 0.6 to 1.5, physics 0.1" in text


def test_info_of_an_unbounded_model_has_no_infinity(call, tmp_path):
    _file.save(tmp_path / "m", truth().__class__(**{**vars(truth()), "provenance": Provenance(1.0)}))
    assert call("info", tmp_path / "m", "--json", tmp_path / "j")[0] == 0
    assert json.loads((tmp_path / "j").read_text(), parse_constant=pytest.fail)["max_slew"] is None


@pytest.mark.parametrize("command", ["info", "predict", "invert"])
def test_a_model_that_is_none(call, bench, tmp_path, command):
    rest = {
        "info": [],
        "predict": [bench / "records"],
        "invert": [bench / "target.csv", "--out", tmp_path / "v"],
    }
    for path in (tmp_path / "absent", bench, bench / "target.csv"):
        assert str(path) in refused(call(command, path, *rest[command]))
    assert tree(tmp_path) == []


def test_bad_records_are_refused(call, bench, tmp_path):
    (tmp_path / "empty").mkdir()
    voltage, x = motion("sine2")
    write_record(tmp_path / "short.csv", voltage[:10], x[:10], time=TIME[:10])
    write_record(tmp_path / "other.csv", voltage, x, time=TIME * 2)
    before = tree(tmp_path)
    for records in (
        ["absent"],
        [tmp_path / "empty"],
        [tmp_path / "short.csv"],
        [tmp_path, bench / "records"],
    ):
        refused(call("identify", *records, "--out", tmp_path / "m"))
        refused(call("fit", *records, "--out", tmp_path / "m"))
        refused(call("predict", bench / "nominal", *records, "--json", tmp_path / "j", "--out", tmp_path / "d"))
    assert tree(tmp_path) == before


def test_columns_can_be_chosen(call, bench, tmp_path, quick_identify):
    voltage, x = motion("sine2")
    path = write_record(tmp_path / "r.csv", voltage, x, units=("V", "m"))
    path.write_text(path.read_text().replace("voltage_V", "command_V").replace("displacement_m", "laser_um"))
    choice = ["--input-column", "command_V", "--output-column", "laser_um"]
    assert "missing" in refused(call("identify", path, "--out", tmp_path / "m"))
    assert call("identify", path, "--out", tmp_path / "m", *choice)[0] == 0
    assert call("predict", tmp_path / "m", path, "--out", tmp_path / "d", *choice)[0] == 0
    header = (tmp_path / "d" / "r.csv").read_text().splitlines()[0]
    assert header == "time_s,voltage_V,displacement_um,predicted_um"


# ---- destinations


def test_destinations_are_checked_before_the_work(call, bench, tmp_path, monkeypatch):
    monkeypatch.setattr("pitp_jax._commands.identify.read", lambda *a, **k: pytest.fail("read first"))
    monkeypatch.setattr("pitp_jax._commands.fit.read", lambda *a, **k: pytest.fail("read first"))
    (tmp_path / "file").write_text("x")
    record = bench / "records" / "sweep.csv"
    for out in (tmp_path, tmp_path / "no" / "m", tmp_path / "file" / "m", record, f"{tmp_path}/"):
        refused(call("identify", record, "--out", out))
        refused(call("fit", record, "--out", out))
    refused(call("identify", record, "--out", tmp_path / "m", "--json", tmp_path / "m"))
    refused(call("fit", record, "--out", bench / "nominal", "--nominal", bench / "nominal"))
    assert tree(tmp_path) == ["file"]


def test_a_folder_of_records_is_not_overwritten(call, bench, tmp_path):
    folder = tmp_path / "records"
    folder.mkdir()
    record = write_record(folder / "sine2.csv", *motion("sine2"))
    before = record.read_bytes()
    assert "replace" in refused(call("predict", bench / "nominal", folder, "--out", folder))
    assert "already used" in refused(call("predict", bench / "nominal", folder, "--json", record))
    assert "already used" in refused(call("identify", folder, "--out", record))
    assert record.read_bytes() == before
    assert tree(folder) == ["sine2.csv"]


def test_unwritable_output(call, bench, tmp_path, monkeypatch):
    monkeypatch.setattr(outputs.os, "access", lambda *a: False)
    record = bench / "records" / "sine2.csv"
    for argv in (
        ["identify", record, "--out", tmp_path / "m"],
        ["predict", bench / "nominal", record, "--out", tmp_path / "d"],
        ["predict", bench / "nominal", record, "--json", tmp_path / "j"],
        ["invert", bench / "nominal", bench / "target.csv", "--out", tmp_path / "v.csv"],
        ["demo", "--out", tmp_path / "d"],
    ):
        assert "no right to write" in refused(call(*argv))
    assert tree(tmp_path) == []


def test_a_file_where_the_folder_should_be(call, bench, tmp_path):
    (tmp_path / "d").write_text("x")
    record = bench / "records" / "sine2.csv"
    refused(call("predict", bench / "nominal", record, "--out", tmp_path / "d"))
    refused(call("predict", bench / "nominal", record, "--out", tmp_path / "d" / "e"))
    (tmp_path / "f" / "sine2.csv").mkdir(parents=True)
    refused(call("predict", bench / "nominal", record, "--out", tmp_path / "f"))
    assert tree(tmp_path) == ["d", "f", "f/sine2.csv"]


# ---- fit


@pytest.fixture
def trainer(monkeypatch):
    """`_train.train` that only notes what it was called with; set `.result` or `.error` to change its end."""

    @dataclass
    class Trainer:
        calls: list
        error: BaseException | None = None
        interrupted: bool = False

        def __call__(self, nominal, records, **options):
            self.calls.append((nominal, [r.name for r in records], options))
            for step in (1, 2):
                options["progress"](_train.Progress("stage 1", step, 2, 1.5, 0.25, 0.125, 61.0))
            options["progress"](_train.Progress("free runs", 1, 1, None, 0.1, 0.1, float("nan")))
            if self.error:
                raise self.error
            encoder = CompactEncoder(2, 0, width=4, key=options["key"])
            model = replace(nominal, encoder=encoder)
            return _train.Training(model, ({"stage": 1, "physics": 0.5},), self.interrupted, {"seconds": 1.0})

    fake = Trainer([])
    monkeypatch.setattr(_train, "train", fake)
    return fake


def test_fit_from_a_nominal(call, bench, tmp_path, trainer, quick_identify):
    out = tmp_path / "model"
    options = ["--nominal", bench / "nominal", "--order", "2", "--input-map", "square", "--preset", "paper"]
    code, text, err = call("fit", bench / "records", "--out", out, "--seed", "7", *options)
    assert code == 0
    assert quick_identify == []
    _, names, given = trainer.calls[0]
    assert names == ["sine2", "sine4", "sweep"]
    assert given["preset"] == "paper"
    assert "stage 1: 2/2  box 1.5  loss 0.25  best 0.125  about 61 s left" in err
    assert "free runs: 1/1  loss 0.1  best 0.1  about ? left" in err
    assert type(_file.load(out).encoder) is CompactEncoder
    assert "physics 0.5" in text


def test_progress_is_redrawn_in_place_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    bar = ProgressBar()
    for step in range(1, 101):
        bar.update(_train.Progress("stage 1", step, 100, 1.5, 0.25, 0.125, 300.0))
    say("done")
    drawn = terminal.getvalue().split("\r\x1b[K")
    assert drawn[1].startswith("[....................] stage 1: 1/100  box 1.5")
    assert drawn[-2].startswith("[####################] stage 1: 100/100")
    assert drawn[-2].endswith("\n")
    assert drawn[-1] == "pitp: done\n"
    assert 3 <= len(drawn) < 20  # not redrawn faster than can be seen


def test_fit_is_reproducible_by_seed(call, bench, tmp_path, trainer):
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        call("fit", bench / "records", "--out", tmp_path / name, "--nominal", bench / "nominal", "--seed", seed)
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c


@pytest.mark.parametrize("found", [["sweep"], []])
def test_fit_identifies_on_sweeps_else_on_all(call, bench, tmp_path, trainer, quick_identify, monkeypatch, found):
    monkeypatch.setattr(_identify, "is_sweep", lambda record: record.name in found)
    code, _, err = call("fit", bench / "records", "--out", tmp_path / "m", "--order", "2")
    assert code == 0
    assert quick_identify[0][0] == (found or ["sine2", "sine4", "sweep"])
    assert quick_identify[0][1] | {"order": 2, "input_map": "square"} == quick_identify[0][1]
    assert ("1 record (sweep)" if found else "no record is a sweep") in err
    assert trainer.calls[0][1] == ["sine2", "sine4", "sweep"]


def test_fit_refuses_options_that_contradict_the_nominal(call, bench, tmp_path, trainer):
    start = ["fit", bench / "records", "--out", tmp_path / "m", "--nominal", bench / "nominal"]
    assert "--order 3 contradicts" in refused(call(*start, "--order", "3"))
    assert "--input-map linear contradicts" in refused(call(*start, "--input-map", "linear"))
    assert trainer.calls == []
    assert call(*start, "--order", "auto")[0] == 0


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
    assert _file.load(tmp_path / "m").order == 2


def test_interrupted_identify_writes_nothing(call, bench, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("pitp_jax._commands.identify.run_identify", stop)
    assert call("identify", bench / "records", "--out", tmp_path / "m")[0] == 130
    assert tree(tmp_path) == []


# ---- predict


def columns_of(path):
    rows = list(csv.reader(path.read_text().splitlines()))
    values = np.array([[float(c) if c else np.nan for c in row] for row in rows[1:]])
    return rows[0], values


def test_predict_writes_scores_and_records_in_their_own_units(call, bench, tmp_path):
    out, file = tmp_path / "new" / "folder", tmp_path / "scores.json"
    code, text, err = call("predict", bench / "nominal", bench / "records", "--out", out, "--json", file)
    assert (code, err) == (0, "")
    result = json.loads(file.read_text())
    assert list(result) == ["records", "median_e_rms_percent"]
    assert set(result["records"]) == set(DRIVES)
    for name, row in result["records"].items():
        assert set(row) == SCORE_KEYS
        assert row["rmse_unit"] == "mm"
        assert row["rmse"] == pytest.approx(1e-3, rel=0.2)  # the noise: 1 um
        assert (row["samples"], row["missing"], row["diverged"]) == (2000, 0, False)
        header, values = columns_of(out / f"{name}.csv")
        assert header == ["time_s", "voltage_kV", "displacement_mm", "predicted_mm"]
        voltage, x = motion(name)
        np.testing.assert_allclose(values[:, 0], TIME, atol=1e-9)
        np.testing.assert_allclose(values[:, 1], voltage / 1e3, atol=1e-8)
        np.testing.assert_allclose(values[:, 2], x * 1e3, atol=1e-7)
        assert np.sqrt(np.mean((values[:, 3] - values[:, 2]) ** 2)) == pytest.approx(row["rmse"], rel=1e-4)
    assert result["median_e_rms_percent"] == np.median([row["e_rms_percent"] for row in result["records"].values()])
    assert "median e_rms" in text
    assert tree(tmp_path) == sorted(
        ["new", "new/folder", "scores.json", *(f"new/folder/{name}.csv" for name in DRIVES)]
    )


def test_predict_counts_missing_samples_and_names_moving_records(call, bench, tmp_path):
    voltage, x = motion("sine4")
    gaps = x.copy()
    gaps[700:720] = np.nan
    moving = write_record(tmp_path / "moving.csv", voltage[315:], gaps[315:], time=TIME[315:])
    assert call("predict", bench / "nominal", moving, "--json", tmp_path / "j", "--out", tmp_path / "d")[0] == 0
    code, text, _ = call("predict", bench / "nominal", moving, "--json", tmp_path / "j")
    assert code == 0
    assert "moving: starts moving; initial state estimated from the first 50 samples" in text
    row = json.loads((tmp_path / "j").read_text())["records"]["moving"]
    assert (row["samples"], row["missing"]) == (1685, 20)
    assert row["e_rms_percent"] < 2
    _, values = columns_of(tmp_path / "d" / "moving.csv")
    assert np.isnan(values[:, 2]).sum() == 20
    assert np.isfinite(values[:, 3]).all()


def test_predict_gives_names_that_collide_their_folders(call, bench, tmp_path):
    for folder in ("clean", "worn"):
        (tmp_path / folder).mkdir()
        write_record(tmp_path / folder / "sine2.csv", *motion("sine2"))
    out = tmp_path / "out"
    assert call("predict", bench / "nominal", tmp_path / "clean", tmp_path / "worn", "--out", out)[0] == 0
    assert tree(out) == ["clean", "clean/sine2.csv", "worn", "worn/sine2.csv"]


@pytest.fixture
def diverging(monkeypatch):
    """`_decode.predict` in which the named records leave every range half way."""
    real, names = _decode.predict, set()

    def fake(model, records):
        lost = []
        for p in real(model, records):
            x = np.where(np.arange(len(p.displacement)) < 1000, p.displacement, np.nan)
            lost.append(replace(p, displacement=x, diverged=True) if p.name in names else p)
        return tuple(lost)

    monkeypatch.setattr(_decode, "predict", fake)
    return names


@pytest.mark.parametrize(("lost", "median"), [(["sine2"], True), (["sine2", "sine4"], False)])
def test_predict_with_diverged_records(call, bench, tmp_path, diverging, lost, median):
    diverging.update(lost)
    argv = [
        "predict",
        bench / "nominal",
        bench / "records",
        "--json",
        tmp_path / "j",
        "--out",
        tmp_path / "d",
    ]
    code, text, _ = call(*argv)
    assert code == 0
    assert text.count("diverged") == len(lost)
    result = json.loads((tmp_path / "j").read_text(), parse_constant=pytest.fail)
    row = result["records"]["sine2"]
    assert [row[k] for k in ("e_rms_percent", "nrmse_percent", "rmse", "diverged")] == [
        None,
        None,
        None,
        True,
    ]
    assert (result["median_e_rms_percent"] is not None) == median
    assert np.isnan(columns_of(tmp_path / "d" / "sine2.csv")[1][:, 3]).sum() == 1000


def test_predict_fails_only_where_all_diverge(call, bench, tmp_path, diverging):
    diverging.update(DRIVES)
    code, _, err = call("predict", bench / "nominal", bench / "records", "--json", tmp_path / "j")
    assert code == 3
    assert len(err.splitlines()) == 1
    assert json.loads((tmp_path / "j").read_text())["median_e_rms_percent"] is None


def test_median_counts_diverged_as_infinite():
    def row(value, diverged=False):
        return {"e_rms_percent": value, "diverged": diverged}

    assert median_e_rms([row(1.0), row(3.0)]) == 2.0
    assert median_e_rms([row(1.0), row(None, diverged=True)]) is None
    assert median_e_rms([row(1.0), row(2.0), row(None, diverged=True)]) == 2.0
    assert median_e_rms([row(None), row(4.0)]) == 4.0  # a record that never moves has no range to divide by
    assert median_e_rms([row(None)]) is None


def test_predict_refuses_another_kind_of_output_and_warns_of_another_rate(call, bench, tmp_path):
    voltage, x = motion("sine2")
    volts = write_record(tmp_path / "volts.csv", voltage, x)
    volts.write_text(volts.read_text().replace("displacement_m", "displacement_V"))
    assert "predicts m" in refused(call("predict", bench / "nominal", volts))
    slow = write_record(tmp_path / "slow.csv", voltage[::2], x[::2], time=TIME[::2])
    code, _, err = call("predict", bench / "nominal", slow)
    assert code == 0
    assert err.startswith("pitp: warning: ")


@pytest.fixture
def full_disk(monkeypatch):
    """Writing fails from the n-th file on: `full_disk(n)`."""
    real, count = writing._replace, []

    def set_limit(n):
        def fake(target, data):
            count.append(target)
            if len(count) >= n:
                raise OSError(errno.ENOSPC, "No space left on device")
            real(target, data)

        monkeypatch.setattr(writing, "_replace", fake)

    return set_limit


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("files", [1, 2, 3, 4])
def test_predict_on_a_full_disk_leaves_nothing(call, bench, tmp_path, full_disk, files, existing):
    out, file = tmp_path / "a" / "d", tmp_path / "j"
    if existing:
        out.mkdir(parents=True)
        (out / "sine2.csv").write_text("old")
        file.write_text("old")
    before = tree(tmp_path)
    full_disk(files)
    argv = ["predict", bench / "nominal", bench / "records", "--out", out, "--json", file]
    assert "No space left" in refused(call(*argv))
    assert tree(tmp_path) == before
    if existing:
        assert (out / "sine2.csv").read_text() == file.read_text() == "old"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_full_device(call, bench, tmp_path, quick_identify, quick_inverse):
    model, records = bench / "nominal", bench / "records"
    for argv in (
        ["identify", records, "--out", "/dev/full"],
        ["identify", records, "--out", tmp_path / "m", "--json", "/dev/full"],
        ["predict", model, records, "--out", tmp_path / "d", "--json", "/dev/full"],
        ["invert", model, bench / "target.csv", "--out", "/dev/full"],
        ["invert", model, bench / "target.csv", "--out", tmp_path / "v.csv", "--json", "/dev/full"],
    ):
        assert "/dev/full: No space left" in refused(call(*argv))
    assert tree(tmp_path) == []


# ---- invert


@pytest.fixture
def quick_inverse(monkeypatch):
    """`_inverse.feedforward` that only notes its limits."""
    calls = []

    def fake(model, target, *, max_voltage=None, max_slew=None):
        calls.append((target, max_voltage, max_slew))
        time = np.arange(-100, 2100) * target.dt
        count, inside = len(time), (time >= 0) & (time < 4)
        return _inverse.Feedforward(
            time=time, voltage=np.linspace(0, 1500, count), infeasible=np.arange(count) < 7,
            saturated=np.arange(count) < 3, target=inside, outside_training_share=0.25,
            self_check_e_rms_percent=float("nan"), equation_e_rms_percent=0.5,
            warnings=("25 % of the target lies outside\nthe trained region",),
        )  # fmt: skip

    monkeypatch.setattr(_inverse, "feedforward", fake)
    return calls


def test_invert_writes_the_voltage_and_counts(call, bench, tmp_path, quick_inverse):
    out, file = tmp_path / "v.csv", tmp_path / "j"
    limits = ["--max-voltage", "1500", "--max-slew", "2e4"]
    code, text, err = call("invert", bench / "nominal", bench / "target.csv", "--out", out, "--json", file, *limits)
    assert code == 0
    assert err == "pitp: warning: 25 % of the target lies outside the trained region\n"
    assert quick_inverse[0][1:] == (1500.0, 2e4)
    assert quick_inverse[0][0].displacement.max() == pytest.approx(1.5e-3, rel=1e-2)
    header, values = columns_of(out)
    assert header == ["time_s", "voltage_V", "infeasible", "saturated"]
    assert values.shape == (2200, 4)
    assert json.loads(file.read_text(), parse_constant=pytest.fail) == {
        "samples": 2200, "infeasible": 7, "saturated": 3, "outside_training_share": 0.25,
        "self_check_e_rms_percent": None,
    }  # fmt: skip
    assert "infeasible 7, saturated 3" in text


def test_invert_on_a_full_disk_leaves_nothing(call, bench, tmp_path, quick_inverse, full_disk):
    full_disk(2)
    argv = [
        "invert",
        bench / "nominal",
        bench / "target.csv",
        "--out",
        tmp_path / "v.csv",
        "--json",
        tmp_path / "j",
    ]
    assert f"cannot write {tmp_path / 'j'}: No space left" in refused(call(*argv))
    assert tree(tmp_path) == []


def test_invert_refuses_bad_targets_and_names(call, bench, tmp_path, quick_inverse):
    target = bench / "target.csv"
    start = ["invert", bench / "nominal"]
    refused(call(*start, bench / "records", "--out", tmp_path / "v.csv"))
    refused(call(*start, tmp_path / "absent.csv", "--out", tmp_path / "v.csv"))
    refused(call(*start, target, "--out", target))
    refused(call(*start, target, "--out", tmp_path / "v.csv", "--output-column", "laser_mm"))
    volts = tmp_path / "volts.csv"
    volts.write_text(target.read_text().replace("displacement_mm", "displacement_V"))
    assert "predicts m" in refused(call(*start, volts, "--out", tmp_path / "v.csv"))
    assert tree(tmp_path) == ["volts.csv"]
    assert quick_inverse == []


def test_invert_takes_another_column(call, bench, tmp_path, quick_inverse):
    path = tmp_path / "t.csv"
    path.write_text((bench / "target.csv").read_text().replace("displacement_mm", "wanted_um"))
    argv = ["invert", bench / "nominal", path, "--out", tmp_path / "v.csv", "--output-column", "wanted_um"]
    assert call(*argv)[0] == 0
    assert quick_inverse[0][0].displacement.max() == pytest.approx(1.5e-6, rel=1e-2)


# ---- demo, end to end


def test_demo_keeps_whole_or_nothing(call, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ComputationFailed("no order")

    monkeypatch.setattr(_demo, "run", fail)
    refused(call("demo", "--out", tmp_path / "d"), code=3)
    (tmp_path / "f").write_text("")
    refused(call("demo", "--out", tmp_path / "f"))
    assert tree(tmp_path) == ["f"]


@pytest.mark.parametrize("name", ["cone100", "cone122", "cone150", "roll"])
@pytest.mark.parametrize("quick", [False, True])
def test_demo_trains_on_every_cell_of_the_tables(name, quick):
    train = [e.name for e in _demo.excitations(name, "train", quick)]
    test = [e.name for e in _demo.excitations(name, "test", quick)]
    amplitude = _demo.SCALES[_demo.kind(name)].amplitude
    for f in (*_demo.PREDICTION_PAPER[name], *_demo.TRACKING_PAPER[name]):
        assert f"sine_{f:03.0f}Hz_{amplitude:.0f}V" in train
    assert not set(train) & set(test)
    assert len(_demo.excitations(name, "sweep", quick)) == 1


@pytest.mark.slow
def test_demo_quick(call, tmp_path):
    code, text, _ = call("demo", "--plant", "cone100", "--quick", "--out", tmp_path / "d")
    assert code == 0
    assert "Table I" in text
    assert tree(tmp_path / "d") == sorted(_demo_files.FILES)
    assert _file.load(tmp_path / "d" / "model.pitp").order >= 2


def test_end_to_end(call, bench, tmp_path, monkeypatch):
    """The four verbs themselves, on a linear actuator, with little training."""
    short = replace(_train.PRESETS["default"], epochs=3, stages=1, refine_steps=10, width=8)
    monkeypatch.setitem(_train.PRESETS, "default", short)
    nominal, model, records = tmp_path / "nominal", tmp_path / "model", bench / "records"
    assert call("identify", records / "sweep.csv", "--out", nominal, "--order", "2")[0] == 0
    assert call("fit", records, "--nominal", nominal, "--out", model)[0] == 0
    assert call("info", model)[0] == 0
    assert call("predict", model, records, "--json", tmp_path / "j", "--out", tmp_path / "d")[0] == 0
    assert json.loads((tmp_path / "j").read_text())["median_e_rms_percent"] < 5
    out = tmp_path / "v.csv"
    code, _, err = call("invert", model, bench / "target.csv", "--out", out, "--json", tmp_path / "i")
    assert code == 0, err
    told = json.loads((tmp_path / "i").read_text())
    assert told["self_check_e_rms_percent"] < 5
    header, values = columns_of(out)
    assert header == ["time_s", "voltage_V", "infeasible", "saturated"]
    assert len(values) == told["samples"]
    assert values[:, 1].max() <= 2001.0
    x = lsim(([1.0], COEFFICIENTS[::-1]), values[:, 1] ** 2, np.arange(len(values)) * 0.002)[1]
    assert 1e3 * x.max() == pytest.approx(1.5, rel=0.1)
    assert jnp.isfinite(_file.load(model).coefficients).all()
