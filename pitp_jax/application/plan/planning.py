"""Plan which recordings to take, with or without a model.

no model               first_session: growth, sweep, space-filling set, repeats
an identified model    space_filling_set within its limits and the stroke allowed
a trained model        `next_recordings`: those that lower its expected held-out error most, until none helps
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput
from ...common.numbers import rounded_up
from ...common.quantity import Units
from ...common.shown import Shown
from ...method.model.encoder import ConstantEncoder
from ...method.model.fitted import Fitted, fitted_of
from ...method.model.model import Model
from ...method.model.units import units_of
from ...method.signal.excited import unexcited
from ...method.signal.record import Record
from ...method.signal.sets import check_set
from .drives import Planned
from .first_session import FEWEST, POINTS, default_duration, drive, first_session, in_order, space_filling_set
from .limits import Limits
from .next_recordings import bearable, following
from .rests import first_rest, rest_after

REACHED = (
    "If the largest stroke so far is above the limit of a recording, leave that recording out and try the next. When "
    "none is left, identify a model on the recordings made so far and plan with it: it predicts the stroke of every "
    "input and proposes those within the limit."
)


@dataclass(frozen=True, repr=False)
class Plan(Shown):
    """The recordings to take next, and the error expected after them.

    Attributes:
        recordings: to take, in this order; each holds its input (V) over time (s).
        limits: of all recordings: input (V), its slew (V/s), displacement (m), band and rate (Hz), rest (s).
        expected: error on inputs not recorded yet, % of range, without noise, shape (k + 1,): now, and after each of
            the k recordings chosen for it. A recording of untrained frequencies comes before these and does not count.
            Empty without a trained model.
        stop: True if no recording would lower the measured error by 1 % or more.
        notes: one sentence for each input that was left out, with the reason.
    """

    recordings: tuple[Planned, ...]
    limits: Limits
    expected: tuple[float, ...] = ()
    stop: bool = False
    notes: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Return the duration of all planned inputs, s, without the pauses."""
        return sum(r.seconds for r in self.recordings)

    def _rows(self) -> list[dict]:
        return self.as_json()["recordings"]

    def as_json(self) -> dict:
        """Return the plan as a dict for JSON; unknown values are null."""
        low, high = self.limits.low, self.limits.high
        return {
            "limits": {"voltage": [low, high], "slew": self.limits.slew, "displacement_m": self.limits.farthest,
                       "band_hz": list(self.limits.band), "rate_hz": self.limits.rate, "rest_s": self.limits.rest},
            "stop": self.stop,
            "expected_error_percent": list(self.expected),
            "recordings": [
                {"name": r.name, "kind": r.kind, "purpose": r.purpose, "seconds": r.seconds, "rest_s": r.rest,
                 "max_voltage": float(np.abs(r.voltage).max()), "max_slew": r.slew, "stroke_m": r.stroke,
                 "stroke_half_damped_m": r.stroke_half_damped,
                 "only_if_stroke_below_m": r.go_on}
                for r in self.recordings
            ],
            "notes": list(self.notes),
        }  # fmt: skip


def plan(
    model: Model | Fitted | None = None,
    records: Sequence[Record] = (),
    *,
    max_voltage: float | None = None,
    max_slew: float | None = None,
    max_displacement: float | None = None,
    band: tuple[float, float] | None = None,
    duration: float | None = None,
    rest: float | None = None,
    rate: float | None = None,
    alternate: bool = False,
    seed: int = 0,
    units: Units | None = None,
) -> Plan:
    """Plan which recordings to take next, with or without a model.

    Args:
        model: identified or trained; None for a first session.
        records: taken so far, on which the model was trained.
        max_voltage: V; default the largest of the training records.
        max_slew: V/s; default the largest of the training records, otherwise that of the band at this voltage.
        max_displacement: m from the position at 0 V in both directions.
        band: lowest and highest input frequency in Hz; default 0.05 to 1.3 times the model's resonance.
        duration: seconds of all recordings together, without rests.
        rest: seconds at 0 V between recordings; default until the model is within 0.5 % of its stroke again, or,
            without a model, for a damping of 0.05.
        rate: samples per second; default the model's, otherwise a hundred per period of the highest frequency.
        alternate: play every second recording with negative voltage (a bipolar amplifier).
        seed: of the space-filling points.
        units: of input and output in files and texts; default the model's, otherwise V and m.

    Raises:
        BadInput: limits that are missing or cannot be met.

    Returns:
        the recordings in the order of playing, each with its voltage and purpose.

    Examples:
        >>> session = pitp.plan(max_voltage=3000.0, band=(0.5, 5.0), duration=60.0)
        >>> max(float(np.abs(r.voltage).max()) for r in session.recordings) <= 3000.0
        True
    """
    fitted, usual = None, Units()
    if model is not None:
        fitted = fitted_of(model)
        model, usual = fitted.model, units_of(fitted)
    if records:
        check_set(records)
    limits = _limits(model, max_voltage, max_slew, max_displacement, band, rest, rate, units or usual)
    length = duration or default_duration(limits, fresh=model is None)
    if model is None or fitted is None:
        return _played(first_session(limits, length, seed), limits, alternate)
    recorded = max(map(_stroke, records), default=0.0)
    first, length, notes = _missing(fitted, limits, length)
    if first and (length < limits.shortest or (trained(model) and not records)):
        return _played(first, limits, alternate, recorded, notes=notes)
    if not trained(model):  # a linear model predicts strokes, but not its own errors
        filling, more = bearable(model, space_filling_set(limits, length, seed), limits)
        return _played([*first, *filling], limits, alternate, recorded, notes=notes + more)
    if not records:
        raise BadInput("planning for a trained model needs the recordings it was trained on; give them too")
    chosen = following(model, records, limits, length, seed)
    if 0 < chosen.worth < len(chosen.recordings):
        notes += ("after these, another recording would not lower the error noticeably",)
    taken, expected = chosen.recordings[: chosen.worth], chosen.expected[: chosen.worth + 1]
    taken, stop = [*first, *taken], not taken and not first
    return _played(taken, limits, alternate, recorded, expected=expected, stop=stop, notes=chosen.notes + notes)


