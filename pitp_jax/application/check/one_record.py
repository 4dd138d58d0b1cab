"""Check one record by itself: its input, the faults of sensor and clock, its noise, and its problems.

band     frequencies between which 98 % of the input's energy about its mean lies
noise    white: 5th difference (`noise_std`);  coloured: the residual's density far above input and resonance,
P(lowest quarter of those bands) > 4 P(highest quarter), is extended to lower frequencies
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...common.units import base_unit, from_base
from ...files.recordings.outliers import mask_faults
from ...files.recordings.plausible import questions
from ...files.recordings.remarks import Remark
from ...method.numerics.noise_spectrum import band_edges, band_levels
from ...method.signal.checks import TIME_TOLERANCE
from ...method.signal.excitation_kind import kind, loudest
from ...method.signal.initial_state import in_motion, noise_std
from ...method.signal.record import Record


@dataclass(frozen=True)
class CheckedRecord:
    """Facts about one record as the check found them; None if unknown.

    Attributes:
        samples, rate_hz, missing, outliers, jitter: as read; jitter in samples.
        recognised: properties of the file as read: `file`, `time`, `input`, `output` in words, `lost`, `clipped`.
        begins: "rest", "held" or "moving".
        zero, zero_stderr, noise: in `unit`, the record's own.
        direction: 1 or -1.
        noise_colour: "white" or "coloured".
        excitation: "sweep", "sine", "steps", "broadband" or "none".
        band_hz: of the input.
        repaired: corrections that need no action.
        problems: one sentence each.
    """

    samples: int | None = None
    rate_hz: float | None = None
    recognised: Mapping[str, Any] = field(default_factory=dict)
    begins: str | None = None
    zero: float | None = None
    zero_stderr: float | None = None
    unit: str | None = None
    direction: int | None = None
    noise: float | None = None
    noise_colour: str | None = None
    missing: int | None = None
    outliers: int | None = None
    jitter: float | None = None
    excitation: str | None = None
    band_hz: tuple[float, float] | None = None
    repaired: tuple[Remark, ...] = ()
    problems: tuple[str, ...] = ()

    def as_json(self) -> dict:
        """Return the record's entry in the JSON of `pitp check` (docs/contract.md)."""
        plain = {k: v for k, v in vars(self).items() if k not in ("zero", "zero_stderr", "unit", "repaired")}
        zero = {"value": self.zero, "stderr": self.zero_stderr, "unit": self.unit}
        problems = [*map(str, self.repaired), *self.problems]
        return plain | {"zero": zero, "recognised": dict(self.recognised), "problems": problems}


def masked(record: Record) -> Record:
    """Mask and count sensor faults as the reader does; the record is unchanged if there are none."""
    faults, seen = mask_faults(record.displacement, record.voltage), record.recognised
    if not (faults.outliers or faults.clipped):
        return record
    counts = {key: int(seen.get(key, 0)) + getattr(faults, key) for key in ("outliers", "clipped")}
    return replace(record, displacement=faults.displacement, recognised={**seen, **counts})


def facts(record: Record) -> CheckedRecord:
    """Return input, faults, noise and problems of one record whose sensor faults are masked: what needs no model."""
    seen, unit = record.recognised, record.displacement_unit
    outliers, clipped, lost = (int(seen.get(key, 0)) for key in ("outliers", "clipped", "lost"))
    jitter = float(seen.get("jitter", _jitter(record)))
    band = drive_band(record)
    noise = noise_std(record.displacement)
    values = {"outliers": outliers, "lost": lost, "jitter": jitter if jitter > TIME_TOLERANCE else 0}
    problems = []
    if outliers > 0.01 * record.samples:  # more than a few spikes
        problems.append(f"{Remark('outliers', record.name, outliers)}: check the sensor")
    if clipped:
        problems.append(f"{Remark('clipped', record.name, clipped)}: move the sensor or widen its range")
    problems += questions(record.voltage, record.displacement, base_unit(unit)) + drive_problems(record, noise, band)
    return CheckedRecord(
        samples=record.samples, rate_hz=1 / record.dt,
        recognised={key: seen[key] for key in ("file", "time", "input", "output", "lost", "clipped") if key in seen},
        unit=unit,
        noise=float(from_base(noise, unit)), missing=record.missing, outliers=outliers, jitter=jitter,
        excitation=kind(record) if band else "none", band_hz=band,
        repaired=tuple(Remark(what, record.name, value) for what, value in values.items() if value),
        problems=tuple(problems),
    )  # fmt: skip


