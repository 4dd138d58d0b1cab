"""Write the check as one self-contained page: advice, records, coverage, and every record's output and input."""

from ...common.numbers import figure, shown_unit, with_error
from ...common.page import Page, Section, Table
from ...common.picture import Picture, figure_of, finish, new_axes
from ...common.quantity import Quantity, Units
from ...common.units import from_base
from ...files.recordings.remarks import counted
from ...method.signal.record import Record
from ..check.check import Check, CheckedRecord
from .drawing import DRAWN, DRIVE, MEASURED, PREDICTED, signals, volts


def page(check: Check) -> Page:
    """Return the page of a check.

    Args:
        check: result of `pitp check` for a set.
    """
    wrong, shown = len(check.problems), check.understood[: 2 * DRAWN]
    more = len(check.understood) - len(shown)
    problems = [f"{name}: {line}" for name, lines in check.problems.items() for line in lines]
    return Page(
        f"{counted(len(check.records), 'recording')}, {wrong or 'none'} with problems",
        "Check: what was read, and whether it is sufficient",
        [check.advice],
        [
            Section("Problems of single recordings", [problems]),
            Section("Corrected while reading", [check.repaired]),
            Section("Records", [table(check)]),
            Section("Coverage", [_coverage(check)]),
            Section("The recordings as read", [
                [_drawn(f"r{k}", r, check.records[r.name]) for k, r in enumerate(shown)],
                f"and {more} more, in the CSV files" if more else "",
            ]),
        ],
        "open" if wrong else "good",
    )  # fmt: skip


def table(check: Check) -> Table:
    """Return the table of the recordings, for the page and the terminal."""
    header = (
        "record", "drive", "band (Hz)", "samples", "rate (Hz)", "begins", "zero", "direction", "noise", "missing",
        "outliers", "read as",
    )  # fmt: skip
    note = (
        "In the order read; bold: with problems. measured = direction × displacement + zero (the sensor's offset); a "
        "dash: not known. Columns of zeros are left out."
    )
    rows = [(name, *_cells(row)) for name, row in check.records.items()]
    bold = [bool(row.problems) for row in check.records.values()]
    return Table(header, rows, note, bold, (0, 1, 5, 11), ("–", "", "0"))


def _cells(row: CheckedRecord) -> tuple[str | float | None, ...]:
    unit = shown_unit(row.unit or "")
    band = "" if row.band_hz is None else " to ".join(dict.fromkeys(figure(f, 3) for f in row.band_hz))
    zero = "" if row.zero is None else with_error(row.zero, row.zero_stderr, unit)
    noise = "" if row.noise is None else f"{figure(row.noise, 2)} {unit} {row.noise_colour or ''}".strip()
    direction = "" if row.direction is None else f"{row.direction:+d}"
    samples, missing, outliers = ("" if n is None else str(n) for n in (row.samples, row.missing, row.outliers))
    read = "; ".join(str(row.recognised[k]) for k in ("file", "input", "output") if k in row.recognised)
    return (
        row.excitation or "", band, samples, row.rate_hz, row.begins or "", zero, direction, noise, missing, outliers,
        read,
    )  # fmt: skip


def _coverage(check: Check) -> list[Picture]:
    c = check.coverage
    if c is None:
        return []
    (ax,) = axes = new_axes(1, 2.6)
    drive = Units(Quantity(c.unit)).input
    for low, high in c.gaps:
        ax.axvspan(low, high, 0.5, 1.0, color="#e69f00", alpha=0.35, lw=0)
    ax.scatter(c.points[:, 0], drive.shown(c.points[:, 1]), s=6, color=PREDICTED, lw=0)
    ax.axvline(c.resonance, color="#000000", lw=0.8, ls="--")
    ax.set(xscale="log", ylim=(0, 1.05 * drive.shown(c.largest)))
    finish(axes, "frequency of the force (Hz)", [f"amplitude of the input ({shown_unit(drive.unit)})"])
    caption = (
        "Excited frequencies and amplitudes, one point a time window. Dashed: the resonance. Shaded: nothing exceeds "
        "half the amplitude."
    )
    return [Picture("coverage", figure_of(ax), caption)]


def _drawn(name: str, record: Record, row: CheckedRecord) -> Picture:
    unit, (drive, label) = record.displacement_unit, volts(record.voltage, record.voltage_unit)
    output = (f"output ({shown_unit(unit)})", from_base(record.displacement, unit), MEASURED)
    starts = {"rest": "starts at rest", "held": "starts settled at a held input", "moving": "starts moving"}
    caption = f"{record.name}: {row.excitation}, {starts.get(row.begins or '', 'initial state not known')}"
    return Picture(name, signals(record.time, [output, (label, drive, DRIVE)], (2, 1)), caption)
