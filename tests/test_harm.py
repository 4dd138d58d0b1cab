"""Files that mean harm or are merely broken are refused at once, in one line, and without much memory."""

import gzip
import io
import os
import struct
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from effort import read_within
from record_files import (
    OUTPUT,
    TIME,
    VOLTAGE,
    T,
    columns,
    refused,
    save_csv,
    save_csv_gz,
    save_h5,
    save_npz,
    save_xlsx,
    text,
)

from pitp_jax import read
from pitp_jax.application.commands import main as cli

MEMORY = 100  # MiB: a third of what the bombs hold
LINUX = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the limit is Linux's")


@pytest.mark.slow
@LINUX
def test_a_file_that_needs_more_memory_than_allowed_fails_so(tmp_path):
    """The limit that the next tests stand on does bite."""
    save_npz(tmp_path / "small.npz", columns())
    many = np.arange(6_000_000) / 1e3
    save_npz(tmp_path / "a.npz", {"time_s": many, "voltage_V": many, "displacement_mm": many})
    with pytest.raises(MemoryError):
        read_within(MEMORY, tmp_path / "small.npz", tmp_path / "a.npz")


@LINUX
@pytest.mark.parametrize("name", ["a.csv.gz", *(pytest.param(n, marks=pytest.mark.slow) for n in ("a.npz", "a.xlsx"))])
def test_a_bomb_is_not_unfolded(tmp_path, name):
    """Each would be 300 MiB; a table of Excel's is the same archive under another name."""
    small, bomb = tmp_path / f"small{name[1:]}", tmp_path / name
    if name.endswith(".gz"):
        save_csv_gz(small, columns())
        bomb.write_bytes(300 * gzip.compress(bytes(1 << 20)))  # files of gzip may follow one another in one
    else:
        (save_npz if name.endswith(".npz") else save_xlsx)(small, columns())
        with (
            zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive,
            archive.open("time_s.npy", "w") as file,
        ):
            for _ in range(300):
                file.write(bytes(1 << 20))
    said = read_within(MEMORY, small, bomb)
    assert name in said and "200 times" in said and "\n" not in said


