"""`plan`: which recordings to take, before there is a model, and with one.

    nothing yet            first_session: growth, sweep, space-filling set, repeats
    an identified model    space_filling_set within its limits and the stroke allowed
    a trained model        of many candidates those that lower its expected held-out error most, until what one lowers
                           it by is below what could be seen:  1 - sqrt((v_after + e^2) / (v_before + e^2)) < 1 %

v: mean variance of the predictions (`information`), e: what the model leaves of its records, noise included, both in %
of a recording's range. A refinement stops at the same share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._errors import BadInput
from .._model.encoder import ConstantEncoder
from .._model.model import Model
from .._record.record import Record
from .._record.sets import check_set
from .drives import Planned, space_filling
from .expected_error import Knowledge, Motions, knowledge, motions
from .first_session import POINTS, default_duration, drive, first_session, in_order, space_filling_set
from .information import choose, variance
from .limits import Limits, default_rate

_CANDIDATES, _JUDGED = 48, 16  # drives to choose among, and drives to be predicted
_SEEN = 0.01
_BAND = (0.05, 1.3)  # of a model's resonance, where no band is given


@dataclass(frozen=True)
class Plan:
    """What `plan` found.

    Attributes:
        recordings: to take, in this order; of existing ones ranked, the best first. Empty where `stop`.
        limits: what they keep.
        expected: error on drives not recorded yet, % of range, noise not counted: before, and after each recording;
            empty without a trained model.
        stop: whether another recording would lower the error by less than could be seen.
        notes: what was left out, and why.
    """

    recordings: tuple[Planned, ...]
    limits: Limits
    expected: tuple[float, ...] = ()
    stop: bool = False
    notes: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Of drive, rests not counted."""
        return sum(r.seconds for r in self.recordings)

    def as_json(self) -> dict:
        """The plan for machines; what is not known is null."""
        low, high = self.limits.low, self.limits.high
        return {
            "limits": {"voltage": [low, high], "slew": self.limits.slew, "displacement_m": self.limits.farthest,
                       "band_hz": list(self.limits.band), "rate_hz": self.limits.rate, "rest_s": self.limits.rest},
            "stop": self.stop,
            "expected_error_percent": list(self.expected),
            "recordings": [
                {"name": r.name, "kind": r.kind, "purpose": r.purpose, "seconds": r.seconds, "rest_s": r.rest,
                 "max_voltage": float(np.abs(r.voltage).max()), "max_slew": r.slew, "stroke_m": r.stroke,
                 "only_if_stroke_below_m": r.go_on}
                for r in self.recordings
            ],
            "notes": list(self.notes),
        }  # fmt: skip


def plan(
    model: Model | None = None,
    records: Sequence[Record] = (),
    *,
    max_voltage: float | None = None,
    max_slew: float | None = None,
    max_displacement: float | None = None,
    band: tuple[float, float] | None = None,
    duration: float | None = None,
    rest: float = 0.0,
    rate: float | None = None,
    choose_from: Sequence[Record] = (),
    alternate: bool = False,
    seed: int = 0,
) -> Plan:
    """Plan the recordings to take next.

    Args:
        model: identified or trained; None for a first session.
        records: taken so far, those the model was trained on.
        max_voltage: V; default what the model has seen.
        max_slew: V/s; default what the model has seen, else the band's own at that voltage.
        max_displacement: m from 0 V either way.
        band: lowest and highest drive frequency in Hz; default 0.05 to 1.3 times the model's resonance.
        duration: seconds of drive in all recordings together, rests not counted.
        rest: seconds at 0 V between recordings, for the membrane.
        rate: samples per second; default the model's, else a hundred a period of the highest frequency.
        choose_from: existing recordings to choose among instead; their output is not looked at.
        alternate: play every second recording with negative voltage (a bipolar amplifier).
        seed: of the space-filling points.

    Raises:
        BadInput: limits that are missing or cannot be met.
    """
    if records:
        check_set(records)
    if choose_from:
        return _ranked(model, records, choose_from, duration)
    limits = _limits(model, max_voltage, max_slew, max_displacement, band, rest, rate)
    alternate = alternate and limits.low == 0
    if model is None:
        length = duration or default_duration(limits, fresh=True)
        return Plan(in_order(first_session(limits, length, seed), limits, alternate=alternate), limits)
    length = duration or default_duration(limits, fresh=False)
    if not trained(model):
        filling, notes = _bearable(model, space_filling_set(limits, length, seed), limits)
        return Plan(in_order(filling, limits, alternate=alternate), limits, notes=notes)
    if not records:
        raise BadInput("a trained model says what it lacks only beside the records it was trained on: give them too")
    return _next(model, records, limits, length, seed, alternate)


def trained(model: Model) -> bool:
    """Whether a model has an encoder whose numbers records can tell of."""
    return not isinstance(model.encoder, ConstantEncoder)


def _limits(model, max_voltage, max_slew, max_displacement, band, rest, rate) -> Limits:
    """Those given, else the model's.

    Raises:
        BadInput: one is missing.
    """
    missing = [name for name, value in (("--max-voltage", max_voltage), ("--band", band)) if value is None]
    if model is None and missing:
        raise BadInput(f"a first session needs {' and '.join(missing)}: what the amplifier and the membrane bear")
    low, high = (0.0, 0.0) if model is None else model.provenance.voltage_range
    one_sided = model is None or model.input_map.one_sided
    high, low = max(high, -low) if one_sided else high, 0.0 if one_sided else min(low, 0.0)
    if max_voltage is not None:
        high, low = max_voltage, max(low, -max_voltage)
    if band is None and model is not None:
        hz = model.natural_frequency / (2 * np.pi)
        band = (_BAND[0] * hz, min(_BAND[1] * hz, (rate or 1 / model.provenance.dt) / 20))
    assert band is not None
    rate = rate or (default_rate(band[1]) if model is None else 1 / model.provenance.dt)
    if max_slew is None:
        max_slew = np.pi * band[1] * (high - low) if model is None else model.provenance.slew
    farthest = np.inf if max_displacement is None else max_displacement
    return Limits(low, high, float(max_slew), farthest, (float(band[0]), float(band[1])), float(rate), float(rest))


