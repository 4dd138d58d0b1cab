"""A known actuator, records of it as files, and what the command line said and left."""

import csv

import numpy as np
from scipy.signal import lsim

from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.input_map import SquareInput
from pitp_jax.method.model.model import Output, linear_model
from pitp_jax.method.model.origin import Origin

OMEGA, DAMPING, STIFFNESS = 2 * np.pi * 5, 0.15, 1e9  # V^2/m: 4 mm at 2 kV
COEFFICIENTS = STIFFNESS * np.array([1.0, 2 * DAMPING / OMEGA, 1 / OMEGA**2])
DRIVES = {"sweep": (0.1, 8.0), "sine2": (2.0, 2.0), "sine4": (4.0, 4.0)}
TIME = np.arange(2000) / 500.0
SCORE_KEYS = {
    "e_rms_percent", "nrmse_percent", "rmse", "rmse_unit", "samples", "missing", "diverged",
    "outside_training_share", "begins", "zero", "direction", "zero_fitted_e_rms_percent", "initial_samples",
}  # fmt: skip


def motion(name):
    """Voltage in V and noisy displacement in m of a known second-order actuator."""
    first, last = DRIVES[name]
    phase = 2 * np.pi * (first * TIME + (last - first) * TIME**2 / (2 * TIME[-1]))
    voltage = 1000 * (1 - np.cos(phase))
    x = lsim(([1.0], COEFFICIENTS[::-1]), voltage**2, TIME)[1]
    return voltage, x + 1e-6 * np.random.default_rng(len(name)).standard_normal(len(TIME))


def write_record(path, voltage, displacement, units=("V", "m"), time=TIME):
    factor = {"V": 1.0, "kV": 1e-3, "m": 1.0, "mm": 1e3, "um": 1e6}
    header = f"time_s,voltage_{units[0]},displacement_{units[1]}"
    columns = (time, voltage * factor[units[0]], displacement * factor[units[1]])
    rows = [",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def truth(coefficients=COEFFICIENTS, **changes):
    scale = 1e-3 * OMEGA ** np.arange(len(coefficients))
    model = linear_model(
        coefficients, input_map=SquareInput(), state_scale=scale, force_scale=4e6,
        output=Output(), hold="foh", substeps=1, domain=Domain(0.002, (0.0, 2000.0), 5e4),
    )  # fmt: skip
    return Fitted(model, Origin("mm", "kV", **changes))


def refused(result, code=2):
    """One line on standard error, nothing on standard output."""
    got, out, err = result
    errors = [line for line in err.splitlines() if line.startswith("pitp: error: ")]
    assert (got, len(errors), out) == (code, 1, ""), (got, out, err)
    assert "unexpected" not in errors[0]
    return errors[0]


def tree(folder):
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def columns_of(path):
    rows = list(csv.reader(path.read_text().splitlines()))
    values = np.array([[float(c) if c else np.nan for c in row] for row in rows[1:]])
    return rows[0], values
