"""Figs. 15-16: tracking under three loads, and the hysteresis left after the feedforward (RMHE, eq. 16).

Claim: trained anew for each load, the feedforward tracks all of them, and linearises target against motion. The RMHE
is taken over the last cycle, beside that of the quasi-static voltage sqrt(a_0 x). The paper gives its RMHE only in
the figure.
"""

import sys

import _paper_figures as paper_figures
import numpy as np
from _paper import TABLE_2, Bench
from _show import arguments, axes_grid, finish, panel, show

import pitp_jax as pitp
from pitp_jax.application.pages.drawing import CYCLE

LOADS = ("cone100", "cone122", "cone150", "roll")
HELD_OUT = {"roll": (48.0,), "cone": (5.5,)}  # Hz
SHOWN_HZ = {"roll": 30, "cone": 4}


def main(smoke: bool = False, argv=()):
    """Track on every load; print e_rms and RMHE; draw the tracking and the loops."""
    options = arguments(__doc__, argv, smoke, LOADS)
    figure, axes = axes_grid(3, len(options.plants), (3.0 * len(options.plants), 6.5), (2, 1, 3))
    in_sample, held_out = [], []
    for column, name in zip(axes.T, options.plants, strict=True):
        bench = Bench(name, options)
        model = bench.fit().model
        for f in sorted((*TABLE_2[name], *HELD_OUT[bench.kind])):
            track = bench.play(model, bench.sine(f), f)
            rows = in_sample if f in TABLE_2[name] else held_out
            cycle = round(bench.actuator.rate_hz / f)
            loop = pitp.rmhe_percent(track.target, track.achieved, cycle)
            alone = quasi_static(bench, model, track)
            static = pitp.rmhe_percent(track.target, alone, cycle)
            rows.append((f"{name}, {f:g} Hz", TABLE_2[name].get(f), track.e_rms, None, loop, static))
            color = CYCLE[len(column[2].lines) // 2]
            _loop(column[2], track.target, alone, cycle, color=color, lw=0.8, ls=":")
            _loop(column[2], track.target, track.achieved, cycle, color=color, lw=1.2, label=f"{f:g} Hz: {loop:.2f} %")
            if f == SHOWN_HZ[bench.kind]:
                _track(column[:2], name, track)
        paper_figures.finish(column[2:], "achieved (of the target's range)", ["target (of its range)"], 1)
        column[2].legend(
            loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False, fontsize=7, handlelength=1,
            columnspacing=1, title="RMHE of one cycle (dotted: quasi-static)", title_fontsize=8, alignment="left",
        )  # fmt: skip
    header = ("cell", "paper e_rms (%)", "ours e_rms (%)", "paper RMHE", "ours RMHE (%)", "quasi-static RMHE (%)")
    show("Figs. 15-16, frequencies in-sample", header, in_sample)
    show("frequencies held-out", header, held_out)
    finish(figure, options, "fig15_loads.png", axes[0, 0], ("target", "achieved"))


def quasi_static(bench, model, track):
    """What the plant does under sqrt(a_0 x), the inverse of the identified model standing still."""
    stiffness = model.physical_coefficients[0]
    voltage = np.sqrt(np.maximum(stiffness * track.target, 0.0))
    return pitp.simulate(bench.actuator, track.time, np.minimum(voltage, bench.actuator.max_voltage))


def _track(axes, name, track):
    """Fig. 15: target, motion and error over the last four periods."""
    last = track.time >= track.time[-1] - 4 / track.frequency
    paper_figures.prediction(track.time[last], track.target[last], track.achieved[last], axes)
    panel(axes[0], f"{name}, {track.frequency:g} Hz")


def _loop(ax, target, achieved, cycle: int, **style):
    """Fig. 16: target over motion in the last cycle, both over the target's range."""
    low, width = target[-cycle:].min(), np.ptp(target[-cycle:])
    ax.plot((achieved[-cycle:] - low) / width, (target[-cycle:] - low) / width, **style)


if __name__ == "__main__":
    main(argv=sys.argv[1:])
