"""Plan the first recordings of an actuator from the limits of the rig alone.

    growth   sweeps of the whole band at 25, 50, 71, 100 % of the highest voltage: 1/16, 1/4, 1/2 and all of the force,
             smaller at frequencies at which the slew allows less
    sweep    the whole band once, slowly, to identify a linear model
    set      inputs through the points of a space-filling set over frequency, lowest and highest voltage; small first
    repeat   its first recording again, to measure noise and drift

No later recording exceeds the highest voltage or slew of the growth. A recording may follow if its predicted largest
stroke stays below the limit. The prediction is the largest stroke so far times the greatest possible increase
(`growth`: the square of the voltage, and the gain at a resonance of damping 0.01).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...common.errors import BadInput
from ...common.numbers import short
from .drives import Planned, space_filling, through, within
from .limits import Limits
from .strokes import growth
from .waveforms import smooth_step, sweep

_GROWTH = (0.25, 0.5, 0.71, 1.0)  # of the highest voltage: its square grows 4, 2 and 2 times
_PARTS = {"growth": 0.1, "sweep": 0.25}  # of the duration; the set and its repeat have the remainder
FEWEST = 8  # recordings of a set if the duration allows: fewer train a smaller encoder
POINTS = 3  # that a recording passes through


def default_duration(limits: Limits, fresh: bool) -> float:
    """Return the default duration of all planned inputs together, s."""
    filling = FEWEST * max(limits.shortest, 4.0 / limits.band[0])  # four periods of the lowest frequency
    if not fresh:
        return filling
    return max(filling * (1 + 1 / FEWEST) / (1 - sum(_PARTS.values())), _least(limits))


def _least(limits: Limits) -> float:
    """Return the shortest first session, s: two periods of the lowest frequency in the sweep, and all ramps."""
    return max(limits.shortest / _PARTS["sweep"], 2 * limits.ramp(limits.high) * len(_GROWTH) / _PARTS["growth"])


def first_session(limits: Limits, duration: float, seed: int) -> tuple[Planned, ...]:
    """Plan all recordings of a first session, in the order in which they are played.

    Raises:
        BadInput: a duration that is too short for them.
    """
    part = {name: part * duration for name, part in _PARTS.items()}
    one, swept = part["growth"] / len(_GROWTH), part["sweep"]
    if duration < _least(limits) * (1 - 1e-9):
        raise BadInput(
            f"--duration {duration:g} s is too short for a first session down to {limits.band[0]:g} Hz; give at least "
            f"{_least(limits):.3g} s, or a band that starts at a higher frequency"
        )
    grown = _growth(one, limits)
    raised = max(float(np.abs(r.voltage).max()) for r in grown), max(r.slew for r in grown)
    limits = replace(limits, high=min(limits.high, raised[0]), slew=min(limits.slew, raised[1]))
    purpose = "for the linear model: resonance, damping, order"
    whole = Planned("sweep", "sweep", purpose, *_swept(1.0, swept, limits), limits.rest)
    filling = space_filling_set(limits, duration - sum(part.values()), seed, repeats=1)
    again = [replace(r, purpose=f"the same as {r.name}: shows noise and drift") for r in filling[:1]]
    return (*grown, whole, *filling, *again)


def _growth(seconds: float, limits: Limits) -> list[Planned]:
    """Plan sweeps of growing voltage; a sweep that raises the voltage by less than a tenth is left out."""
    grown, reached = [], 0.0
    for level in _GROWTH:
        time, voltage = _swept(level, seconds, limits)
        top = float(np.abs(voltage).max())
        if top > 1.1 * reached:  # the slew may allow no more than the sweep before
            part = f"{100 * top / limits.high:.0f} % of the {limits.units.input_word}"
            text = f"shows whether the actuator bears {part}: check the stroke before the next one"
            name = f"growth_{100 * top / limits.high:.0f}"
            grown.append(Planned(name, "sweep", text, time, voltage, limits.rest))
            reached = top
    return grown


def _swept(level: float, seconds: float, limits: Limits):
    """Return time (s) and voltage (V) of a sweep of the band between zero and a fraction of the highest voltage."""
    top = level * limits.high / 2
    time, wave = sweep(*limits.band, seconds, limits.rate, top, 0.0)
    first, last = limits.band
    hz = first + (last - first) * time / seconds
    # the slew limits only the fast end of the band; the slow end uses the whole voltage. The envelope takes 15 % of it.
    swing = np.minimum(1.0, 0.85 * limits.slew / (2 * np.pi * hz * top))
    # the swing ends before the mean ramps down; otherwise both slews would add
    ramp = min(limits.ramp(2 * top), seconds / 8)
    swing *= smooth_step((seconds - ramp - time) / (4 * ramp))
    return time, within(top, swing * wave, limits)


def space_filling_set(limits: Limits, duration: float, seed: int, repeats: int = 0) -> tuple[Planned, ...]:
    """Plan inputs that fill frequency, lowest and highest voltage evenly, those of the smallest peak first.

    They leave as much of the duration as `repeats` further recordings of their length take.

    Raises:
        BadInput: a duration shorter than one input.
    """
    # 1e-9: rounding must not cost a recording
    count = min(FEWEST, int(duration / limits.shortest * (1 + 1e-9)) - repeats)
    if count < 1:
        raise BadInput(
            f"--duration {duration:g} s is too short; two periods of {limits.band[0]:g} Hz and the ramps take "
            f"{limits.shortest:.3g} s"
        )
    points = space_filling(count * POINTS, limits, seed)
    # Every count-th point: neighbours in a Sobol sequence are far apart, so that each recording gets a mixture.
    drives = [drive(points[k::count], duration / (count + repeats), limits) for k in range(count)]
    return tuple(sorted(drives, key=lambda d: float(np.abs(d.voltage).max())))


def drive(points: np.ndarray, seconds: float, limits: Limits) -> Planned:
    """Plan a sine through points of (frequency, lowest, highest voltage), named by its first frequency and peak."""
    voltage = through(points, seconds, limits)
    time = np.arange(len(voltage)) / limits.rate
    hz, shown = points[:, 0], limits.units.input
    top = float(shown.shown(np.abs(voltage).max()))
    size = short(top, 3)
    spread = f", then {hz.min():.3g} to {hz.max():.3g} Hz" if len(points) > 1 else ""
    what = f"motion at {hz[0]:.3g} Hz at first{spread}, up to {size} {shown.unit}"
    text = f"{what}: one of a set that covers frequency, amplitude and bias"
    unit = shown.unit.replace(" ", "").replace("/", "_per_")
    return Planned(f"sine_{hz[0]:.3g}Hz_{size}{unit}", "sine", text, time, voltage, limits.rest)


def in_order(recordings: Sequence[Planned], limits: Limits, *, alternate: bool, recorded: float) -> tuple[Planned, ...]:
    """Number the recordings, set the stroke up to which each may follow, and negate every second one if `alternate`.

    `recorded`: the largest stroke of the earlier recordings, m.
    """
    bounds = np.full(len(recordings), np.inf)
    if np.isfinite(limits.farthest):
        bounds[1:] = limits.farthest / np.maximum(_farther(recordings, limits, recorded)[1:], 1.0)
    ordered = []
    for k, r in enumerate(recordings):
        voltage = -r.voltage if alternate and k % 2 else r.voltage
        ordered.append(replace(r, name=f"{k + 1:02d}_{r.name}", voltage=voltage, go_on=float(bounds[k])))
    return tuple(ordered)


def _farther(recordings: Sequence[Planned], limits: Limits, recorded: float) -> np.ndarray:
    """Return the largest ratio of each recording's stroke to the strokes before it, shape (recordings,).

    A model predicts both strokes, the next one with half its damping. Without a model any resonance of the band counts.
    """
    own = np.array([r.stroke for r in recordings])
    if not np.isfinite(own).all():
        return growth([r.voltage for r in recordings], 1 / limits.rate, limits.band)
    before = np.maximum.accumulate(np.append(max(recorded, 1e-30), own))[:-1]
    return np.array([r.stroke_half_damped for r in recordings]) / before
