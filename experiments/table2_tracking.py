"""Table II, Fig. 13: sines by feedforward alone, played on the noise-free plant.

Claim: the inverted model tracks sines at every frequency of the band without feedback. Targets swing over half the
range the actuator reaches there. Table II's frequencies lie on the training grid (in-sample); others are held out.
"""

import sys

import _paper_figures as paper_figures
from _paper import ACTUATORS, TABLE_2, Bench
from _show import arguments, axes_grid, finish, panel, show

HELD_OUT = {"roll": (17.0, 48.0, 83.0, 117.0), "cone": (0.6, 2.5, 5.5, 8.5)}  # Hz, between the training sines


def main(smoke: bool = False, argv=()):
    """Track every cell on every actuator; print Table II; draw the largest cell of each."""
    options = arguments(__doc__, argv, smoke, ACTUATORS)
    figure, axes = axes_grid(6, len(options.plants), (3.0 * len(options.plants), 8.5), (2, 1, 1.2) * 2)
    header = ("cell", "paper (%)", "ours (%)", "model's own check (%)")
    for column, name in zip(axes.T, options.plants, strict=True):
        bench = Bench(name, options)
        model = bench.fit().model
        papers = {float(f): v for f, v in TABLE_2[name].items()}
        tracks = {f: bench.play(model, bench.sine(f), f) for f in (*papers, *HELD_OUT[bench.kind])}
        rows = [(f"{name}, {f:g} Hz", papers.get(f), t.e_rms, t.self_check) for f, t in tracks.items()]
        show(f"Table II, frequencies in-sample, {name}", header, rows[: len(papers)])
        show(f"frequencies held-out, {name}", header, rows[len(papers) :])
        for k, f in enumerate((min(papers), max(papers))):
            _draw(column[3 * k : 3 * k + 3], name, tracks[f])
    figure.align_ylabels(axes[:, 0])
    finish(figure, options, "table2_tracking.png", axes[0, 0])


def _draw(axes, name, track):
    """The last four periods."""
    last = track.time >= track.time[-1] - 4 / track.frequency
    paper_figures.tracking(track.time[last], track.target[last], track.achieved[last], track.voltage[last], axes)
    panel(axes[0], f"{name}, {track.frequency:g} Hz")


if __name__ == "__main__":
    main(argv=sys.argv[1:])
