"""Figs. 19-21: the paper's preset without its token limit, in other scales, and with another order.

Claim: without the soft limit predictions drift away, without scaling the training does not converge, and a second-order
model fails at some frequencies. Scaling cannot be switched off here: instead of raw units stands the training rms of
every derivative, beside the paper's eq. 3. Where the data choose order 2 the wrong order is not 2 but 1 and 3. 3 and
5 Hz (10 and 100 Hz on the roll) lie on the training grid; the held-out records are ours. No loss is given in the text.
"""

import sys
from dataclasses import replace

import _paper_figures as paper_figures
import numpy as np
from _paper import PRESETS, Bench, errors
from _show import arguments, axes_grid, finish, overlay, panel, show

import pitp_jax as pitp
from pitp_jax.application.pages.drawing import CYCLE

PAPER = PRESETS["paper"]
SHOWN_HZ = {"roll": (10, 100), "cone": (3, 5)}


def variants(order: int):
    """Label -> settings and order."""
    others = (1, 3) if order == 2 else (2,)
    return {
        f"proposed (order {order})": (PAPER, "auto"),
        "no limit": (replace(PAPER, penalty=(0.0, 0.0)), "auto"),
        "rms scale for eq. 3": (replace(PAPER, scaling="rms"), "auto"),
        **{f"order {n}": (PAPER, n) for n in others},
    }


def main(smoke: bool = False, argv=()):
    """Train every variant; print losses and errors; draw the losses and the predictions."""
    options = arguments(__doc__, argv, smoke, ("cone100",))
    for name in options.plants:
        bench, fits = Bench(name, options), {}
        for label, (settings, order) in variants(bench.identify().chosen.order).items():
            try:
                fits[label] = bench.fit(settings, order)
            except pitp.ComputationFailed as trouble:
                print(f"{label}: {trouble}")
        in_sample, held_out = [], []
        for label, fit in fits.items():
            inside, outside = errors(fit.model, bench.train), errors(fit.model, bench.test)
            shown = [inside[bench.grid(f).name] for f in SHOWN_HZ[bench.kind]]
            loss = f"{fit.losses[-1][2]:.2e}"
            in_sample.append((label, None, *shown, float(np.median(list(inside.values()))), loss, fit.seconds))
            values = list(outside.values())
            held_out.append((label, None, float(np.median(values)), float(np.max(values)), *values))
        header = ("cell", "paper", *(f"ours, {f} Hz (%)" for f in SHOWN_HZ[bench.kind]))
        header = (*header, "all sines, median (%)", "best physics loss", "fit (s)")
        show(f"Figs. 20-21, in-sample, {name}", header, in_sample)
        show(f"held-out, {name}", ("cell", "paper", "ours, median (%)", "worst (%)", *outside), held_out)
        _draw(options, bench, fits)


def _draw(options, bench, fits):
    """Fig. 19 above, Figs. 20 and 21 below: one row per variant, one column per frequency."""
    figure, axes = axes_grid(1 + len(fits), 2, (7.5, 2.2 + 1.2 * len(fits)), (2.2, *[1.2] * len(fits)))
    for (label, fit), color in zip(fits.items(), CYCLE, strict=False):
        _, losses, best = zip(*fit.losses, strict=True)
        style = {"color": color, "lw": 1.0, "marker": "." if options.smoke else ""}
        axes[0, 0].semilogy(np.arange(1, len(losses) + 1), losses, **style)
        axes[0, 1].semilogy(np.arange(1, len(losses) + 1), best, label=label, **style)
    paper_figures.finish(axes[0, :1], "epoch", ["training loss"])
    paper_figures.finish(axes[0, 1:], "epoch", ["best physics loss"], 1)
    axes[0, 1].get_legend().set(loc="center right", bbox_to_anchor=(1, 0.42))
    for column, frequency in zip(axes[1:].T, SHOWN_HZ[bench.kind], strict=True):
        record = bench.grid(frequency)
        low, high = 1e3 * record.displacement.min(), 1e3 * record.displacement.max()
        for ax, fit in zip(column, fits.values(), strict=True):
            run = pitp.predict(fit.model, [record])[0].displacement
            overlay(ax, record.time, record.displacement, run)
            ax.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
        paper_figures.finish(column, "time (s)", ["x (mm)"] * len(column))
        for ax, label in zip(column, fits, strict=True):
            panel(ax, f"{label}, {frequency} Hz")
    finish(figure, options, f"fig19_ablations_{bench.name}.png", axes[1, 0])


if __name__ == "__main__":
    main(argv=sys.argv[1:])
