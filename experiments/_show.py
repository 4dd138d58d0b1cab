"""Command line, tables and figures of the scripts."""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from _paper import ACTUATORS
from _paper_figures import over
from matplotlib.figure import Figure

from pitp_jax.application.pages.drawing import MEASURED, PREDICTED


def arguments(doc: str, argv, smoke: bool, plants=("cone100",)):
    """Command line of a script; `plants` are those it runs by default (one in smoke)."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    parser.add_argument("--out", type=Path, help="figures (default experiments/figures; in smoke a temporary folder)")
    parser.add_argument("--cache", type=Path, help="keep fitted models in this folder (default: in this process only)")
    parser.add_argument("--plants", nargs="+", choices=ACTUATORS)
    options = parser.parse_args(list(argv))
    options.smoke = smoke or options.smoke
    options.plants = options.plants or (plants[:1] if options.smoke else plants)
    if options.out is None:
        here = Path(__file__).parent / "figures"
        options.out = Path(tempfile.gettempdir()) / "pitp_smoke" if options.smoke else here
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def show(title: str, header: tuple[str, ...], rows) -> None:
    """Print a table; None (the paper gives no number) is a dash."""
    text = [[_cell(v) for v in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*text, strict=True)]
    print(f"\n{title}")
    for row in text:
        print(
            " | ".join(v.ljust(w) if k == 0 else v.rjust(w) for k, (v, w) in enumerate(zip(row, widths, strict=True)))
        )


def _cell(value) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.2f}" if np.isfinite(value) else "diverged"
    return str(value)


def axes_grid(rows: int, columns: int, size: tuple[float, float], heights=None):
    """A figure of `size` inches with its axes, shape (rows, columns)."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, gridspec_kw={"height_ratios": heights})


def panel(ax, text: str) -> None:
    """Name a panel; its own legend goes, the figure has one."""
    if ax.get_legend():
        ax.get_legend().remove()
    ax.set_title(text, fontsize=8, loc="left")


def overlay(ax, time, measured, predicted) -> None:
    """A measured displacement (m) and a predicted one over it, in mm."""
    ax.plot(time, 1e3 * measured, color=MEASURED, lw=2.4, label="measured")
    ax.plot(time, 1e3 * predicted, color=PREDICTED, lw=1.0, label="predicted", **over(predicted))


def finish(figure, options, name: str, key, names=None) -> None:
    """Write the figure and say where; one legend above it for the lines of the axes `key`, or other names for them."""
    lines, texts = key.get_legend_handles_labels()
    figure.legend(lines, names or texts, loc="outside upper center", ncols=len(lines), frameon=False, fontsize=8)
    figure.savefig(options.out / name, dpi=200)
    print(f"figure: {options.out / name}", flush=True)
