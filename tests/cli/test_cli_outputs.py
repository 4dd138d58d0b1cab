"""Outputs of every command appear whole or not at all, and never over an input."""

import json
import os
import re

import numpy as np
import pandas as pd
import pytest
from cli_cases import motion, refused, tree, write_record
from scipy.signal import lfilter

from pitp_jax.application.commands import outputs
from pitp_jax.common.page import Page

OLD = '{\n  "written_by": "pitp_jax 0.1"\n}'


def test_destinations_are_checked_before_the_work(call, bench, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "pitp_jax.application.commands.identify.read_records", lambda *a, **k: pytest.fail("read first")
    )
    monkeypatch.setattr("pitp_jax.application.commands.fit.read_records", lambda *a, **k: pytest.fail("read first"))
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
    assert "would overwrite" in refused(call("predict", bench / "nominal", folder, "--out", folder))
    assert "is also given as" in refused(call("predict", bench / "nominal", folder, "--json", record))
    assert "is also given as" in refused(call("identify", folder, "--out", record, "--force"))
    assert "not written by pitp" in refused(call("identify", bench / "records", "--out", record))
    assert record.read_bytes() == before
    assert tree(folder) == ["sine2.csv"]


def test_json_of_others_is_not_replaced(call, bench, tmp_path):
    """A result of pitp is replaced by the next one; settings of the user are not, unless --force is given."""
    ours, other = tmp_path / "ours.json", tmp_path / "settings.json"
    other.write_text('{\n  "my": "settings"\n}')
    assert "was not written by pitp" in refused(call("info", bench / "nominal", "--json", other))
    assert json.loads(other.read_text()) == {"my": "settings"}
    for file, more in ((ours, ()), (ours, ()), (other, ("--force",))):
        assert call("info", bench / "nominal", "--json", file, *more)[0] == 0
        assert json.loads(file.read_text())["order"] == 2


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
        assert "no permission to write" in refused(call(*argv))
    assert tree(tmp_path) == []


def test_a_file_where_the_folder_should_be(call, bench, tmp_path):
    (tmp_path / "d").write_text("x")
    record = bench / "records" / "sine2.csv"
    refused(call("predict", bench / "nominal", record, "--out", tmp_path / "d"))
    refused(call("predict", bench / "nominal", record, "--out", tmp_path / "d" / "e"))
    (tmp_path / "f" / "sine2.csv").mkdir(parents=True)
    refused(call("predict", bench / "nominal", record, "--out", tmp_path / "f"))
    assert tree(tmp_path) == ["d", "f", "f/sine2.csv"]


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("files", [1, 2, 3, 4])
def test_predict_on_a_full_disk_leaves_nothing(call, bench, tmp_path, full_disk, files, existing):
    out, file = tmp_path / "a" / "d", tmp_path / "j"
    if existing:
        out.mkdir(parents=True)
        (out / "sine2.csv").write_text(OLD)
        file.write_text(OLD)
    before = tree(tmp_path)
    full_disk(files)
    argv = ["predict", bench / "nominal", bench / "records", "--out", out, "--json", file]
    assert "No space left" in refused(call(*argv))
    assert tree(tmp_path) == before
    if existing:
        assert (out / "sine2.csv").read_text() == file.read_text() == OLD


@pytest.mark.slow
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
    assert f"cannot write {tmp_path / 'v.csv'}: No space left" in refused(call(*argv))
    assert tree(tmp_path) == []


