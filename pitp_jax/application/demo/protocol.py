"""Run the paper's experiments on a virtual actuator, for the tables and figures of `pitp demo`.

    sweep ──▶ identify ──▶ nominal ─┐
    sines ──────────────────────────┴▶ train ──▶ model ─┬▶ predict in-sample and held-out records  (Table I)
                                                        └▶ voltage for sines ──▶ plant ──▶ error   (Table II)

The paper's figures come from its own four actuators; they show the order of magnitude and are no benchmark. Every cell
of its Table I lies on the training grid, so held-out records have their own table.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from ...common.metrics import e_rms_percent
from ...common.page import Table
from ...method.identify.identification import Identification, identify
from ...method.invert.feedforward_plan import feedforward
from ...method.signal.record import Record
from ...method.signal.target import Target
from ...method.simulate.prediction import Prediction, predicted_pairs
from ...method.train.settings import PRESETS
from ...method.train.training import Progress, Training, train
from ..plan.excitation import Excitation, protocol, sine, sweep
from ..plant.physics import Plant
from ..plant.virtual_actuator import plant as virtual_actuator
from ..plant.virtual_actuator import record, simulate

SEED = 20  # of the sensor noise and of the training, so that the demo can be repeated
PREDICTION_PAPER = {  # Table I: e_rms / % at f / Hz
    "roll": {10: 5.35, 20: 1.62, 50: 1.52, 70: 5.36, 100: 3.14, 130: 8.76},
    "cone100": {1: 1.63, 2: 2.29, 4: 1.11, 6: 1.12, 8: 0.83, 10: 1.19},
    "cone122": {1: 2.45, 2: 3.54, 4: 6.59, 6: 0.96, 8: 0.98, 10: 1.28},
    "cone150": {1: 4.61, 2: 5.14, 4: 6.35, 6: 0.93, 8: 1.35, 10: 0.66},
}
TRACKING_PAPER = {  # Table II
    "roll": {10: 4.70, 30: 4.24, 90: 8.35, 130: 8.55},
    "cone100": {1: 6.48, 4: 8.19, 7: 9.89, 10: 11.38},
    "cone122": {1: 6.56, 4: 2.89, 7: 9.33, 10: 5.75},
    "cone150": {1: 4.61, 4: 6.20, 7: 18.45, 10: 12.18},
}


@dataclass(frozen=True)
class Scale:
    """Settings of a demo that depend on the kind of actuator and on `--quick`.

    Attributes:
        amplitude: A3 of the sines in Table I, V (1-5 kV for the cone, 200-1200 V for the roll).
        track_s, rise_s: length of a tracked sine and of the smooth start of it, s.
        quick_sweep: the short sweep: f_start, f_end, duration, rate, amplitude, offset.
        quick_hz: input frequencies used for training, Hz.
        quick_s: seconds kept of every other record.
    """

    amplitude: float
    track_s: float
    rise_s: float
    quick_sweep: tuple[float, float, float, float, float, float]
    quick_hz: tuple[float, ...]
    quick_s: float


SCALES = {
    "cone": Scale(2000.0, 5.0, 1.0, (0.01, 20.0, 30.0, 1e3, 3e3, 3e3), (1, 2, 4, 6, 7, 8, 10), 4.0),
    "roll": Scale(500.0, 0.5, 0.1, (0.01, 180.0, 5.0, 5e3, 700.0, 700.0), (10, 20, 30, 50, 70, 90, 100, 130), 0.5),
}


@dataclass(frozen=True)
class Track:
    """A wanted motion, the motion achieved, the voltage played, and the warnings of the inversion."""

    frequency: float
    time: np.ndarray
    target: np.ndarray
    achieved: np.ndarray
    voltage: np.ndarray
    self_check: float
    warnings: tuple[str, ...]

    @property
    def e_rms(self) -> float:
        """Return the rms tracking error, % of the target's range."""
        return e_rms_percent(self.achieved, self.target)


@dataclass(frozen=True)
class Demo:
    """All results of a demo; `predicted`, `linear`: simulations by the trained and the linear model, by record name."""

    name: str
    sweep: Record
    train: tuple[Record, ...]
    test: tuple[Record, ...]
    identified: Identification
    training: Training
    predicted: dict[str, Prediction]
    linear: dict[str, Prediction]
    tracks: tuple[Track, ...]


def run(
    name: str,
    *,
    quick: bool = False,
    say: Callable[[str], None] = lambda line: None,
    progress: Callable[[Progress], None] = lambda step: None,
) -> Demo:
    """Run the whole demo for one virtual actuator: record, identify, train, predict, track.

    Args:
        name: `cone100`, `cone122`, `cone150` or `roll`.
        quick: fewer and shorter records, less training.
        say: called with one line per stage.
        progress: called with the progress of training.

    Raises:
        ComputationFailed: identification or training failed.
    """
    actuator = virtual_actuator(name)
    drives = {part: excitations(name, part, quick) for part in ("sweep", "train", "test")}
    say(f"measuring {sum(map(len, drives.values()))} recordings on the virtual actuator {name}")
    (swept,), sines, test = (measure(actuator, drives[part]) for part in ("sweep", "train", "test"))
    say("identifying on the sweep")
    identified = identify([swept], progress=say)
    say(f"order {identified.model.order}; training on {len(sines)} sines")
    settings = replace(PRESETS["default"], **QUICK_TRAINING) if quick else None
    trained = train(identified.model, sines, settings=settings, key=jax.random.key(SEED), progress=progress)
    if trained.interrupted:  # a half-trained model beside the paper's figures would mislead
        raise KeyboardInterrupt
    say(f"predicting {len(sines)} in-sample and {len(test)} held-out recordings")
    # every record once with both models, so that tables and figures use the same runs
    predicted = {r.name: p for part in (sines, test) for r, p in predicted_pairs(trained.model, part)}
    linear = {r.name: p for part in (sines, test, (swept,)) for r, p in predicted_pairs(identified.model, part)}
    say("tracking sines")
    tracks = tuple(track(actuator, trained.model, f, sines) for f in TRACKING_PAPER[name])
    return Demo(name, swept, sines, test, identified, trained, predicted, linear, tracks)


