"""One record as a file of every format, and the refusal a damaged one meets."""

import gzip

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from pitp_jax import BadInput, read

T = 100
TIME = np.arange(T) / 1000
VOLTAGE = 1000.0 + np.arange(T)
OUTPUT = np.sin(TIME * 50)


def columns(**changes):
    wide = {"time_s": TIME, "voltage_V": VOLTAGE, "displacement_mm": OUTPUT}
    wide.update(changes)
    return {name: values for name, values in wide.items() if values is not None}


def text(table):
    rows = [",".join(table)]
    rows += [",".join(str(v) for v in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(rows) + "\n"


def save_csv(path, table):
    path.write_text(text(table))


def save_csv_gz(path, table):
    path.write_bytes(gzip.compress(text(table).encode()))


def save_mat(path, table):
    scipy.io.savemat(path, {name: np.asarray(v).reshape(-1, 1) for name, v in table.items()})


def save_mat_rows(path, table):
    scipy.io.savemat(path, {name: np.asarray(v).reshape(1, -1) for name, v in table.items()})


def save_mat73(path, table):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in table.items():
            file[name] = np.asarray(values).reshape(1, -1)
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def save_npz(path, table):
    np.savez(path, **table)


def save_h5(path, table):
    with h5py.File(path, "w") as file:
        for name, values in table.items():
            file[name] = values


def save_xlsx(path, table):
    pd.DataFrame(table).to_excel(path, index=False)


SAVERS = {
    "a.csv": save_csv,
    "b.csv.gz": save_csv_gz,
    "c.mat": save_mat,
    "d.mat": save_mat_rows,
    "e.mat": save_mat73,
    "f.npz": save_npz,
    "g.h5": save_h5,
    "h.hdf5": save_h5,
    "I.CSV": save_csv,
}


def refused(*paths, **options) -> str:
    with pytest.raises(BadInput) as caught:
        read(*paths, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def refused_csv(tmp_path, body: str | bytes, **options) -> str:
    path = tmp_path / "bad.csv"
    path.write_bytes(body if isinstance(body, bytes) else body.encode())
    message = refused(path, **options)
    assert "bad.csv" in message
    return message
