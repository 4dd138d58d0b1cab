"""Write the page of an identification: measured frequency response, models of all orders, poles, reason for the order.

G(jw) = polarity e^{-jw delay} / sum_i a_i (jw)^i
"""

import numpy as np
from matplotlib.figure import Figure

from ...common.numbers import figure, shown_unit, with_error
from ...common.quantity import grouped
from ...method.identify.identification import Identification
from ...method.identify.order_fit import OrderFit
from ...method.model.units import units_of
from . import html
from .description import sensor_line
from .html import tag
from .lines import CYCLE, MEASURED, finish, own_axes


def bode_page(fits: Identification, name: str) -> str:
    """Write an HTML page on an identification whose model file is `name`."""
    chosen = fits.chosen
    kind = f"hold {chosen.hold}"
    if chosen.static or chosen.integrates:
        kind = "static" if chosen.static else "without a spring"
    delay = f", delay {figure(1e3 * chosen.delay, 3)} ms" if chosen.delay else ""
    parts = [
        tag(
            "p",
            f"Identification of {name} on {len(fits.beginnings)} recording{'s'[: len(fits.beginnings) != 1]}",
            "soft",
        ),
        tag("h1", f"Order {chosen.order}, {kind}{delay}"),
        *[tag("p", remark, "lead") for remark in (_why(fits), sensor_line(fits.model), *fits.remarks)],
        '<div class="figures">',
        html.picture("bode", _bode(fits), "Grey: measured, with two standard errors; lines: the models of each order."),
        html.picture("coherence", _coherence(fits), "Fraction of the output that is linear in the input (coherence)."),
        html.picture(
            "residuals",
            _residuals(fits),
            "Grey band: a white residual stays within it at all lags in 95 % of cases.",
        ),
        "</div>",
        tag("h2", "Orders compared"),
        html.table(_ORDERS, [("named" if o is chosen else "", _order(o)) for o in fits.orders], {}),
        tag("h2", "Poles of the model"),
        html.table(("pole", "damping"), [("", row) for row in _poles(chosen)], {0: "left"}),
        tag("h2", "Residual"),
        tag("p", _leaves(fits)),
    ]
    return html.page(f"Order {chosen.order}", parts)


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


_ORDERS = ("order", "hold", "delay, ms", "held out, % of std", "in sample, rms", "determined")


def _order(fit: OrderFit) -> tuple[str, ...]:
    delay = figure(1e3 * fit.delay, 3) if fit.delay else "–"
    return str(fit.order), fit.hold, delay, figure(fit.heldout), figure(fit.rms), "yes" if fit.identifiable else "no"


def _poles(fit: OrderFit) -> list[tuple[str, str]]:
    rows = zip(fit.natural_hz, fit.natural_stderr, fit.damping, strict=True)
    return [(with_error(float(hz), float(error), "Hz"), figure(float(damping))) for hz, error, damping in rows]


def response_of(fit: OrderFit, hz: np.ndarray) -> np.ndarray:
    """Return a linear model's frequency response, output over input (base units), shape (frequencies,)."""
    s = 2j * np.pi * hz
    return fit.polarity * np.exp(-s * fit.delay) / np.polyval(fit.coefficients[::-1], s)


def _bode(fits: Identification) -> Figure:
    axes = own_axes(None, 2, (5.0, 5.2))
    seen, units = fits.response.coherent, units_of(fits.model)
    per_unit = units.force_factor / units.si.factor  # the response is in base units
    hz, value, stderr = (
        fits.response.hz[seen],
        *(per_unit * v[seen] for v in (fits.response.value, fits.response.stderr)),
    )
    if len(hz):
        grid = np.geomspace(hz.min(), hz.max(), 300)
        size = np.abs(value)
        axes[0].fill_between(
            hz, np.maximum(size - 2 * stderr, 1e-3 * size), size + 2 * stderr, color=MEASURED, alpha=0.4
        )
        axes[0].loglog(hz, size, ".", ms=3, color=MEASURED, label="measured")
        axes[1].semilogx(hz, np.unwrap(np.angle(value)) * 180 / np.pi, ".", ms=3, color=MEASURED)
        for fit, color in zip(fits.orders, CYCLE, strict=False):
            model = per_unit * response_of(fit, grid)
            width = 1.8 if fit is fits.chosen else 0.8
            axes[0].loglog(grid, np.abs(model), color=color, lw=width, label=f"order {fit.order}")
            axes[1].semilogx(grid, np.unwrap(np.angle(model)) * 180 / np.pi, color=color, lw=width)
    unit = f"{units.si.unit}/{grouped(shown_unit(units.force))}"
    finish(axes, "frequency (Hz)", [f"output / force ({unit})", "phase (deg)"], 2)
    return axes[0].figure  # pyright: ignore[reportReturnType]


def _leaves(fits: Identification) -> str:
    """Write in one sentence whether the residual is white and whether it depends on the input."""
    tested = fits.residuals
    own = "is white noise" if tested.white else "is correlated with its own past"
    drive = (
        "it does not depend on the input"
        if tested.independent
        else "it still depends on the input: this order lacks dynamics or a nonlinearity"
    )
    return f"The residual {own}; {drive}."


def _residuals(fits: Identification) -> Figure:
    axes, tested = own_axes(None, 2, (5.0, 3.6)), fits.residuals
    rows = ((tested.own, tested.own_band), (tested.drive, tested.drive_band))
    for ax, (correlation, band) in zip(axes, rows, strict=True):
        ax.axhspan(-band, band, color=MEASURED, alpha=0.4, lw=0)
        ax.plot(tested.lag, correlation, ".-", ms=3, lw=0.8, color=CYCLE[0])
    axes[0].set_ylim(-1.05, 1.05)
    finish(axes, "lag (s)", ["autocorrelation\nof the residual", "correlation\nwith the force"])
    return axes[0].figure  # pyright: ignore[reportReturnType]


def _coherence(fits: Identification) -> Figure:
    ax = own_axes(None, 1, (5.0, 2.2))[0]
    ax.semilogx(fits.response.hz, fits.response.coherence, ".", ms=3, color=MEASURED)
    finish(np.array([ax]), "frequency (Hz)", ["coherence"])
    return ax.figure  # pyright: ignore[reportReturnType]
