"""Every verb that reads a model reads the models of every verb that makes one."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_cases import COEFFICIENTS, TIME, motion, truth, write_record

from pitp_jax.application.commands.main import main
from pitp_jax.files.model_file.model_file import load, save
from pitp_jax.method.diagnose.library import _UNIT, model_of, slots_of

STORED = Path(__file__).parents[1] / "files" / "models_0_2_0"


def run(*argv):
    assert main([str(a) for a in argv]) == 0, argv


def identified(bench, out):
    run("identify", bench / "records", "--order", 2, "--no-delay", "--out", out)


def adapted(bench, out):
    voltage, displacement = motion("sweep")
    day = write_record(out.with_suffix(".csv"), voltage, 1.1 * displacement, units=("kV", "mm"))
    run("adapt", bench / "nominal", day, "--out", out)


def diagnosed(bench, out, nominal=None, seconds=20):
    """The nominal diagnosed on a creeping actuator, as it is handed back."""
    folder = out.with_suffix("")
    for name in ("sweep", "sine2", "sine4"):
        voltage, displacement = motion(name)
        lag = np.zeros(len(TIME))
        for k in range(1, len(TIME)):
            lag[k] = lag[k - 1] + (displacement[k] - lag[k - 1]) * (TIME[1] / 0.5)
        path = out.with_name(f"{name}.csv")
        write_record(path, voltage, displacement + 0.2 * lag, units=("kV", "mm"))
    files = [out.with_name(f"{name}.csv") for name in ("sweep", "sine2", "sine4")]
    run("diagnose", *files, "--nominal", nominal or bench / "nominal", "--seconds", seconds, "--out", folder)
    out.write_bytes((folder / "model_augmented").read_bytes())


def of_another_order(bench, out):
    """What a diagnosis hands back of a nominal of order 1 with standard errors, where the machine has a mass."""
    # a model with its origin, where a model is asked for
    nominal: Any = truth(COEFFICIENTS[:2], covariance=1e-4 * np.eye(2), stderr=tuple(1e-2 * COEFFICIENTS[:2]))
    slots = slots_of(nominal.model)[0]
    made, _ = model_of(slots, np.where(np.arange(len(slots)) == 2, 0.05, slots), nominal, _UNIT)
    assert made.order == 2
    save(out, made)


def against(bench, out):
    robot, simulator = out.with_name("robot"), out.with_name("sim")
    for folder, factor in ((robot, 1.2), (simulator, 1.0)):
        folder.mkdir()
        for name in ("sweep", "sine2", "sine4"):
            voltage, displacement = motion(name)
            write_record(folder / f"{name}.csv", voltage, factor * displacement, units=("kV", "mm"))
    folder = out.with_suffix("")
    run("diagnose", robot, "--against", simulator, "--seconds", 20, "--out", folder)
    out.write_bytes((folder / "model_augmented").read_bytes())


def copied(name):
    return lambda bench, out: out.write_bytes((STORED / f"{name}.pitp").read_bytes())


MADE: dict[str, Callable] = {
    "identify": identified,
    "fit": copied("trained_by_train"),
    "adapt": adapted,
    "adapt of a trained model": copied("adapted_by_adapt"),
    "diagnose, every port": copied("one_effect_of_every_port"),
    "diagnose, another order": of_another_order,
}
QUICK = ("adapt", "diagnose, another order")
BY_DIAGNOSIS: dict[str, Callable] = {
    "diagnose": diagnosed,
    "diagnose, trained nominal": lambda bench, out: diagnosed(bench, out, STORED / "trained_by_train.pitp"),
    "against": against,
}
USED: dict[str, Callable] = {
    "info": lambda model, bench, out: ("info", model, "--json", out),
    "predict": lambda model, bench, out: ("predict", model, bench / "records" / "sine2.csv"),
    "simulate": lambda model, bench, out: ("simulate", model, bench / "records" / "sine2.csv", "--out", out),
    "invert": lambda model, bench, out: ("invert", model, bench / "target.csv", "--out", out),
    "adapt": lambda model, bench, out: ("adapt", model, bench / "records" / "sine4.csv", "--out", out),
    "export": lambda model, bench, out: ("export", model, "--to", "c", "--time-constant", "inf", "--out", out),
    "compare": lambda model, bench, out: ("compare", model, bench / "nominal"),
    "plan": lambda model, bench, out: ("plan", model, "--out", out),
    "diagnose": lambda model, bench, out: (
        "diagnose", bench / "records", "--nominal", model, "--seconds", "1", "--json", out),
}  # fmt: skip


@pytest.fixture(scope="module")
def made(bench, tmp_path_factory):
    """fn(name): the file of a model, made once."""
    kept: dict[str, Path] = {}

    def make(name):
        if name not in kept:
            kept[name] = tmp_path_factory.mktemp("made") / "model.pitp"
            (MADE | BY_DIAGNOSIS)[name](bench, kept[name])
        return kept[name]

    return make


@pytest.mark.parametrize("use", [u for u in USED if u != "diagnose"])
@pytest.mark.parametrize("name", [pytest.param(m, marks=[] if m in QUICK else pytest.mark.slow) for m in MADE])
def test_every_verb_reads_every_model(made, bench, tmp_path, name, use):
    assert main([str(a) for a in USED[use](made(name), bench, tmp_path / "out")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("use", USED)
@pytest.mark.parametrize("name", BY_DIAGNOSIS)
def test_every_verb_reads_what_a_diagnosis_hands_back(made, bench, tmp_path, name, use):
    assert main([str(a) for a in USED[use](made(name), bench, tmp_path / "out")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_a_diagnosis_reads_every_model(made, bench, tmp_path, name):
    assert main([str(a) for a in USED["diagnose"](made(name), bench, tmp_path / "out")]) == 0


def test_a_stored_model_of_another_order_keeps_no_standard_errors(tmp_path, capsys):
    """A diagnosis of 0.2.0 wrote the nominal's standard errors beside more coefficients; `info` crashed on them."""
    given = truth(covariance=np.eye(2), stderr=(1.0, 2.0))
    save(tmp_path / "m", given)
    assert load(tmp_path / "m").origin.stderr == ()
    run("info", tmp_path / "m", "--json", tmp_path / "j")
    assert json.loads((tmp_path / "j").read_text())["coefficients_stderr"] == [None, None, None]
    save(tmp_path / "m", replace(given, origin=replace(given.origin, stderr=(1.0, 2.0, 3.0), covariance=np.eye(3))))
    assert load(tmp_path / "m").origin.stderr == (1.0, 2.0, 3.0)
