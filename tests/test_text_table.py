"""CSV as people and programs write it; a bad line is named."""

import numpy as np
import pytest
from effort import calls
from record_files import (
    OUTPUT,
    VOLTAGE,
    columns,
    refused_csv,
    save_csv,
    text,
)

from pitp_jax import read
from pitp_jax.files.containers.header import is_number


@pytest.mark.parametrize(
    "damage",
    [
        lambda s: "\ufeff" + s,
        lambda s: s.replace("\n", "\r\n"),
        lambda s: s.replace("\n", "\r\r\n"),
        lambda s: s.replace("time_s,voltage_V,", ' time_s ,"voltage_V" , '),
        lambda s: s + "\n\n  \n",
        lambda s: s.replace("\n", ",\n"),
        lambda s: s.rstrip("\n"),
        lambda s: s.replace(",", ", "),
        lambda s: s.replace("1003.0", '"1003.0"'),
        lambda s: "\n" + s,
    ],
    ids=["bom", "crlf", "crcrlf", "header", "blank", "trailing comma", "no end", "spaces", "quotes", "top"],
)
def test_csv_dialects(tmp_path, damage):
    (tmp_path / "a.csv").write_bytes(damage(text(columns())).encode())
    (record,) = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(record.voltage, VOLTAGE)
    np.testing.assert_allclose(record.displacement, OUTPUT * 1e-3, rtol=1e-14)


@pytest.mark.parametrize("empty", ["", " ", "nan", "NaN"])
@pytest.mark.parametrize(
    "order", [("time_s", "voltage_V", "displacement_mm"), ("displacement_mm", "voltage_V", "time_s")]
)
def test_gap_of_200_samples_in_csv(tmp_path, empty, order):
    count = 500
    table = {
        "time_s": [f"{i / 1000:.3f}" for i in range(count)],
        "voltage_V": ["5"] * count,
        "displacement_mm": [empty if 100 <= i < 300 or i in (0, count - 1) else "1.5" for i in range(count)],
    }
    save_csv(tmp_path / "a.csv", {name: table[name] for name in order})
    (record,) = read(tmp_path / "a.csv")
    assert record.missing == 202
    assert not record.observed[[0, 100, 299, 499]].any()
    assert record.observed[[1, 99, 300, 498]].all()


def with_line(number, line):
    lines = text(columns()).split("\n")
    lines[number - 1] = line
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("0.048,oops,0.1", ("voltage_V", "line 50", "sample 48", "'oops'", "text")),
        ("0.048,1_000,0.1", ("voltage_V", "line 50", "text")),
        ("0.048,1048.0", ("line 50", "sample 48", "displacement_mm", "2 cells", "3")),
        ("0.048,1048.0,0.1,7", ("line 50", "sample 48", "4 cells")),
        ("0.048,,0.1", ("voltage_V", "line 50", "sample 48", "input is missing", "split")),
        ("0.048,nan,0.1", ("voltage_V", "line 50", "sample 48", "input is missing", "split")),
        ("0.048,inf,0.1", ("voltage_V", "line 50", "infinite")),
        ("0.048,1048.0,-inf", ("displacement_mm", "line 50", "infinite")),
        ("0.048,1048.0,1e400", ("displacement_mm", "line 50", "infinite")),
        (",1048.0,0.1", ("time_s", "line 50", "time is missing")),
        ("0.040,1048.0,0.1", ("time_s", "line 50", "decreases")),
    ],
)
def test_bad_line_is_named(tmp_path, line, words):
    message = refused_csv(tmp_path, with_line(50, line))
    for word in words:
        assert word in message, message


def test_line_numbers_skip_blank_lines(tmp_path):
    message = refused_csv(tmp_path, with_line(50, "\n\n0.048,inf,0.1"))
    assert "sample 48 (line 52)" in message


def test_a_long_csv_is_read_without_a_loop_over_its_rows(tmp_path):
    def written(count):
        rows = "\n".join(f"{i / 1000:.3f},{i % 700},{i % 13}.5" for i in range(count))
        path = tmp_path / f"{count}.csv"
        path.write_text("time_s,voltage_V,displacement_mm\n" + rows)
        return path

    short, long = written(2_000), written(100_000)
    assert read(long)[0].samples == 100_000
    assert calls(lambda: read(long)) < calls(lambda: read(short)) + 10_000


def test_a_cell_of_two_million_digits_is_looked_at_once():
    """Backtracking over every prefix would take hours."""
    assert not is_number("9" * 2_000_000 + "x", ".") and not is_number("9" * 2_000_000 + "x", ",")
