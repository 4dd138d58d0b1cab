"""Write the check as one self-contained page: advice, records, coverage, and every record's output and input."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ...common.numbers import figure, shown_unit, with_error
from ...common.quantity import Quantity, Units
from ...common.units import from_base
from ...files.recordings.remarks import counted
from ...method.signal.record import Record
from ..check.check import Check, CheckedRecord
from . import html
from .html import tag
from .lines import DRIVE, MEASURED, PREDICTED, finish, line, own_axes, volts

_DRAWN = 24  # records; a page with more is too long to read


def page(check: Check) -> str:
    """Write the check as a self-contained HTML page.

    Args:
        check: result of `pitp check` for a set.
    """
    many, wrong = len(check.records), len(check.problems)
    title = f"{counted(many, 'recording')}, {wrong or 'none'} with problems"
    parts = [
        tag("p", "Check: what was read, and whether it is sufficient", "soft"),
        tag("h1", title, "unknown" if wrong else "explained"),
        html.bullets(check.advice),
        tag("h2", "Problems of single recordings") if wrong else "",
        html.bullets([f"{name}: {line}" for name, lines in check.problems.items() for line in lines]),
        tag("h2", "Corrected while reading") if check.repaired else "",
        html.bullets(check.repaired),
        tag("h2", "Records"),
        *_table(check),
        *_coverage(check),
        *_pictures(check),
    ]
    return html.page(title, parts)


def _table(check: Check) -> list[str]:
    header = (
        "record", "drive", "band (Hz)", "samples", "rate (Hz)", "begins", "zero", "direction", "noise", "missing",
        "outliers", "read as",
    )  # fmt: skip
    rows = [("named" if row.problems else "", (name, *_cells(row))) for name, row in check.records.items()]
    note = (
        "Bold: with problems. measured = direction × displacement + zero (the sensor's offset); a dash: not known. "
        "Columns of zeros are left out."
    )
    return [tag("p", note, "soft"), html.telling_table(header, rows, {1: "left", 5: "left", 11: "long"})]


def _cells(row: CheckedRecord) -> Sequence[str]:
    band = "–" if row.band_hz is None else " to ".join(dict.fromkeys(figure(f, 3) for f in row.band_hz))
    unit = shown_unit(row.unit or "")
    zero = "–" if row.zero is None else with_error(row.zero, row.zero_stderr, unit)
    noise = "–" if row.noise is None else f"{figure(row.noise, 2)} {unit} {row.noise_colour or ''}"
    read = "; ".join(str(row.recognised[k]) for k in ("file", "input", "output") if k in row.recognised)
    counts = (row.missing, row.outliers)
    return (
        row.excitation or "–", band, "–" if row.samples is None else str(row.samples), figure(row.rate_hz),
        row.begins or "–", zero, "–" if row.direction is None else f"{row.direction:+d}", noise.strip(),
        *("–" if n is None else str(n) for n in counts), read,
    )  # fmt: skip


def _coverage(check: Check) -> list[str]:
    c = check.coverage
    if c is None:
        return []
    ax, drive = own_axes(None, 1, (5.6, 2.8))[0], Units(Quantity(c.unit)).input
    for low, high in c.gaps:
        ax.axvspan(low, high, 0.5, 1.0, color="#e69f00", alpha=0.35, lw=0)
    ax.scatter(c.points[:, 0], drive.shown(c.points[:, 1]), s=6, color=PREDICTED, lw=0)
    ax.axvline(c.resonance, color="#000000", lw=0.8, ls="--")
    ax.set(xscale="log", ylim=(0, 1.05 * drive.shown(c.largest)))
    finish(np.array([ax]), "frequency of the force (Hz)", [f"amplitude of the input ({shown_unit(drive.unit)})"])
    caption = (
        "Excited frequencies and amplitudes, one point a time window. Dashed: the resonance. Shaded: nothing exceeds "
        "half the amplitude."
    )
    return [tag("h2", "Coverage"), f'<div class="figures">{_picture("coverage", ax.figure, caption)}</div>']


def _picture(name: str, drawn, caption: str) -> str:
    assert isinstance(drawn, Figure)
    return html.picture(name, drawn, caption)


def _pictures(check: Check) -> list[str]:
    """Write the page's section with a figure of every record's output and input."""
    shown = [
        _picture(f"r{k}", _drawn(r), f"{r.name}: {check.records[r.name].excitation}, {_begins(check.records[r.name])}")
        for k, r in enumerate(check.understood[:_DRAWN])
    ]
    more_records = len(check.understood) - len(shown)
    more = [tag("p", f"and {more_records} more, in the CSV files", "soft")] if more_records > 0 else []
    return [tag("h2", "The recordings as read"), f'<div class="figures">{"".join(shown)}</div>', *more] if shown else []


def _begins(row: CheckedRecord) -> str:
    words = {"rest": "starts at rest", "held": "starts settled at a held input", "moving": "starts moving"}
    return words.get(row.begins or "", "initial state not known")


def _drawn(record: Record) -> Figure:
    upper, lower = own_axes(None, 2, (5.6, 2.6), [2, 1])
    unit, time = record.displacement_unit, record.time - record.time[0]
    line(upper, time, from_base(record.displacement, unit), color=MEASURED, lw=1.0)
    drive, label = volts(record.voltage, record.voltage_unit)
    line(lower, time, drive, color=DRIVE, lw=1.0)
    finish(np.array([upper, lower]), "time (s)", [f"output ({shown_unit(unit)})", label])
    return upper.figure
