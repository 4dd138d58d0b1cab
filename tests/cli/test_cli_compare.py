"""`pitp compare`: what it opens, what it writes, what it refuses."""

import json

import numpy as np
import pytest
from cli_cases import refused, tree, truth

from pitp_jax.application.commands.compare import _names
from pitp_jax.files.model_file import model_file


@pytest.mark.slow
def test_records_of_one_drive_make_a_page_and_figures(call, bench, tmp_path):
    """Two copies of the same recordings do not differ; one with 10 % more motion does."""
    (tmp_path / "again").mkdir()
    for path in sorted((bench / "records").glob("*.csv")):
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        table[:, 2] *= 1.1
        header = path.read_text().splitlines()[0]
        np.savetxt(tmp_path / "again" / path.name, table, delimiter=",", header=header, comments="")
    code, text, err = call(
        "compare", bench / "records", tmp_path / "again", "--out", tmp_path / "c", "--json", tmp_path / "j"
    )
    assert code == 0, err
    told = json.loads((tmp_path / "j").read_text())
    assert told["names"] == ["records", "again"] and told["differs"]
    sizes = [r["b"] / r["a"] for r in told["rows"] if "size of the motion" in r["what"]]
    assert len(sizes) == 3 and np.allclose(sizes, 1.1, rtol=1e-3)
    assert {"compare.html", "figures/pair_sweep.csv", "figures/pair_sweep.png"} <= set(tree(tmp_path / "c"))
    assert "size of the motion" in text


def test_the_folder_of_a_diagnosis_is_opened_as_its_model(call, tmp_path):
    """Its CSV files are no recordings."""
    (tmp_path / "monday").mkdir()
    (tmp_path / "monday" / "figure.csv").write_text("time_s,voltage_V,displacement_mm\n0,0,0\n")
    for place in (tmp_path / "monday" / "model_augmented", tmp_path / "tuesday"):
        model_file.save(place, truth())
    code, text, _ = call("compare", tmp_path / "monday", tmp_path / "tuesday")
    assert code == 0 and "Both hold the same model." in text


def test_what_is_not_of_one_kind_is_refused(call, bench, tmp_path):
    model_file.save(tmp_path / "m", truth())
    assert "give two of the same kind" in refused(call("compare", tmp_path / "m", bench / "records"))
    assert f"pitp compare {tmp_path / 'm'} {tmp_path / 'n'}" in refused(call("info", tmp_path / "m", tmp_path / "n"))


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (("mon/rig/m", "tue/rig/m"), ["mon/rig/m", "tue/rig/m"]),
        (("mon/rig/m", "mon/cell/m"), ["rig/m", "cell/m"]),
        (("mon/rig/m", "mon/rig/n"), ["m", "n"]),
        (("mon/rig/m", "mon/rig/../rig/m"), ["m", "m"]),
    ],
)
def test_two_files_of_one_name_are_told_apart_by_the_folders_that_differ(paths, names, tmp_path):
    assert list(_names(*(str(tmp_path / path) for path in paths))) == names