def drive_problems(record: Record, noise: float, band: tuple[float, float] | None) -> list[str]:
    """Return problems that the reader does not report: missing samples, no excitation, no motion, coarse sampling."""
    problems = []
    if record.missing > 0.05 * record.samples:
        problems.append(f"{100 * record.missing / record.samples:.0f} % of its output is missing")
    if band is None:
        problems.append("its input never changes, so it shows only noise and drift; leave it out")
    elif not moves(record):
        spread = from_base(noise, record.displacement_unit)
        problems.append(
            f"shows no motion beyond its noise of {spread:.2g} {record.displacement_unit}; check sensor and amplifier"
        )
    fewest = 8  # samples per period of the fastest input: with fewer, the motion between samples matters
    # steps have no highest frequency: their band ends where their edges are sampled
    if band and (per := 1 / (band[1] * record.dt)) < fewest and kind(record) != "steps":
        least = fewest * band[1]
        problems.append(
            f"has only {per:.1f} samples in a period of its fastest input; sample at {least:.3g} Hz or more"
        )
    return problems


def quick_problems(records: Sequence[Record]) -> list[str]:
    """Return problems of records that show without a fit, one line each, for commands that fit anyway."""
    lines, reach = [], []
    for r in records:
        lines += [f"{r.name}: {line}" for line in drive_problems(r, noise_std(r.displacement), drive_band(r))]
        reach.append(float(np.nanstd(r.displacement)) / max(float(r.voltage.std()), 1e-300))
    # the median, so that one record in other units does not change the usual value; a resonance and its roll-off change
    # one actuator's range by less than a factor of 300
    usual = float(np.median(reach))
    for r, x in zip(records, reach, strict=True):
        if usual > 0 and x > 0 and abs(np.log(x / usual)) > np.log(300):
            lines.append(f"{r.name}: moves {x / usual:.2g} times as far per volt as most others; check its unit")
    return lines


def moves(record: Record) -> bool:
    """Return whether the output of a record moves beyond the sensor noise."""
    try:
        return not in_motion([record])[1]
    except ValueError:
        return False


def drive_band(record: Record) -> tuple[float, float] | None:
    """Return the lowest and highest frequency (Hz) of the input, with 98 % of its energy between; equal for a sine.

    None if the input never changes.
    """
    if not np.ptp(record.voltage) > 0:
        return None
    if kind(record) == "sine":
        line = loudest(record)
        return line, line
    # from line 1 on: the mean is not excitation
    total = np.cumsum(np.abs(np.fft.rfft(record.voltage - record.voltage.mean()))[1:] ** 2)
    # 1 % of the energy lies below the band, and 1 % above it
    low, high = (int(np.searchsorted(total, share * total[-1])) + 1 for share in (0.01, 0.99))
    return low / (record.samples * record.dt), high / (record.samples * record.dt)


def coloured_noise(residual: np.ndarray, seen: np.ndarray, dt: float, top: float, resonance: float) -> float | None:
    """Return the standard deviation of coloured noise in a model's residual; None if it is white or unknown.

    Args:
        residual: shape (T,), 0 where not `seen`.
        seen: True where the output was measured, shape (T,).
        dt: sampling interval, s.
        top: highest frequency of the force, Hz.
        resonance: of the actuator, Hz.
    """
    edges = band_edges(int(0.6 * len(residual)), dt)
    levels = band_levels(residual, seen, dt, edges)
    # so far above input and resonance the actuator does not respond, so the residual there is noise
    own = edges[:-1] > max(4 * top, 6 * resonance)
    quarter = int(own.sum()) // 4
    # fewer bands than 8 cannot tell a slope from scatter
    if own.sum() < 8 or not levels[own][-quarter:].any():
        return None
    # white noise is level over these bands
    low, high = levels[own][:quarter].mean(), levels[own][-quarter:].mean()
    if low < 4 * high:
        return None
    return float(np.sqrt(levels[own] @ np.diff(edges)[own] + low * edges[:-1][own][0]))


def _jitter(record: Record) -> float:
    off = (record.time - record.time[0]) / record.dt - np.arange(record.samples)
    return float(np.abs(off).max())
