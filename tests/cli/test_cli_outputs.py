"""Outputs of every command appear whole or not at all, and never over an input."""

import os

import pytest
from cli_cases import motion, refused, tree, write_record

from pitp_jax._commands import outputs


def test_destinations_are_checked_before_the_work(call, bench, tmp_path, monkeypatch):
    monkeypatch.setattr("pitp_jax._commands.identify.read_records", lambda *a, **k: pytest.fail("read first"))
    monkeypatch.setattr("pitp_jax._commands.fit.read_records", lambda *a, **k: pytest.fail("read first"))
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
    assert "not written by pitp" in refused(call("predict", bench / "nominal", folder, "--json", record))
    assert "not written by pitp" in refused(call("identify", folder, "--out", record))
    assert "already used" in refused(call("identify", folder, "--out", record, "--force"))
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


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize("files", [1, 2, 3, 4])
def test_predict_on_a_full_disk_leaves_nothing(call, bench, tmp_path, full_disk, files, existing):
    out, file = tmp_path / "a" / "d", tmp_path / "j"
    if existing:
        out.mkdir(parents=True)
        (out / "sine2.csv").write_text('{"old": 1}')
        file.write_text('{"old": 1}')
    before = tree(tmp_path)
    full_disk(files)
    argv = ["predict", bench / "nominal", bench / "records", "--out", out, "--json", file]
    assert "No space left" in refused(call(*argv))
    assert tree(tmp_path) == before
    if existing:
        assert (out / "sine2.csv").read_text() == file.read_text() == '{"old": 1}'


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
    assert f"cannot write {tmp_path / 'j'}: No space left" in refused(call(*argv))
    assert tree(tmp_path) == []
