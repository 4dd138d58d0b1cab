"""Write the page of an identification: measured frequency response, models of all orders, poles, reason for the order.

G(jw) = polarity e^{-jw delay} / sum_i a_i (jw)^i
"""

import numpy as np

from ...common.numbers import figure, shown_unit, with_error
from ...common.page import Page, Section, Table
from ...common.picture import Picture, figure_of, finish, new_axes
from ...common.quantity import grouped
from ...files.recordings.remarks import counted
from ...method.identify.identification import Identification
from ...method.identify.order_fit import OrderFit
from ...method.model.units import units_of
from ..compare.description import sensor_line
from .drawing import CYCLE, MEASURED
from .tables import orders


def bode_page(fits: Identification, name: str) -> Page:
    """Return the page on an identification whose model file is `name`."""
    chosen, recordings = fits.chosen, counted(len(fits.beginnings), "recording")
    hold = f"hold {chosen.hold}"
    if chosen.static:
        hold = "static"
    elif chosen.integrates:
        hold = "without a spring"
    delay = f", delay {figure(1e3 * chosen.delay, 3)} ms" if chosen.delay else ""
    return Page(
        f"Order {chosen.order}, {hold}{delay}",
        f"Identification of {name} on {recordings}",
        [_why(fits), sensor_line(fits.model), *fits.remarks, [bode(fits), _residuals(fits)]],
        [
            Section("Orders compared", [orders(fits)]),
            Section("Poles of the model", [_poles(chosen)]),
            Section("Residual", [_whiteness(fits)]),
        ],
    )


def _why(fits: Identification) -> str:
    """Write in one sentence why this order was chosen."""
    chosen, known = fits.chosen, [o.order for o in fits.orders if o.identifiable]
    if len(fits.orders) == 1:
        return f"Order {chosen.order} was asked for."
    least = min(fits.orders, key=lambda o: o.heldout)
    if least is chosen:
        return f"Order {chosen.order} predicts held-out blocks of the recordings best."
    if least.identifiable:
        return (
            f"Order {chosen.order} has the fewest poles and delays within 3 % of the held-out error of order "
            f"{least.order}."
        )
    return (
        f"Order {least.order} predicts held-out blocks better, but these recordings do not determine its poles. Order "
        f"{chosen.order} is the best of the determined ones ({', '.join(map(str, known))})."
    )


def _poles(fit: OrderFit) -> Table:
    rows = [
        (with_error(float(hz), float(error), "Hz"), float(damping))
        for hz, error, damping in zip(fit.natural_hz, fit.natural_stderr, fit.damping, strict=True)
    ]
    return Table(("pole", "damping"), rows)


def response_of(fit: OrderFit, hz: np.ndarray) -> np.ndarray:
    """Return a linear model's frequency response, output over input (base units), shape (frequencies,)."""
    s = 2j * np.pi * hz
    return fit.polarity * np.exp(-s * fit.delay) / np.polyval(fit.coefficients[::-1], s)


def bode(fits: Identification) -> Picture:
    """Draw the measured frequency response, the models of each order, and the coherence."""
    axes, r = new_axes(3, 6.6, (2, 2, 1)), fits.response
    seen = r.coherent & (2 * r.stderr < np.abs(r.value))  # the others would stretch the axis over decades
    units = units_of(fits.model)
    per_unit = units.force_factor / units.si.factor  # the response is in base units
    hz, value, error = r.hz[seen], per_unit * r.value[seen], 2 * per_unit * r.stderr[seen]
    if len(hz):
        grid, size = np.geomspace(hz.min(), hz.max(), 300), np.abs(value)
        axes[0].fill_between(hz, size - error, size + error, color=MEASURED, alpha=0.4)
        _response(axes, hz, value, ".", ms=3, color=MEASURED, label="measured")
        for fit, color in zip(fits.orders, CYCLE, strict=False):
            width = 1.8 if fit is fits.chosen else 0.8
            _response(
                axes, grid, per_unit * response_of(fit, grid), "-", color=color, lw=width, label=f"order {fit.order}"
            )
    axes[2].semilogx(r.hz, r.coherence, ".", ms=3, color=MEASURED)
    unit = f"{units.si.unit}/{grouped(shown_unit(units.force))}"
    finish(axes, "frequency (Hz)", [f"output / force ({unit})", "phase (deg)", "coherence"])
    caption = (
        "Grey: measured, with two standard errors; lines: the models of each order. Coherence: fraction of the output "
        "that is linear in the input."
    )
    return Picture("bode", figure_of(axes), caption)


def _response(axes: np.ndarray, hz: np.ndarray, value: np.ndarray, mark: str, **style) -> None:
    axes[0].loglog(hz, np.abs(value), mark, **style)
    axes[1].semilogx(hz, np.unwrap(np.angle(value)) * 180 / np.pi, mark, **style)


def _whiteness(fits: Identification) -> str:
    """Write in one sentence whether the residual is white and whether it depends on the input."""
    tested = fits.residuals
    past = "is white noise" if tested.white else "is correlated with its own past"
    drive = (
        "it does not depend on the input"
        if tested.independent
        else "it still depends on the input: this order lacks dynamics or a nonlinearity"
    )
    return f"The residual {past}; {drive}."


def _residuals(fits: Identification) -> Picture:
    axes, tested = new_axes(2, 3.6), fits.residuals
    rows = ((tested.own, tested.own_band), (tested.drive, tested.drive_band))
    for ax, (correlation, band) in zip(axes, rows, strict=True):
        ax.axhspan(-band, band, color=MEASURED, alpha=0.4, lw=0)
        ax.plot(tested.lag, correlation, ".-", ms=3, lw=0.8, color=CYCLE[0])
    axes[0].set_ylim(-1.05, 1.05)
    finish(axes, "lag (s)", ["autocorrelation\nof the residual", "correlation\nwith the force"])
    caption = "Grey band: a white residual stays within it at all lags in 95 % of cases."
    return Picture("residuals", figure_of(axes), caption)
