"""`pitp diagnose` end to end: what it finds, its JSON, and the model it hands back."""

import contextlib
import io
import json
from dataclasses import dataclass

import numpy as np
import pytest
from cli_cases import COEFFICIENTS, TIME, motion, tree, truth, write_record
from played import FEW
from scipy.signal import lsim

from pitp_jax.application.commands import diagnose as command
from pitp_jax.application.commands.main import main
from pitp_jax.files.model_file import model_file
from pitp_jax.method.diagnose.diagnosis import Diagnosis

TAU = 0.02  # s: the electrode's lag that the nominal does not know
KEYS = {
    "verdict",
    "effects",
    "equivalent",
    "gap",
    "ranking",
    "where",
    "next_experiment",
    "records",
    "pieces",
    "term",
    "clock_shift_s",
    "input_lag_s",
}
KEYS |= {"budget", "handed_back", "parts", "refit", "written_by"}
GAP = {"before", "after", "unrefitted", "noise_floor", "floor_from", "closed_fraction", "ci95", "explainable"}
RANKED = {"effect", "family", "form", "parameters", "train", "heldout", "closed_fraction", "ci95"}
RANKED |= {"probability"}
WHERE = {"cells", "frequency", "displacement", "velocity", "voltage", "time", "records", "harmonics", "summary"}


@dataclass
class Run:
    """One real diagnosis: what it printed, left and found."""

    folder: object
    out: str
    err: str
    found: Diagnosis
    told: dict


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The command on a linear actuator whose electrode lags: three short records, half of the catalogue."""
    folder = tmp_path_factory.mktemp("diagnose")
    (folder / "real").mkdir()
    for name in ("sweep", "sine2", "sine4"):
        voltage, _ = motion(name)
        fine = np.linspace(0, TIME[-1], 16 * (len(TIME) - 1) + 1)  # the film's voltage is curved between samples
        film = lsim(([1.0], [TAU, 1.0]), np.interp(fine, TIME, voltage), fine)[1]
        x = lsim(([1.0], COEFFICIENTS[::-1]), film**2, fine)[1][::16]
        noise = 2e-5 * np.random.default_rng(len(name)).standard_normal(len(TIME))
        write_record(folder / "real" / f"{name}.csv", voltage, x + noise, units=("kV", "mm"))
    model_file.save(folder / "nominal", truth())
    kept, original = [], command.run_diagnosis

    def noted(*args, **options):
        kept.append(original(*args, exclude=FEW, **options))
        return kept[-1]

    out, err = io.StringIO(), io.StringIO()
    paths = ["--out", folder / "new" / "out", "--json", folder / "j"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "run_diagnosis", noted)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([str(a) for a in ("diagnose", folder / "real", "--nominal", folder / "nominal", *paths)])
    assert code == 0, err.getvalue()
    told = json.loads((folder / "j").read_text(), parse_constant=pytest.fail)
    return Run(folder, out.getvalue(), err.getvalue(), kept[0], told)


def test_finds_the_lag_and_says_so(run):
    assert run.told["verdict"] == "explained" and run.told["effects"] == ["electrode_rc"]
    row = run.told["ranking"][0]
    assert row["effect"] == "electrode_rc"
    tau = row["parameters"]["tau"]
    assert (tau["unit"], tau["value"]) == ("s", pytest.approx(TAU, rel=0.02))
    assert run.told["gap"]["closed_fraction"] > 0.95
    assert "verdict: explained by electrode_rc" in run.out
    assert run.out.startswith("The model handed back reduces the error on left-out parts of the recordings from ")
    (part,) = run.told["parts"]
    assert (part["effect"], part["certainty"], run.told["refit"]) == ("electrode_rc", "certain", "no")
    low, high = part["parameters"]["tau"]["ci95"]
    assert low < tau["value"] < high and abs(TAU - tau["value"]) < 2 * (high - low)
    assert "electrode_rc *" in run.out and "closed (95 % interval)" in run.out
    assert "pitp: diagnosing" in run.err and "pitp: sets of 1" in run.err


def test_json_has_the_keys_of_the_contract(run):
    told = run.told
    assert set(told) - {"coefficients_over_given", "added", "notes"} == KEYS
    assert set(told["gap"]) == GAP
    assert set(told["where"]) - {"tone"} == WHERE
    assert set(told["records"]) == {"fitted", "heldout", "folds"}
    assert sorted(told["records"]["fitted"]) == sorted(told["records"]["heldout"]) == ["sine2", "sine4", "sweep"]
    assert sorted(n for fold in told["records"]["folds"] for n in fold) == ["sine2", "sine4", "sweep"]
    assert [note for note in told["notes"] if "parts of each were left out" in note]
    parts = {k: v for k, v in told["budget"].items() if k != "effects"} | told["budget"]["effects"]
    assert sum(p["share"] for p in parts.values()) == pytest.approx(1)
    for row in told["ranking"]:
        assert set(row) == RANKED
        assert all(set(p) == {"value", "unit", "stderr"} for p in row["parameters"].values())
    assert len({row["effect"] for row in told["ranking"]}) == len(told["ranking"])
    for cell in told["where"]["cells"]:
        assert set(cell) == {"band_hz", "amplitude", "share", "flagged"}
    for axis in ("frequency", "displacement", "velocity", "voltage", "time"):
        assert sum(row["share"] for row in told["where"][axis]) == pytest.approx(1)


def test_the_augmented_model_predicts_what_the_nominal_could_not(run, call, tmp_path):
    out = run.folder / "new" / "out"
    assert {"model_augmented", "report.html", "figures/gap.png", "figures/where.csv", "figures/ranking.png"} <= set(
        tree(out)
    )
    assert (out / "figures" / "gap.png").read_bytes().startswith(b"\x89PNG")
    assert "explained by electrode_rc" in (out / "report.html").read_text()
    score = {}
    for name, model in (("before", run.folder / "nominal"), ("after", out / "model_augmented")):
        assert call("predict", model, run.folder / "real", "--json", tmp_path / name)[0] == 0
        score[name] = json.loads((tmp_path / name).read_text())["median_e_rms_percent"]
    assert score["after"] < 0.1 * score["before"]
