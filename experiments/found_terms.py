"""Terms of actuators whose cause is outside the catalogue: gap closed, planted terms, noise.

    clean (healthy) -> identify -> nominal;    real (a force of `_withheld/found.py`) -> diagnose -> term

    python experiments/found_terms.py [--set tuned|reported|none] [--kinds cone,roll] [--seeds 500] [--track]
        [--cache DIR] [--results DIR] [--smoke]

closed is judged on the noise-free outputs of the records held out, whatever the model handed back carries. A term is
right where its functions are those planted. `none`: healthy actuators, where nothing may be found. `--track`: e_rms of
a sine of half the resonance, from the nominal's and the handed-back model's feedforward, played on the true plant.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from _show import show
from _withheld import plant as integrator
from _withheld import protocol, score
from _withheld.case import Case, Spec, load_or_make
from _withheld.catalogue import FORMS
from _withheld.found import REPORTED, TERMS, TUNED

import pitp_jax as pitp
from pitp_jax._effects.found_term import PRODUCTS


def diagnosed(spec: Spec, case: Case, track: bool) -> dict:
    """One row: verdict, equation, and the share closed without noise."""
    nominal = pitp.identify(case.clean, order=2, input_map="square").model
    began = time.perf_counter()
    found = pitp.diagnose(nominal, case.real)
    seconds, term, held = time.perf_counter() - began, found.term, found.records["heldout"]
    before, after = (score.pooled(score.runs(m, case, held), case, held) for m in (nominal, found.model))
    functions = [PRODUCTS[int(name[1:]) - 1] for name in term.parameters] if term else []
    planted = TERMS.get(spec.label)
    row = {
        "case": f"{spec.label} {spec.kind} {spec.seed}", "verdict": "+".join(found.effects) or found.verdict,
        "equation": term.equation if term else "", "said": term.closed_fraction if term else found.gap.closed_fraction,
        "closed": 1 - after / before, "right": None if planted is None else set(functions) == planted,
        "seconds": seconds, "before": before, "after": after,
    }  # fmt: skip
    return row | (tracked(spec, case, nominal, found.model) if track and term else {})


def tracked(spec: Spec, case: Case, nominal, model) -> dict:
    """Tracking errors in % on the true plant, without noise."""
    kind, facts = protocol.KINDS[spec.kind], case.facts
    plant = protocol.Healthy(kind, facts["zeta"], facts["f0_hz"], facts["scale_m"])
    t = np.arange(round(kind.length * kind.rate)) / kind.rate
    top = 0.4 * plant.scale  # of the static displacement under the largest voltage
    target = 0.5 * top * (1 - np.cos(2 * np.pi * 0.5 * plant.f0 * t)) * np.minimum(1, t * plant.f0 / 4) ** 3
    said, (form,) = {}, [f for f in FORMS[spec.label] if f.name == facts["forms"][0]]
    for name, m in (("track before", nominal), ("track after", model)):
        plan = pitp.feedforward(m, pitp.Target(t, target))
        none = dict.fromkeys(("push", "gate", "add"), (None,))
        ports = {"u": plan.voltage[None] / kind.top, "clock": np.zeros(1)} | none
        y = integrator.outputs((form,), [facts["strengths"]], facts["constants"], plant.constants, ports)[0, 0]
        said[name] = pitp.e_rms_percent(plant.scale * y[plan.target], target)
    return said


def row_of(spec: Spec, options) -> dict:
    """A row from the results folder, or a fresh one left there."""
    path = options.results / f"{spec.key}.json" if options.results else None
    if path and path.exists():
        return json.loads(path.read_text())
    row = diagnosed(spec, load_or_make(spec, options.cache), options.track)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(row))
    return row


def main(smoke: bool = False, argv=None):
    """Diagnose, print every row, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", choices=("tuned", "reported", "none"), default="reported")
    parser.add_argument("--kinds", type=lambda s: s.split(","), default=["cone", "roll"])
    parser.add_argument("--seeds", type=lambda s: [int(k) for k in s.split(",")], default=[500])
    parser.add_argument("--track", action="store_true")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args([] if smoke and argv is None else argv)
    names = {"tuned": [(n,) for n in TUNED], "reported": [(n,) for n in REPORTED], "none": [()]}[options.set]
    if smoke or options.smoke:
        options.kinds, names, options.seeds = ["short"], [("position_damping",)], [0]
    rows = []
    for spec in [Spec(n, kind, seed) for n in names for kind in options.kinds for seed in options.seeds]:
        rows.append(row_of(spec, options))
        print("  ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in rows[-1].values()), flush=True)
    known = [r["right"] for r in rows if r["right"] is not None]
    show("all", ("figure", "value"), [
        ("terms found", f"{sum(bool(r['equation']) for r in rows)}/{len(rows)}"),
        ("closed without noise, median", float(np.median([r["closed"] for r in rows]))),
        ("worse than the nominal", sum(r["closed"] < -0.02 for r in rows)),
        ("planted terms and no others", f"{sum(known)}/{len(known)}"),
        ("seconds, median", float(np.median([r["seconds"] for r in rows]))),
    ])  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
