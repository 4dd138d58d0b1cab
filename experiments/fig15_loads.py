"""Figs. 15-16: tracking under three loads, and the hysteresis left after the feedforward (RMHE, eq. 16).

Claim: trained anew for each load, the feedforward tracks all of them, and linearises target against motion. The RMHE
is taken over the last cycle, beside that of the quasi-static voltage sqrt(a_0 x). The paper gives its RMHE only in
the figure.
"""

import sys

import numpy as np
from _paper import TABLE_2, Bench
from _show import arguments, axes_grid, finish, panel, show

import pitp_jax as pitp
from pitp_jax import _plot

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
        for f in (*TABLE_2[name], *HELD_OUT[bench.kind]):
            track = bench.play(model, bench.sine(f), f)
            rows = in_sample if f in TABLE_2[name] else held_out
            cycle = round(bench.actuator.rate_hz / f)
            loop = pitp.rmhe_percent(track.target, track.achieved, cycle)
            static = pitp.rmhe_percent(track.target, quasi_static(bench, model, track), cycle)
            rows.append((f"{name}, {f:g} Hz", TABLE_2[name].get(f), track.e_rms, None, loop, static))
            _loop(column[2], track, cycle, f"{f:g} Hz: {loop:.2f} %")
            if f == SHOWN_HZ[bench.kind]:
                _track(column[:2], name, track)
        _plot.finish(column[2:], "achieved (of the target's range)", ["target (of its range)"], 1)
        column[2].legend(fontsize=7, frameon=False)
        column[2].set_title("one cycle, RMHE", fontsize=8, loc="left")
    header = ("cell", "paper e_rms (%)", "ours e_rms (%)", "paper RMHE", "ours RMHE (%)", "quasi-static RMHE (%)")
    show("Figs. 15-16, frequencies in-sample", header, in_sample)
    show("frequencies held-out", header, held_out)
    finish(figure, options, "fig15_loads.png", "above: grey: target, dashed blue: achieved")


def quasi_static(bench, model, track):
    """What the plant does under sqrt(a_0 x), the inverse of the identified model standing still."""
    stiffness = model.physical_coefficients[0]
    voltage = np.sqrt(np.maximum(stiffness * track.target, 0.0))
    return pitp.simulate(bench.actuator, track.time, np.minimum(voltage, bench.actuator.max_voltage))


def _track(axes, name, track):
    """Fig. 15: target, motion and error over the last four periods."""
    last = track.time >= track.time[-1] - 4 / track.frequency
    _plot.prediction(track.time[last], track.target[last], track.achieved[last], axes)
    panel(axes[0], f"{name}, {track.frequency:g} Hz")


def _loop(ax, track, cycle: int, label: str):
    """Fig. 16: target over motion in the last cycle, both over the target's range."""
    low, width = track.target[-cycle:].min(), np.ptp(track.target[-cycle:])
    ax.plot((track.achieved[-cycle:] - low) / width, (track.target[-cycle:] - low) / width, lw=1.0, label=label)


if __name__ == "__main__":
    main(argv=sys.argv[1:])
