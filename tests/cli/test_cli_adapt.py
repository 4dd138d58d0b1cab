"""`pitp adapt` and `pitp info A B`: files written, what is refused, and where a model came from."""

import hashlib
import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from cli_cases import TIME, motion, write_record

from pitp_jax import load, save
from pitp_jax.application.commands.adapt import print_adaptation
from pitp_jax.files.model_file.model_file import digest
from pitp_jax.method.adapt.adaptation import Adaptation, Changed
from pitp_jax.method.model.drive import ElectrodeLag


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """A nominal from a sweep, a recording of the same day and one of a softer spring."""
    from pitp_jax.application.commands.main import main

    root = tmp_path_factory.mktemp("days")
    voltage, displacement = motion("sweep")
    write_record(root / "sweep.csv", voltage, displacement, units=("kV", "mm"))
    rng = np.random.default_rng(0)
    noise = 1e-3 * np.ptp(displacement) * rng.standard_normal(len(TIME))
    write_record(root / "same.csv", voltage, displacement + noise, units=("kV", "mm"))
    write_record(root / "stronger.csv", voltage, 1.1 * displacement + noise, units=("kV", "mm"))
    assert main(["identify", str(root / "sweep.csv"), "--order", "2", "--out", str(root / "m")]) == 0
    return root


def test_unchanged_is_written_bit_for_bit(days, call, tmp_path):
    code, text, _ = call("adapt", days / "m", days / "same.csv", "--out", tmp_path / "a", "--json", tmp_path / "j")
    told = json.loads((tmp_path / "j").read_text())
    assert code == 0 and text.startswith("unchanged") and told["verdict"] == "unchanged" and told["changed"] == {}
    assert set(told) == {"written_by", "verdict", "changed", "before", "after", "heldout", "advice"}
    assert (tmp_path / "a").read_bytes() == (days / "m").read_bytes()


def test_a_change_is_written_and_traced(days, call, tmp_path):
    code, text, _ = call("adapt", days / "m", days / "stronger.csv", "--out", tmp_path / "a", "--json", tmp_path / "j")
    gain = json.loads((tmp_path / "j").read_text())["changed"]["gain"]
    assert code == 0 and text.startswith("adapted")
    assert gain["ci95"][0] <= 1.1 <= gain["ci95"][1]
    code, text, _ = call("info", tmp_path / "a")
    sums = {name: hashlib.sha256((days / f"{name}.csv").read_bytes()).hexdigest() for name in ("sweep", "stronger")}
    assert all(f"{value}  {name}" in text for name, value in sums.items())
    assert f"adapt from {digest(load(days / 'm'))}" in text and "gain times" in text
    assert digest(load(days / "m")).encode() in (days / "m").read_bytes().splitlines()[1]
    code, text, _ = call("compare", days / "m", tmp_path / "a", "--json", tmp_path / "d")
    told = json.loads((tmp_path / "d").read_text())
    assert code == 0 and told["kind"] == "models" and "a was made from m." in text
    assert "Only a saw stronger." in told["remarks"]
    (stiffness,) = [r for r in told["rows"] if r["what"] == "stiffness (a0)"]
    assert stiffness["b"] / stiffness["a"] == pytest.approx(1 / 1.1, rel=0.01)


def test_factors_that_may_be_one_are_marked(days, capsys):
    """An interval that holds 1 shows no change; that of a time says what it is now."""
    changed = {
        "stiffness": Changed(0.95, (0.94, 0.96)),
        "damping": Changed(0.96, (0.75, 1.23)),
        "electrode_tau": Changed(1.02, (0.9, 1.1), 4.4e-3, (4.2e-3, 4.6e-3)),
    }
    model = load(days / "m")
    print_adaptation(Adaptation(model, "adapted", changed, 2.0, 0.2, True, 0.1))
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "though 1" not in lines["stiffness"] and "applied, though 1 lies within" in lines["damping"]
    assert "now 4.4 ms (4.2 to 4.6), applied, though 1" in lines["electrode_tau"]


def test_info_reports_the_learned_lag_of_the_electrode(days, call, tmp_path):
    model = load(days / "m")
    assert "lag of the electrode" not in call("info", days / "m")[1]
    save(tmp_path / "m", replace(model, model=replace(model.model, drive=ElectrodeLag(jnp.log(jnp.asarray(4.38e-3))))))
    code, text, _ = call("info", tmp_path / "m", "--json", tmp_path / "j")
    assert code == 0 and "learned lag of the electrode: 4.38 ms" in text
    assert abs(json.loads((tmp_path / "j").read_text())["electrode_lag_s"] - 4.38e-3) < 1e-8


def test_two_of_the_same_are_the_same(days, call):
    code, text, _ = call("compare", days / "m", days / "m")
    assert code == 0 and "do not differ beyond" in text and "Both hold the same model." in text


def test_bad_input_is_one_line_and_writes_nothing(days, call, tmp_path):
    for argv in (
        (days / "nothing", days / "same.csv"),
        (days / "m", tmp_path),
        (days / "same.csv", days / "same.csv"),
    ):
        code, _, err = call("adapt", *argv, "--out", tmp_path / "a")
        assert code == 2 and len([line for line in err.splitlines() if "error:" in line]) == 1
        assert not (tmp_path / "a").exists()