def _bearable(model: Model, drives: Sequence[Planned], limits: Limits) -> tuple[list[Planned], tuple[str, ...]]:
    """Drives whose predicted stroke stays below the limit, each with its stroke, and a note about the others."""
    told = motions(model, [d.voltage for d in drives], 1 / limits.rate, slopes=False)
    kept = [replace(d, stroke=float(x)) for d, x, ok in zip(drives, told.stroke, told.finite, strict=True)
            if ok and x <= limits.farthest]  # fmt: skip
    if not kept:
        raise BadInput(
            f"--max-displacement {1e3 * limits.farthest:g} mm: every drive is predicted to exceed it (the gentlest "
            f"{1e3 * told.stroke.min():.3g} mm); lower --max-voltage"
        )
    left = len(drives) - len(kept)
    return kept, (f"{left} of {len(drives)} drives left out: their predicted stroke exceeds the limit",) if left else ()


def _next(model: Model, records, limits: Limits, length: float, seed: int, alternate: bool) -> Plan:
    """The next recordings for a trained model."""
    dt = 1 / limits.rate
    known = knowledge(model, records)
    one = max(limits.shortest, min(length, default_duration(limits, fresh=False) / 8))
    count = int(length / one * (1 + 1e-9))
    if count < 1:
        raise BadInput(f"--duration {length:g} s is too short: one recording takes {limits.shortest:.3g} s")
    points = space_filling(_CANDIDATES * POINTS, limits, seed)
    tried = [drive(points[k::_CANDIDATES], one, limits) for k in range(_CANDIDATES)]
    tried, notes = _bearable(model, tried, limits)
    told = motions(model, [d.voltage for d in tried], dt)
    wanted = space_filling(_JUDGED, limits, seed + 1)
    judged = motions(model, [drive(p[None], one, limits).voltage for p in wanted], dt)
    places, expected, stop = _chosen(known, told, judged, np.full(len(tried), one), count)
    chosen = [_explained(tried[k], expected[j], expected[j + 1]) for j, k in enumerate(places)]
    return Plan(in_order(chosen, limits, alternate=alternate), limits, expected, stop, notes)


def _explained(r: Planned, before: float, after: float) -> Planned:
    what = r.purpose.split(":")[0]
    return replace(r, purpose=f"{what}: lowers the expected error from {before:.3g} to {after:.3g} %")


def _chosen(
    known: Knowledge, told: Motions, judged: Motions, seconds: np.ndarray, count: int, *, stop: bool = True
) -> tuple[list[int], tuple[float, ...], bool]:
    """Places taken, expected error in % before and after each, and whether the next would not be seen."""
    g = np.mean([m for m, ok in zip(judged.information, judged.finite, strict=True) if ok], axis=0)
    found = choose(known.precision, [t * m for t, m in zip(seconds, told.information, strict=True)], g, count)
    v = known.unit * np.array([variance(known.precision, g), *(c.variance for c in found)])
    gain = 1 - np.sqrt((v[1:] + known.error**2) / (v[:-1] + known.error**2))
    worth = len(found) if not stop or (gain >= _SEEN).all() else int(np.argmax(gain < _SEEN))
    return [c.place for c in found[:worth]], tuple(map(float, np.sqrt(v[: worth + 1]))), worth < len(found)


def _ranked(model: Model | None, records, choose_from: Sequence[Record], duration: float | None) -> Plan:
    """Existing recordings, those first that lower the expected error on all of them most."""
    if model is None or not trained(model) or not records:
        raise BadInput("--choose-from needs a trained model and the records it was trained on")
    check_set([*records, *choose_from])
    dt, known = choose_from[0].dt, knowledge(model, records)
    size = None if duration is None else round(duration / dt)
    cut = [r.voltage[:size] for r in choose_from]
    told = motions(model, cut, dt)
    whole = motions(model, [r.voltage for r in choose_from], dt) if size else told
    seconds = np.array([len(u) * dt for u in cut])
    places, expected, _ = _chosen(known, told, whole, seconds, len(cut), stop=False)
    used, stop = _worth(expected, known.error)
    volts, steps = np.concatenate(cut), max(float(np.abs(np.diff(u)).max()) for u in cut)
    band = 1 / (max(map(len, cut)) * dt), 0.05 / dt
    limits = Limits(min(float(volts.min()), 0.0), float(np.abs(volts).max()), steps / dt, np.inf, band, 1 / dt, 0.0)
    ranked = []
    for j, k in enumerate(places):
        purpose = f"rank {j + 1}: expected error {expected[j]:.3g} to {expected[j + 1]:.3g} %"
        clock = np.arange(len(cut[k])) * dt
        ranked.append(Planned(choose_from[k].name, "existing", purpose, clock, cut[k], 0.0, float(told.stroke[k])))
    return Plan(tuple(ranked), limits, expected, stop, (f"the first {used} are worth recording",) if stop else ())


def _worth(expected: Sequence[float], error: float) -> tuple[int, bool]:
    """How many of a ranking lower the error visibly, and whether none does."""
    v = np.square(expected) + error**2
    seen = 1 - np.sqrt(v[1:] / v[:-1]) >= _SEEN
    used = len(seen) if seen.all() else int(np.argmin(seen))
    return used, used == 0