QUICK_TRAINING = {"epochs": 6, "stages": 3, "refine_steps": 15}  # without the accuracy of the preset


def kind(name: str) -> str:
    """Return the kind of a virtual actuator: `cone` or `roll`."""
    return "roll" if name == "roll" else "cone"


def excitations(name: str, part: str, quick: bool) -> tuple[Excitation, ...]:
    """Return the input voltages of one part of the paper's protocol; fewer and shorter ones for `quick`."""
    scale = SCALES[kind(name)]
    whole = protocol(kind(name), part)
    if not quick:
        return whole
    if part == "sweep":
        return (Excitation("sweep", *sweep(*scale.quick_sweep)),)
    if part == "train":
        starts = tuple(f"sine_{f:03.0f}Hz_" for f in scale.quick_hz)
        whole = tuple(e for e in whole if e.name.startswith(starts))
    keep = [e.time < scale.quick_s - 1e-9 for e in whole]  # a sample at the end itself may round to either side
    return tuple(Excitation(e.name, e.time[k], e.voltage[k]) for e, k in zip(whole, keep, strict=True))


def measure(actuator: Plant, drives: Sequence[Excitation]) -> tuple[Record, ...]:
    """Simulate noisy recordings of a virtual actuator, one per input voltage."""
    return tuple(record(actuator, e.name, e.time, e.voltage, seed=SEED) for e in drives)


def nearest(records: Sequence[Record], name: str, frequency: float) -> Record:
    """Return the training sine of this frequency (Hz) with the amplitude of the paper's Table I."""
    wanted = f"sine_{frequency:03.0f}Hz_{SCALES[kind(name)].amplitude:.0f}V"
    return next(r for r in records if r.name == wanted)


def track(actuator: Plant, model, frequency: float, train: Sequence[Record]) -> Track:
    """Track a sine of half the reachable range: invert it with the model, and simulate the plant under that voltage."""
    scale = SCALES[kind(actuator.name)]
    amplitude, mean = swing(nearest(train, actuator.name, frequency))
    time, wanted = sine(frequency, scale.track_s, actuator.rate_hz, amplitude, mean, rise=scale.rise_s)
    return play(actuator, model, Target(time, wanted, source=f"sine at {frequency:g} Hz"), frequency)


def swing(training: Record) -> tuple[float, float]:
    """Return amplitude and mean (m) of a sine to track: half the range that a training sine reaches."""
    # half of the range reached, because a target at the edge would need voltages outside the training
    settled = training.displacement[training.samples // 2 :]
    return 0.25 * float(np.ptp(settled)), float(settled.mean())  # amplitude: a quarter of peak to peak


def play(actuator: Plant, model, target: Target, frequency: float = np.nan) -> Track:
    """Compute the voltage for a target with the model, and simulate the noise-free plant under it."""
    plan = feedforward(model, target)
    clock = np.arange(len(plan.time)) / actuator.rate_hz  # the feedforward may start before the target's time 0
    # the plant has no band-limited amplifier; such dense samples are joined by lines
    x = simulate(actuator, clock, plan.voltage, hold="zoh" if model.hold == "zoh" else "foh")
    asked = np.asarray(plan.target)
    return Track(
        frequency, target.time, target.displacement, x[asked], plan.voltage[asked],
        plan.self_check_e_rms_percent, plan.warnings,
    )  # fmt: skip


def _errors(demo: Demo, record: Record) -> tuple[float, ...]:
    """Return the rms errors of the trained and the linear model on a record, and its sensor noise, % of range."""
    runs = demo.predicted[record.name], demo.linear[record.name]
    noise = 100 * virtual_actuator(demo.name).noise_std / float(np.ptp(record.displacement))
    return *(e_rms_percent(p.displacement, record.displacement, p.scored) for p in runs), noise


def tables(demo: Demo) -> tuple[Table, ...]:
    """Return Tables I (in-sample) and II (tracking) beside the paper's values, and a table of held-out records."""
    amplitude = SCALES[kind(demo.name)].amplitude
    in_sample = [
        (f"{f:g}", paper, *_errors(demo, nearest(demo.train, demo.name, f)))
        for f, paper in PREDICTION_PAPER[demo.name].items()
    ]
    held_out = [(r.name, *_errors(demo, r)) for r in demo.test]  # the paper has no such records
    _, *errors = zip(*held_out, strict=True)
    held_out.append(("median", *(float(np.median(column)) for column in errors)))
    paper = TRACKING_PAPER[demo.name]
    tracking = [(f"{t.frequency:g}", paper[int(t.frequency)], t.e_rms, t.self_check) for t in demo.tracks]
    columns = ("this model (%)", "linear model (%)", "sensor noise (%)")
    return (
        Table(
            ("f (Hz)", "paper (%)", *columns),
            in_sample,
            f"Table I, prediction, in-sample: e_rms, {demo.name}, A3 = {amplitude:g} V",
        ),
        Table(("record", *columns), held_out, f"Prediction, held out (no such record in training): e_rms, {demo.name}"),
        Table(
            ("f (Hz)", "paper (%)", columns[0], "self-check (%)"),
            tracking,
            f"Table II, tracking on the virtual actuator: e_rms, {demo.name}, half the reachable range",
        ),
    )
