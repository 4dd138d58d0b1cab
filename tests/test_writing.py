"""Files are written whole or not at all, and read back as they were."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pitp_jax import BadInput, read
from pitp_jax.files.recordings.writing import write_bytes_atomic, write_csv, write_text_atomic

VALUES = st.floats(-1e6, 1e6, allow_subnormal=False)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    dt=st.sampled_from([1e-3, 2e-4, 0.0016384, 1 / 3000, 5e-5]),
    start=st.floats(0, 1e4),
    data=st.lists(VALUES | st.just(float("nan")), min_size=64, max_size=80),
    suffix=st.sampled_from([".csv", ".csv.gz"]),
)
def test_write_then_read(tmp_path, dt, start, data, suffix):
    output = np.array(data)
    output[0] = 1.0
    time = start + dt * np.arange(len(output))
    voltage = np.linspace(0, 6000, len(output))
    path = tmp_path / f"a{suffix}"
    flags = np.arange(len(output)) % 2 == 0
    write_csv(path, {"time_s": time, "voltage_V": voltage, "displacement_mm": output, "infeasible": flags})
    (record,) = read(path)
    np.testing.assert_allclose(record.time, time, atol=1e-9)
    np.testing.assert_allclose(record.voltage, voltage, rtol=1e-8)
    np.testing.assert_allclose(record.displacement * 1e3, output, rtol=1e-8, atol=1e-300)
    assert list(tmp_path.glob(".pitp*")) == []


def test_flags_are_written_as_digits(tmp_path):
    write_csv(tmp_path / "a.csv", {"time_s": np.array([0.0, 0.5]), "saturated": np.array([True, False])})
    assert (tmp_path / "a.csv").read_text() == "time_s,saturated\n0.000000000,1\n0.500000000,0\n"


def test_writing_is_whole_or_nothing(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    write_text_atomic(path, "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(BadInput, match=r"cannot write .*a\.csv: No space left on device"):
        write_csv(path, {"x": np.zeros(3)})
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_writing_to_odd_places(tmp_path):
    with pytest.raises(BadInput, match="create the folder"):
        write_bytes_atomic(tmp_path / "no" / "a", b"")
    with pytest.raises(BadInput, match="cannot write"):
        write_bytes_atomic(tmp_path, b"")


@pytest.mark.skipif(os.name == "nt", reason="no devices with a path, links only for administrators")
def test_writing_to_devices_and_links(tmp_path):
    write_bytes_atomic("/dev/null", b"x")
    assert not Path("/dev/null").is_file()
    with pytest.raises(BadInput, match="No space left on device"):
        write_bytes_atomic("/dev/full", b"x")
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_text_atomic(tmp_path / "link", "new")
    assert (tmp_path / "real").read_text() == "new"
    assert (tmp_path / "link").is_symlink()
