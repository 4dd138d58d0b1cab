"""Fig. 6 and the orders: sweeps, identified linear models, and how the order is chosen by the data.

Claim: a linear ODE identified on the sweep carries the global dynamics; the paper finds 3 tokens for the cone and 4
for the roll at every load (order 2 and 3 where n + 1 tokens multiply x ... x^(n)), resonances at 7.4 and 142 Hz.
In-sample is the sweep itself; every sine is held out.
"""

import sys
import time

import _paper_figures as paper_figures
import numpy as np
from _paper import ACTUATORS, RESONANCE_HZ, TOKENS, Bench, errors
from _show import arguments, axes_grid, finish, panel, show

import pitp_jax as pitp

SWEEP_HZ = {"cone": (0.01, 20.0), "roll": (0.01, 180.0)}


def main(smoke: bool = False, argv=()):
    """Identify every actuator; print orders and errors; draw the sweeps."""
    options = arguments(__doc__, argv, smoke, ACTUATORS)
    figure, axes = axes_grid(len(options.plants), 1, (5.5, 0.4 + 1.9 * len(options.plants)))
    cells, in_sample, held_out = [], [], []
    for ax, name in zip(axes[:, 0], options.plants, strict=True):
        bench, began = Bench(name, options), time.perf_counter()
        found = bench.identify()
        seconds = time.perf_counter() - began
        cells += _cells(name, found)
        run = pitp.predict(found.model, [bench.sweep])[0]
        for o in found.orders:
            note = "chosen" if o.order == found.chosen.order else "" if o.identifiable else "not identifiable"
            in_sample.append((f"{name}, order {o.order}", None, 1e6 * o.mae, 1e6 * o.rms, note))
        scores = errors(found.model, (*bench.train, *bench.test))
        swept = pitp.e_rms_percent(run.displacement, bench.sweep.displacement, run.scored)
        values = np.array(list(scores.values()))
        held_out.append((name, None, float(np.median(values)), float(values.max()), swept, f"{seconds:.0f} s"))
        paper_figures.sweep_response(
            bench.sweep.time, bench.sweep.displacement, run.displacement, ax,
            sweep_hz=SWEEP_HZ[bench.kind] if not options.smoke else None,
        )  # fmt: skip
        panel(ax, f"{name}, order {found.chosen.order}")
    show("Order and resonance", ("cell", "paper", "ours"), cells)
    show(
        "In-sample: the identified models on their sweep",
        ("cell", "paper", "ours, mean abs. (um)", "rms (um)", ""),
        in_sample,
    )
    columns = ("cell", "paper", "ours, median e_rms (%)", "worst (%)", "sweep, in-sample (%)", "identified in")
    show("Held-out: the chosen linear model on all sines, a triangle, a complex and a long record", columns, held_out)
    finish(figure, options, "fig06_orders.png", axes[0, 0])


def _cells(name, found):
    """Paper's tokens and resonance beside ours."""
    chosen = found.chosen
    peak = chosen.natural_hz[np.argmin(chosen.damping)]
    return [
        (f"{name}, tokens (order + 1)", TOKENS[name], chosen.order + 1),
        (f"{name}, resonance (Hz)", RESONANCE_HZ.get(name), float(peak)),
    ]


if __name__ == "__main__":
    main(argv=sys.argv[1:])
