"""What the scripts share: the paper's numbers, records by its protocol, fits kept for reuse.

    Bench(name): sweep, train, test records ──▶ identify ──▶ fit(settings) ──▶ errors / play

Tables I and II are those of `application.demo.protocol`; what the paper shows only in a figure is None here.
"""

import json
import time
import zlib
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import jax
import numpy as np

import pitp_jax as pitp
from pitp_jax.application.demo.protocol import (
    PREDICTION_PAPER,
    SCALES,
    SEED,
    TRACKING_PAPER,
    Track,
    kind,
    measure,
    play,
    swing,
)
from pitp_jax.method.train.settings import PRESETS

ACTUATORS = ("cone100", "cone122", "cone150", "roll")
TABLE_1, TABLE_2 = PREDICTION_PAPER, TRACKING_PAPER
TOKENS = {"roll": 4, "cone100": 3, "cone122": 3, "cone150": 3}  # section III-D; read as n + 1 with n the ODE's order
RESONANCE_HZ = {"roll": 142.0, "cone100": 7.4}  # III-D; a drive at half of it meets it through u^2 (68 and 3.7 Hz)
LONG = {"cone": (2.5, 50.0), "roll": (42.0, 15.0)}  # held-out long record: frequency (Hz) and length (s)
SMOKE_S = {"cone": 2.0, "roll": 0.2}


@dataclass(frozen=True)
class Fit:
    """A trained model, the training loss per epoch (stage, total, best physics), and the seconds it took."""

    model: pitp.Model
    losses: list
    seconds: float


class Bench:
    """One virtual actuator, what the paper's protocol records of it, and models fitted to that."""

    def __init__(self, name: str, options):
        self.name, self.options, self.kind = name, options, kind(name)
        self.actuator, self.scale = pitp.plant(name), SCALES[self.kind]
        self.identify, self._fits = cache(self._identify), {}

    def _records(self, part: str):
        whole = pitp.excitation.protocol(self.kind, part)
        if part == "test":
            f, seconds = LONG[self.kind]
            drive = pitp.excitation.sine(
                f, seconds, self.actuator.rate_hz, self.scale.amplitude, whole[0].voltage.mean()
            )
            whole += (replace(whole[0], name=f"long_{f:g}Hz_{seconds:g}s", time=drive[0], voltage=drive[1]),)
        if self.options.smoke and part == "sweep":
            quick = pitp.excitation.sweep(*self.scale.quick_sweep)
            whole = (replace(whole[0], time=quick[0], voltage=quick[1]),)
        elif self.options.smoke:
            count = round(SMOKE_S[self.kind] * self.actuator.rate_hz)
            whole = tuple(replace(e, time=e.time[:count], voltage=e.voltage[:count]) for e in whole)
        return measure(self.actuator, whole)

    sweep = cached_property(lambda self: self._records("sweep")[0])
    train = cached_property(lambda self: self._records("train"))
    test = cached_property(lambda self: self._records("test"))

    def _identify(self, order: int | str = "auto"):
        """The linear model of the sweep; in smoke order 2 stands for the data's choice, which takes longer."""
        return pitp.identify([self.sweep], order=2 if order == "auto" and self.options.smoke else order)

    def fit(self, settings=PRESETS["default"], order: int | str = "auto") -> Fit:
        """Train on the sines, or take the same fit from memory or from `--cache`."""
        if self.options.smoke:
            settings = replace(settings, stages=1, epochs=1, refine_steps=0)
        what = f"{self.name}{settings}{order}{self.options.smoke}{_sources()}"
        key = f"{self.name}_{zlib.crc32(what.encode()):08x}"
        if key in self._fits:
            return self._fits[key]
        path = self.options.cache and self.options.cache / f"{key}.pitp"
        if path and path.exists():
            self._fits[key] = Fit(pitp.load(path), **json.loads(path.with_suffix(".json").read_text()))
            return self._fits[key]
        losses, began = [], time.perf_counter()
        model = pitp.train(
            self.identify(order).model, self.train, settings=settings, key=jax.random.key(SEED),
            progress=lambda p: losses.append((p.stage, float(p.loss), float(p.best))),
        ).model  # fmt: skip
        found = self._fits[key] = Fit(model, losses, round(time.perf_counter() - began, 1))
        print(f"fitted {self.name} in {found.seconds:.0f} s", flush=True)
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.with_suffix(".json").write_text(json.dumps({"losses": losses, "seconds": found.seconds}))
            pitp.save(path, model)
        return found

    def grid(self, frequency: float):
        """The training sine of Table I's amplitude nearest to a frequency (Hz)."""
        rows = [r for r in self.train if r.name.endswith(f"_{self.scale.amplitude:.0f}V")]
        return min(rows, key=lambda r: abs(float(r.name[5:8]) - frequency))

    def swing(self, frequency: float) -> tuple[float, float]:
        """Amplitude and mean (m) of a target: half the range reached at the nearest training sine, about its mean."""
        return swing(self.grid(frequency))

    def sine(self, frequency: float, seconds: float | None = None):
        """A sine target from rest: time (s) and displacement (m)."""
        seconds = SMOKE_S[self.kind] if self.options.smoke else seconds or self.scale.track_s
        rise = min(self.scale.rise_s, seconds / 2)
        return pitp.excitation.sine(frequency, seconds, self.actuator.rate_hz, *self.swing(frequency), rise=rise)

    def play(self, model, target, frequency: float = np.nan) -> Track:
        """The feedforward for a target (time, displacement), played on the noise-free plant."""
        track = play(self.actuator, model, pitp.Target(*target, source=self.name), frequency)
        for line in track.warnings:
            print(f"  {self.name}, {frequency:g} Hz: {line}")
        return track


@cache
def _sources() -> int:
    """Checksum of the package: a cached fit of other code is never used."""
    return zlib.crc32(b"".join(p.read_bytes() for p in sorted(Path(pitp.__file__).parent.rglob("*.py"))))


def errors(model, records) -> dict[str, float]:
    """e_rms (%) of a free run per record; inf where it diverged."""
    runs = zip(records, pitp.predict(model, records), strict=True)
    return {r.name: pitp.e_rms_percent(p.displacement, r.displacement, p.scored) for r, p in runs}
