"""Measured rigs: what the diagnosis says of machines that nobody simulated, and how much of their gap it closes.

    nominal (one excitation, or the smallest drives) -> diagnose on some records -> free runs on records kept out

    python experiments/measured_bank.py [RIG ...] [--data ../shared] [--smoke]

Names that are right were fixed beforehand from each rig's own literature; `unknown` is neither right nor wrong. closed
is 1 - e_after / e_before of the model handed back (effects or term) on records that neither nominal nor diagnosis saw,
e the pooled rms in % of range. Data is never part of this project; what is absent is skipped.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from _show import show

import pitp_jax as pitp

FRICTION = ("coulomb_friction", "backlash", "hysteresis", "slew_limit")


@dataclass(frozen=True)
class Rig:
    """One measured machine.

    Attributes:
        source, licence: of its records.
        folder: below the data folder.
        load: records by name to (those to identify on, those to diagnose on, those to score on).
        names: right answers.
        options: of `identify`.
        refit: the nominal was identified on records that carry the effect.
    """

    source: str
    licence: str
    folder: str
    load: Callable[[dict], tuple[list, list, list]]
    names: tuple[str, ...]
    options: dict
    refit: bool = True


def part(record, first: float, last: float, name: str):
    """The record from `first` to `last`, in shares of its length."""
    ends = slice(*(round(share * len(record.time)) for share in (first, last)))
    return replace(record, name=name, **{f: getattr(record, f)[ends] for f in ("time", "voltage", "displacement")})


def _hasel(by_name):
    steps = by_name["steps"]
    small = part(steps, 0.0, 36.0 / (steps.time[-1] - steps.time[0]), "small steps")
    kept = [by_name[n] for n in ("sine_01Hz", "sine_11Hz")]
    return [small], [steps, by_name["sine_03Hz"], by_name["sine_07Hz"]], kept


def _joint(by_name):
    kept = ("large_amplitude", "multisine")
    rest = [r for name, r in by_name.items() if name not in (*kept, "static_holding")]
    return [by_name["chirp_sweep"]], rest, [by_name[name] for name in kept]


def _silverbox(by_name):
    train = by_name["multisine_train"]
    halves = [part(train, 0.0, 0.5, "first half"), part(train, 0.5, 1.0, "second half")]
    return [train], halves, [by_name["multisine_test"], by_name["arrow_no_extrapolation_test"]]


_SO101 = "github.com/isaac-sim2real/sage", "Apache-2.0"
_DELAYED = {"order": 2, "input_map": "linear", "learn": ("delay",)}
RIGS = {
    "silverbox": Rig("github.com/biaslab/nsi-silverbox", "MIT", "data/silverbox", _silverbox, ("stiffening",),
                     {"order": 2, "input_map": "linear"}),
    "hasel": Rig("github.com/MadhavL/PH-HASEL-Python", "none stated", "data/hasel_peano", _hasel,
                 ("slack", "stretch_coupling", "charge_retention"), {"order": 2, "input_map": "square"}),
    "so101_elbow": Rig(*_SO101, "data/so101/elbow", _joint, FRICTION, _DELAYED),
    "so101_pitch": Rig(*_SO101, "data/so101/pitch", _joint, FRICTION, _DELAYED),
}  # fmt: skip


def pooled(model, records) -> float:
    """e_rms in % of range, pooled; inf where a run diverged."""
    runs = pitp.predict(model, records)
    errors = [pitp.e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in zip(runs, records, strict=True)]
    return float(np.nan_to_num(np.sqrt(np.mean(np.square(errors))), nan=np.inf))


def row(name: str, rig: Rig, root: Path, smoke: bool) -> tuple:
    """Name, verdict, first in the ranking, whether it is right, error before and after, share closed, seconds."""
    by_name = {r.name: r for r in pitp.read(root / rig.folder)}
    first, told, kept = rig.load(by_name)
    if smoke:
        told, kept = ([part(r, 0, 0.1, r.name) for r in rs] for rs in (told, kept))
    nominal = pitp.identify(first, **rig.options).model
    began = time.perf_counter()
    found = pitp.diagnose(nominal, told, refit_nominal=rig.refit)
    seconds = time.perf_counter() - began
    said = "+".join(found.effects) or found.verdict
    right = "-" if not found.effects else "right" if found.effects[0] in rig.names else "WRONG"
    before, after = pooled(nominal, kept), pooled(found.model, kept)
    if found.term:
        print(f"{name}: {found.term.equation}", {k: v["value"] for k, v in found.term.parameters.items()}, flush=True)
    leading = found.ranking[0].effect if found.ranking else "-"
    return name, said, leading, right, before, after, 1 - after / before, seconds


def main(smoke: bool = False, argv=None):
    """A row per rig that is there, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rigs", nargs="*", help=", ".join(RIGS))
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args([] if smoke and argv is None else argv)
    rows = []
    for name in options.rigs or RIGS:
        if not (options.data / RIGS[name].folder).is_dir():
            print(f"{name} skipped: {options.data / RIGS[name].folder} is absent ({RIGS[name].source})")
            continue
        rows.append(row(name, RIGS[name], options.data, smoke or options.smoke))
        print(rows[-1], flush=True)
    header = ("rig", "verdict", "first ranked", "name", "before %", "after %", "closed", "seconds")
    show("measured rigs, records kept out", header, rows)
    if rows:
        print(f"median closed {np.median([r[6] for r in rows]):.2f}, wrong {sum(r[3] == 'WRONG' for r in rows)}")
    return rows


if __name__ == "__main__":
    main()
