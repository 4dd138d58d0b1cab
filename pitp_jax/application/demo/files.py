"""Write the folder of `pitp demo`: recordings, model files, tables as CSV, and the paper's figures.

records/   the sweep and the training sines: for `pitp identify`, `fit` and `diagnose`
held_out/  held-out recordings, for `pitp predict`
target.csv a wanted motion, for `pitp invert`
figures/   the paper's figures, each with its numbers as CSV
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...common.page import Table
from ...common.picture import Picture, figure_of, finish, new_axes
from ...files.model_file.model_file import save
from ...files.recordings.writing import write_csv, write_text_atomic
from ...method.model.model import Model
from ...method.signal.record import Record
from ...method.simulate.decoder import rest_state
from ...method.simulate.model_runs import evaluate, model_runs
from ..pages.drawing import CYCLE, PREDICTED, beside, signals, volts, write_picture
from ..pages.drawing import FIGURES as HOME
from .protocol import Demo, excitations, nearest, tables

TABLE_FILES = ("table_1_in_sample.csv", "held_out.csv", "table_2_tracking.csv")
FIGURES = ("sweep", "prediction", "hysteresis", "tokens", "tracking")
RECORDS, HELD_OUT = "records", "held_out"
FILES = (
    *("nominal.pitp", "model.pitp", *TABLE_FILES, "tracking.csv", "target.csv"),
    *(f"{HOME}/{name}.{kind}" for name in FIGURES for kind in ("png", "csv")),
)


def write(demo: Demo, folder: Path) -> None:
    """Write recordings, models, tables and figures of a demo into an existing folder.

    Args:
        demo: result of `protocol.run`.
        folder: where; files of the same names are replaced.

    Raises:
        BadInput: a file cannot be written.
        OSError: a figure cannot be written.
    """
    for name, records in ((RECORDS, (demo.sweep, *demo.train)), (HELD_OUT, demo.test)):
        (folder / name).mkdir()
        for r in records:
            columns = {"time_s": r.time, "voltage_V": r.voltage, "displacement_m": r.displacement}
            write_csv(folder / name / f"{r.name}.csv", columns)
    save(folder / "nominal.pitp", demo.identified.model)
    save(folder / "model.pitp", demo.training.model)
    for name, table in zip(TABLE_FILES, tables(demo), strict=True):
        write_text_atomic(folder / name, _csv(table))
    last = demo.tracks[-1]
    columns = {
        "time_s": last.time,
        "voltage_V": last.voltage,
        "displacement_m": last.achieved,
        "target_m": last.target,
    }
    write_csv(folder / "tracking.csv", columns)
    write_csv(folder / "target.csv", {"time_s": last.time, "displacement_m": last.target})
    figures = (_sweep(demo), _prediction(demo), _loops(demo), _tokens(demo), _tracking(demo))
    for name, figure in zip(FIGURES, figures, strict=True):
        write_picture(folder, Picture(name, figure, ""))


def recordings(name: str, quick: bool) -> set[str]:
    """Return the file names of the recordings that the demo of this actuator writes, with their folders."""
    parts = {RECORDS: ("sweep", "train"), HELD_OUT: ("test",)}
    return {f"{home}/{e.name}.csv" for home, kinds in parts.items() for k in kinds for e in excitations(name, k, quick)}


def _csv(table: Table) -> str:
    header = [name.replace(",", "") for name in table.header]  # none then needs quotes
    # an empty cell is read as missing everywhere, the word "inf" as text by some spreadsheets
    rows = table.cells(lambda value: "" if value is None or not np.isfinite(value) else f"{value:.6g}")
    return "\n".join(map(",".join, [header, *rows])) + "\n"


def _sweep(demo: Demo):
    r, p = demo.sweep, demo.linear[demo.sweep.name]
    return _beside(r.time, r.displacement, p.displacement)


def _prediction(demo: Demo):
    """Draw measured and predicted output of the last held-out sine."""
    r = [record for record in demo.test if record.name.startswith("sine")][-1]
    return _beside(r.time, r.displacement, demo.predicted[r.name].displacement)


def _beside(time, wanted, reached, names=("measured", "predicted")):
    words = ("displacement", "error")
    return beside(time, (names[0], wanted), [(names[1], reached, PREDICTED)], "mm", words)


def _loops(demo: Demo):
    """Draw output over voltage for one steady-state period at each frequency of Table II; dashed: predicted."""
    (ax,) = axes = new_axes(1, 3.2)
    for t, color in zip(demo.tracks, CYCLE, strict=False):
        r = nearest(demo.train, demo.name, t.frequency)
        last = slice(r.samples - round(1 / (t.frequency * r.dt)), None)  # of the voltage: x has twice its frequency
        voltage = volts(r.voltage[last])[0]
        ax.plot(voltage, 1e3 * r.displacement[last], color=color, alpha=0.6, lw=1.8, label=f"{t.frequency:g} Hz")
        ax.plot(voltage, 1e3 * demo.predicted[r.name].displacement[last], color=color, lw=1.0, ls="--")
    finish(axes, volts(demo.tracks[0].voltage)[1], ["displacement (mm)"])
    return figure_of(ax)


def _tokens(demo: Demo):
    """Draw the model's coefficients along a simulated training sine, relative to nominal, and the offset."""
    t = demo.tracks[1]
    r = nearest(demo.train, demo.name, t.frequency)
    model = demo.training.model.model
    names = [rf"$\sigma_{i} / \sigma_{i}^0$" for i in range(model.order + 1)] + [r"$\sigma_{off}$"]
    values = token_history(model, r).T
    return signals(r.time, [(name, row, PREDICTED) for name, row in zip(names, values, strict=True)])


def token_history(model: Model, record: Record) -> np.ndarray:
    """Return a model's coefficients relative to nominal, then the offset, along a simulation from rest, (T, n + 2)."""
    start = np.asarray(rest_state(model))[None]
    states = model_runs(model, record.voltage[None], record.dt, start)[0][0]
    return evaluate(_tokens_of, model, *states.T)


def _tokens_of(model: Model, state, *_):
    tokens, offset = model.tokens(state[: model.order + model.memory.size])
    return state, jnp.append(tokens / model.coefficients, offset)


def _tracking(demo: Demo):
    """Draw a target and the output that was reached."""
    t = demo.tracks[1]
    return _beside(t.time, t.target, t.achieved, ("target", "achieved"))