def test_an_array_that_promises_more_than_it_holds(tmp_path):
    save_npz(tmp_path / "a.npz", columns())
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776,), }".ljust(117) + b"\n"
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        archive.writestr("time_ms.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head)
    assert "ends too early" in refused(tmp_path / "a.npz", time_column="time_ms")


def test_hdf5_that_leads_out_of_the_file(tmp_path):
    save_h5(tmp_path / "b.h5", columns())
    for name, link in (
        ("displacement_mm", h5py.ExternalLink(str(tmp_path / "b.h5"), "displacement_mm")),
        ("displacement_mm", h5py.SoftLink("/voltage_V")),
        ("displacement_mm", h5py.SoftLink("/displacement_mm")),
    ):
        save_h5(tmp_path / "a.h5", columns(displacement_mm=None))
        with h5py.File(tmp_path / "a.h5", "r+") as file:
            file[name] = link
        assert "not followed" in refused(tmp_path / "a.h5")
    raw = tmp_path / "raw"
    raw.write_bytes(OUTPUT.tobytes())
    save_h5(tmp_path / "a.h5", columns(displacement_mm=None))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.create_dataset("displacement_mm", (T,), "f8", external=[(str(raw), 0, 8 * T)])
    assert "another file" in refused(tmp_path / "a.h5")
    save_h5(tmp_path / "a.h5", columns(displacement_mm=None))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.create_dataset("displacement_mm", (1 << 40,), "f8", chunks=(1 << 16,), compression="gzip")
    assert "200 times" in refused(tmp_path / "a.h5")


def nested_cells(depth):
    element = b""
    for _ in range(depth):
        body = struct.pack("<10I", 6, 8, 1, 0, 5, 8, 1, 1, 1, 0) + element
        element = struct.pack("<II", 14, len(body)) + body
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + element


@pytest.mark.parametrize("depth", [10, 3000])
def test_cells_in_cells_have_a_bottom(tmp_path, depth):
    (tmp_path / "a.mat").write_bytes(nested_cells(depth))
    assert "nested too deeply" in refused(tmp_path / "a.mat")


def test_headers_of_unreasonable_size(tmp_path):
    (tmp_path / "a.csv").write_text(",".join(f"c{k}" for k in range(100_000)) + "\n" + "1," * 99_999 + "1\n")
    assert "the line is too long" in refused(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text(",".join("c" * 5000) + "\n" + "1," * 4999 + "1\n")
    assert "5000 columns" in refused(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("x" * 10_000_000)
    assert "the line is too long" in refused(tmp_path / "a.csv")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for k in range(5000):
            file.create_group(f"g{k}")
    assert "5000 columns" in refused(tmp_path / "a.h5")


def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.csv")
    assert "not a regular file" in refused(tmp_path / "a.csv")
    (tmp_path / "b.csv").symlink_to(tmp_path / "b.csv")
    assert "b.csv" in refused(tmp_path / "b.csv")
    (tmp_path / "c").symlink_to(tmp_path / "c")
    assert "c" in refused(tmp_path / "c")


def test_a_folder_with_a_link_to_itself(tmp_path, capsys):
    folder = tmp_path / "records"
    folder.mkdir()
    save_csv(folder / "a.csv", columns())
    (folder / "self").symlink_to(folder)
    (folder / "b.csv").symlink_to(folder / "b.csv")
    assert [r.name for r in read(folder)] == ["a"]
    assert [r.name for r in read(folder / "self" / "self")] == ["a"]
    assert cli.main(["identify", str(folder / "b.csv"), "--out", str(tmp_path / "m")]) == 2
    assert "unexpected" not in capsys.readouterr().err


@pytest.mark.parametrize("odd", ["\x1b[2J", "\u202e", "\r", "\x9b31m"])
def test_control_characters_in_names_reach_no_terminal(tmp_path, capsys, odd):
    name = f"a{odd}b.csv"
    save_csv(tmp_path / name, columns())
    (record,) = read(tmp_path / name)
    assert odd not in record.name and record.name.startswith("a_")
    assert record.source == str(tmp_path / name)  # the path itself: outputs are kept from replacing it
    save_csv(tmp_path / name, {"time_s": TIME, f"u{odd}": VOLTAGE, "displacement_mm": OUTPUT})
    assert cli.main(["identify", str(tmp_path / name), "--out", str(tmp_path / "m")]) == 2
    told = capsys.readouterr().err
    assert odd not in told and "b.csv" in told
    (tmp_path / name).unlink()
    assert cli.main(["identify", str(tmp_path / name), "--out", str(tmp_path / "m")]) == 2
    told = capsys.readouterr().err
    assert odd not in told and "b.csv" in told


def bad_files(folder):
    """Twenty files, each bad in its own way: name -> a word of its refusal."""
    good = text(columns())
    lines = good.split("\n")
    far = {"time_s": TIME, "displacement_mm": OUTPUT}
    files: dict[str, tuple[bytes, str]] = {
        "01.csv": (b"", "empty"),
        "02.csv": (b"\n\n \n", "blank"),
        "03.csv": (bytes(range(256)) * 9, "control characters"),
        "04.csv": (lines[0].encode(), "no table"),
        "05.csv": ("\n".join(lines[:20]).encode(), "at least 64"),
        "06.csv": (good.replace("1040.0", "oops").encode(), "'oops'"),
        "07.csv": (good.replace("1040.0", "").encode(), "input is missing"),
        "08.csv": (good.replace("1040.0", "inf").encode(), "infinite"),
        "09.csv": (good.replace("0.05,", "0.02,").encode(), "decreases"),
        "10.csv": (good.replace("voltage_V", "voltage_quux").encode(), "quux"),
        "11.csv": (good.replace("voltage_V", "voltage").encode(), "--input-unit"),
        "12.csv": (text({**far, "voltage_kV": VOLTAGE}).encode(), "more than 100000 V"),
        "13.csv": (text(columns(displacement_mm=[""] * T)).encode(), "every output sample"),
        "14.csv.gz": (b"\x1f\x8b" + bytes(99), "gzip"),
        "15.csv.gz": (gzip.compress(good.encode())[:-400], "too early"),
        "16.npz": (b"PK\x03\x04" + bytes(99), "archive"),
        "17.mat": (b"MATLAB 5.0 MAT-file" + bytes(300), "MATLAB"),
        "18.h5": (b"\x89HDF\r\n\x1a\n" + bytes(99), "HDF5"),
        "19.xlsx": (b"no sheet", "Excel"),
        "20.csv": (b"Lorem ipsum, dolor\nsit amet\n" * 40, "no table"),
    }
    for name, (data, _) in files.items():
        (folder / name).write_bytes(data)
    return {name: word for name, (_, word) in files.items()}


def test_twenty_bad_files_are_refused_in_one_message(tmp_path, capsys):
    folder = tmp_path / "records"
    folder.mkdir()
    words = bad_files(folder)
    save_csv_gz(folder / "good.csv.gz", columns())
    assert cli.main(["identify", str(folder), "--out", str(tmp_path / "m")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "20 of 21 files are refused" in told
    assert len(told) <= 700 and "01.csv" in told  # 600 characters, and where the records were read from
    for name, word in words.items():
        said = refused(folder / name)
        assert name in said and word in said, name
    assert not (tmp_path / "m").exists()


def test_a_monitors_voltage_is_asked_about(tmp_path, capsys):
    t = np.arange(3000) / 1000
    u = 1.5 + np.sin(12 * t)
    save_npz(tmp_path / "a.npz", {"time_s": t, "voltage_V": u, "displacement_mm": u**2})
    command = ["identify", str(tmp_path / "a.npz"), "--out", str(tmp_path / "m"), "--order", "2"]
    cli.main(command)
    told = capsys.readouterr().err
    assert "--input-scale 1000" in told and "read 1 recording (a): NumPy archive; time 'time_s' in s" in told
    cli.main(
        ["identify", str(tmp_path / "a.npz"), "--out", str(tmp_path / "m"), "--order", "2", "--input-scale", "1000"]
    )
    assert "--input-scale 1000" not in capsys.readouterr().err


def test_columns_and_units_reach_the_reader_from_every_command(tmp_path, capsys, actuator):
    from pitp_jax import save

    buffer = io.StringIO("a,b,c\n" + "\n".join(f"{k},{k % 7},{k % 5}" for k in range(100)))
    (tmp_path / "a.csv").write_text(buffer.getvalue())
    save(tmp_path / "m", actuator)
    options = ["--time-column", "a", "--time-unit", "ms", "--output-column", "c", "--output-unit", "um"]
    drive = ["--input-column", "b", "--input-unit", "kV", "--input-scale", "0.5", "--rate", "1000"]
    assert cli.main(["predict", str(tmp_path / "m"), str(tmp_path / "a.csv"), *options, *drive]) == 0
    assert "input 'b' in kV times 0.5, output 'c' in um" in capsys.readouterr().err
    assert cli.main(["predict", str(tmp_path / "m"), str(tmp_path / "a.csv"), "--input-scale", "0"]) == 2