def _missing(fitted: Fitted, limits: Limits, length: float) -> tuple[list[Planned], float, tuple[str, ...]]:
    """Plan a recording of frequencies that the model was not trained at; return it, the remaining seconds, notes."""
    swing, resonance = (limits.high - limits.low) / 2, fitted.model.natural_frequency / (2 * np.pi)
    band = unexcited(
        fitted.origin.excited_input, limits.band, lambda hz: min(swing, limits.slew / (2 * np.pi * hz)), resonance
    )
    if band is None:
        return [], length, ()
    seconds = min(max(limits.shortest, length / FEWEST), length)
    points = [[hz, limits.low, limits.high] for hz in np.geomspace(*band, POINTS)]
    purpose = f"{band[0]:.3g} to {band[1]:.3g} Hz, where the model was not trained at this amplitude"
    wanted = replace(drive(np.array(points), seconds, limits), purpose=purpose)
    try:
        first, _ = bearable(fitted.model, [wanted], limits)
    except BadInput:
        return [], length, (f"left out: {purpose}; its predicted stroke exceeds the limit",)
    return first, length - seconds, ()


def _stroke(record: Record) -> float:
    """Return the largest distance of a record's output from its first reading, m."""
    read = record.displacement[record.observed]
    return float(np.abs(read - read[0]).max())


def _played(drives: Sequence[Planned], limits: Limits, alternate: bool, recorded: float = 0.0, **remarks) -> Plan:
    """Number the recordings; negate every second voltage if `alternate` and the model squares its input."""
    # From 0 V up the input is squared; otherwise a negated voltage is a different input.
    alternate = alternate and limits.low == 0
    kept = replace(limits, low=-limits.high) if alternate else limits
    remarks["notes"] = (*remarks.get("notes", ()), *_of_length(drives, limits))
    return Plan(in_order(drives, limits, alternate=alternate, recorded=recorded), kept, **remarks)


def _of_length(drives: Sequence[Planned], limits: Limits) -> tuple[str, ...]:
    """Return a note if recordings are long because of the slew limit; otherwise nothing."""
    low, high = limits.band
    # duration of a swing between the limits and back at the largest slew
    stretched = 2 * (limits.high - limits.low) / limits.slew
    # a recording of a minute, or of one period of the lowest frequency, is not long
    long = [d for d in drives if d.seconds > max(60.0, 1 / low)]
    if not long or stretched < 1 / high:
        return ()
    longest, units = max(d.seconds for d in long), limits.units
    return (
        f"{len(long)} of {len(drives)} recordings last up to {longest:.0f} s: at {units.input.rate_text(limits.slew)} "
        f"a swing of the whole range takes {stretched:.3g} s. To shorten them, raise {units.max_rate} or lower "
        f"{units.max_input}",
    )


def trained(model: Model) -> bool:
    """Return whether a model has a network that computes its coefficients, which more records can improve."""
    return not isinstance(model.encoder, ConstantEncoder)


def _limits(model, max_voltage, max_slew, max_displacement, band, rest, rate, units: Units) -> Limits:
    """Return the limits that the user states, completed by those of the model.

    Raises:
        BadInput: one is missing.
    """
    if model is None:
        missing = [name for name, value in ((units.max_input, max_voltage), ("--band", band)) if value is None]
        if missing:
            raise BadInput(
                f"a first session needs {' and '.join(missing)}; give the limits of the amplifier and the membrane"
            )
        low, high, steepest = 0.0, max_voltage, np.inf
        rate, pause = rate or rounded_up(100 * band[1]), lambda: first_rest(band)
    else:
        (low, high), steepest = model.domain.voltage_range, model.domain.slew
        # behind a square a negative voltage gives the same force as a positive one
        low, high = (0.0, max(high, -low)) if model.input_map.one_sided else (min(low, 0.0), high)
        if max_voltage is not None:
            high, low = max_voltage, max(low, -max_voltage)
        rate, hz = float(rate or 1 / model.dt), model.natural_frequency / (2 * np.pi)
        band, pause = band or (0.05 * hz, min(1.3 * hz, rate / 20)), lambda: rest_after(model, float(high), rate)
    if max_slew is None:
        # the slew of a sine over the whole range at the highest frequency, the steepest input planned
        max_slew = steepest if np.isfinite(steepest) else np.pi * band[1] * (high - low)
    farthest = np.inf if max_displacement is None else max_displacement
    rest = pause() if rest is None else rest
    return Limits(
        low, high, float(max_slew), farthest, (float(band[0]), float(band[1])), float(rate), float(rest), units
    )
