"""Write the tables of an identification and of free runs, for a page and for the terminal."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from ...common.numbers import shown_unit
from ...common.page import Table
from ...common.units import from_base
from ...method.model.units import units_of

if TYPE_CHECKING:  # it loads what identifies
    from ...method.identify.identification import Identification


def orders(fits: "Identification") -> Table:
    """Return the table of the compared orders; the chosen one is bold."""
    unit = units_of(fits.model).output.unit
    rows = []
    for fit in fits.orders:
        delay, rms = 1e3 * fit.delay or None, float(from_base(fit.rms, unit))
        poles, determined = ", ".join(f"{hz:.3g}" for hz in fit.natural_hz), "yes" if fit.identifiable else "no"
        rows.append((str(fit.order), fit.hold, delay, fit.heldout, rms, poles, determined))
    header = (
        "order", "hold", "delay (ms)", "held out (% of std)", f"rms ({shown_unit(unit)})", "natural (Hz)", "determined",
    )  # fmt: skip
    bold = [fit is fits.chosen for fit in fits.orders]
    return Table(header, rows, "By order; bold: chosen.", bold, (0, 1))


def scores(names: Iterable[str], rows: Mapping[str, dict], expected: Mapping[str, str]) -> Table:
    """Return the table of the errors of free runs.

    Args:
        names: of the recordings, in the order of the table.
        rows: of `pitp predict`, by the recording's name.
        expected: error to expect of each where it is known, % of range.
    """
    table = []
    for name in names:
        s = rows[name]
        error = "no motion to score" if s["e_rms_percent"] is None else s["e_rms_percent"]
        errors = "diverged" if s["diverged"] else error, s["nrmse_percent"], s["rmse"], shown_unit(s["rmse_unit"])
        counts = str(s["samples"]), str(s["missing"]), 100 * s["outside_training_share"], expected.get(name, "")
        table.append((name, s["begins"], *errors, s["zero_fitted_e_rms_percent"], *counts))
    header = (
        "recording", "begins", "e_rms (% of range)", "nrmse (% of std)", "rmse", "unit",
        "with fitted offset (%)", "samples", "missing", "outside (%)", "expected (%)",
    )  # fmt: skip
    return Table(header, table, text=(0, 1, 5), omitted=("–", "-", "", "0"))