def test_an_index_links_every_page_of_a_folder_and_leaves_what_is_not_ours(tmp_path):
    page = Page("Two < three", "", []).html()
    with outputs.staged(folder=tmp_path / "d") as stage:
        (stage / "check.html").write_text(page)
    (tmp_path / "d" / "hand.html").write_text("<title>mine</title>")
    (tmp_path / "d" / "knee").mkdir()
    (tmp_path / "d" / "knee" / "a b.html").write_text(page)
    with outputs.staged(folder=tmp_path / "d") as stage:
        (stage / "report.html").write_text(Page("verdict", "", []).html())
    index = (tmp_path / "d" / "index.html").read_text()
    links = re.findall('href="(.*?)">.*?<span class="soft">(.*?)</span>', index)
    assert links == [
        ("check.html", "Two &lt; three"),
        ("knee/a%20b.html", "Two &lt; three"),
        ("report.html", "verdict"),
    ]
    (tmp_path / "d" / "index.html").write_text("my own site")
    with outputs.staged(folder=tmp_path / "d") as stage:
        (stage / "report.html").write_text(page)
    assert (tmp_path / "d" / "index.html").read_text() == "my own site"


def test_a_folder_without_pages_has_no_index(tmp_path):
    with outputs.staged(folder=tmp_path / "d") as stage:
        (stage / "a.csv").write_text("x")
    assert tree(tmp_path / "d") == ["a.csv"]


def test_joints_of_a_log_are_linked_from_the_folder_above(call, tmp_path):
    rows = [f"{k / 100:.2f},{a:.6f},{a:.6f},{-a:.6f}" for k, a in enumerate(np.sin(np.arange(400) / 30))]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,cmd (rad),knee (rad),hip (rad)", *rows]))
    each = ["--each", "knee=cmd (rad),knee (rad)", "--each", "hip=cmd (rad),hip (rad)"]
    code, _, err = call("check", tmp_path / "log.csv", *each, "--out", tmp_path / "d")
    assert code == 0, err
    index = (tmp_path / "d" / "index.html").read_text()
    assert re.findall('href="(.*?)"', index) == ["hip/check.html", "knee/check.html"]


def test_two_folders_spell_the_columns_of_a_joint_differently(call, tmp_path):
    """The joints are named in each folder's pitp.toml; the command runs once for each of them."""
    time, names = np.arange(400) / 100, ("knee", "hip")
    motions = [np.sin(3 * time) * (time > 0.5), np.sin(7 * time) * (time > 0.5)]
    for folder, stem in (("sim", "q"), ("robot", "joint angle ")):
        (tmp_path / folder).mkdir()
        header = ",".join(["time_s", *(f"{stem}{n} cmd,{stem}{n}" for n in names)])
        rows = np.column_stack([time, *(column for y in motions for column in (y, 0.9 * y))])
        np.savetxt(tmp_path / folder / "log.csv", rows, delimiter=",", header=header, comments="")
        each = ", ".join(f'"{n}={stem}{n} cmd,{stem}{n}"' for n in names)
        units = 'input-unit = "rad"\noutput-unit = "rad"\n'
        (tmp_path / folder / "pitp.toml").write_text(f'["*.csv"]\neach = [{each}]\n{units}')
    code, out, err = call("compare", tmp_path / "sim", tmp_path / "robot", "--json", tmp_path / "c.json")
    assert code == 0, err
    assert re.findall("== (.*)", out) == ["knee", "hip"]
    for name in names:
        pairs = json.loads((tmp_path / f"c.{name}.json").read_text())["pairs"]
        assert [round(p["correlation"], 6) for p in pairs] == [1.0]


def test_joints_of_a_parquet_file_speak_of_their_own_units(call, tmp_path):
    """One drive in degrees: no volts of an amplifier's monitor, and levels in degrees."""
    pytest.importorskip("pyarrow")
    t = np.arange(3000) / 100
    u, log = 20 + 10 * np.sin(2 * t), tmp_path / "log.parquet"
    answer = np.asarray(lfilter([0.02], [1, -1.96, 0.98], u))
    pd.DataFrame({"time_s": t, "cmd (deg)": u, "knee (deg)": answer, "hip (deg)": -answer}).to_parquet(log)
    each = ["--each", "knee=cmd (deg),knee (deg)", "--each", "hip=cmd (deg),hip (deg)"]
    code, out, err = call("check", log, *each)
    assert code == 0 and out.count("== ") == 2, err
    assert "monitor" not in out and " V" not in out and "at rest at 0 deg" in out, out
