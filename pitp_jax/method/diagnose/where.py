"""Locate the nominal model's error: by record, frequency, time, displacement, velocity and voltage.

    output     fraction of  sum w (e^2 - sigma^2)  by record, frequency of the residual, harmonic of the input, and time
    force      r = F - a_0 x - a_1 x' - a_2 x''  (what the equation lacks), by displacement, velocity, voltage,
               and by cells of the input's local frequency x the local amplitude of the motion

All of it is computed on the thinned records.

A cell is flagged if its missing force exceeds the noise there and is not leakage of the filter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...common.numbers import percent, shown_unit
from ...common.units import from_base
from ..model.fitted import fitted_of
from ..signal.excitation_kind import kind, spectrum
from ..signal.preprocess import preprocess
from ..signal.record import Record
from .data import Case
from .library import CORE, INDEX, Scale
from .steady_tone import steady_tone

AMPLITUDE_EDGES = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.01])  # of the largest displacement
BAND_EDGES = np.array([0.0, 0.15, 0.35, 0.7, 1.4, 2.8, 6.0])  # of the nominal's natural frequency
_BINS = 10  # intervals of an axis of the tables
_PERIODS = 4  # of a tone in the longest record, at least; a random walk of 6 % of range had one
_FLAG = 0.15  # a flagged cell's missing force, rms, relative to that of the largest cell


@dataclass(frozen=True)
class Motion:
    """A thinned record with derivatives and missing force along its measured motion.

    Attributes:
        record: thinned, in V and scaled displacement.
        weight: 1e4 / (samples range^2) where the output counts, otherwise 0.
        states: scaled x, x', x'' (per s), shape (T, 3).
        force: scaled r, shape (T,).
        noise, span: of the output, scaled.
    """

    record: Record
    weight: np.ndarray
    states: np.ndarray
    force: np.ndarray
    noise: float
    span: float


class Seen(NamedTuple):
    """The records along their measured motion, and the units of the tables' axes."""

    motions: tuple[Motion, ...]
    omega: float
    reach: float
    length: float
    unit: str

    @property
    def dt(self) -> float:
        """Return the time between thinned samples, s."""
        return self.motions[0].record.dt


def motions(case: Case, scale: Scale) -> Seen:
    """Compute the derivatives and the missing force along the measured motion of every record."""
    along, dt = [], case.dt
    a = [case.nominal[INDEX[k]] for k in CORE]
    omega = 1 / scale.tau
    for s, d in zip(case.series, case.simulator.drives, strict=True):
        place = np.arange(len(s.output))
        filled = np.interp(place, place[s.counts], s.output[s.counts])
        record = Record(s.record.name, d.age + place * dt, d.voltage, filled)
        force = case.model.input_map.force(d.voltage) / case.simulator.force_scale
        # six times the resonance, three lines of the record, and never near the Nyquist frequency
        cut = min(max(6 * omega / (2 * np.pi), 3 / (len(place) * dt)), 0.3 / dt)
        states = preprocess(record, 2, cut, force, displacement=filled).states
        weight = 1e4 * s.counts / (s.counts.sum() * s.span**2)
        along.append(Motion(record, weight, states, force - states @ a, s.noise, s.span))
    scale_, unit = float(case.model.scales.state[0]), fitted_of(case.model).origin.displacement_unit
    reach = max(float(np.abs(m.states[:, 0]).max()) for m in along)
    return Seen(tuple(along), omega, reach, scale_, unit)


def locate(seen: Seen, errors: Sequence[np.ndarray]) -> dict:
    """Return the location of the error as the `where` of docs/contract.md: fractions per axis, one sentence."""
    errors = [np.nan_to_num(e) for e in errors]
    out = {
        "records": _records(seen, errors),
        "frequency": _frequency(seen, errors),
        "harmonics": _harmonics(seen, errors),
        "time": _time(seen, errors),
        "tone": _tone(seen, errors),
    }
    quiet = _quiet(seen)
    for name, value in (("displacement", 0), ("velocity", 1), ("voltage", None)):
        out[name] = _axis(seen, quiet, value)
    out["cells"] = _cells(seen, quiet)
    out["summary"] = _sentence(seen, out)
    return out


def nowhere() -> dict:
    """Return an empty `where`, for an error that could not be located."""
    empty: dict = {"records": {}, "harmonics": {}, "tone": None, "summary": ""}
    return empty | {name: [] for name in ("frequency", "time", "displacement", "velocity", "voltage", "cells")}


def _quiet(seen: Seen) -> float:
    """Estimate the mean square of the missing force from noise alone: the lowest of its local mean squares."""
    size = max(int(np.pi / seen.omega / seen.dt), 8)
    # mean squares over half a natural period, of which the smallest contain hardly any gap
    local = [np.convolve(m.force**2, np.ones(size) / size, "valid")[::size] for m in seen.motions]
    return float(np.quantile(np.concatenate(local), 0.05))


def _shares(values) -> np.ndarray:
    values = np.maximum(np.asarray(values, float), 0.0)
    return values / values.sum() if values.sum() > 0 else np.full(len(values), 1 / max(len(values), 1))


def _records(seen: Seen, errors) -> dict:
    energy = [np.sum(s.weight * (e**2 - s.noise**2)) for s, e in zip(seen.motions, errors, strict=True)]
    return dict(zip([s.record.name for s in seen.motions], _shares(energy).tolist(), strict=True))


def _edges_hz(seen: Seen) -> np.ndarray:
    edges, top = BAND_EDGES * seen.omega / (2 * np.pi), 0.5 / seen.dt
    return np.append(edges[edges < 0.9 * top], top)


def _frequency(seen: Seen, errors) -> list[dict]:
    edges, energy = _edges_hz(seen), 0.0
    for s, e in zip(seen.motions, errors, strict=True):
        power = np.abs(np.fft.rfft(e * (s.weight > 0))) ** 2 / len(e) * 2
        frequency = np.fft.rfftfreq(len(e), seen.dt)
        # white noise, in the density of a one-sided spectrum
        floor = 2 * s.noise**2
        energy = energy + np.histogram(frequency, edges, weights=(power - floor) / (len(e) * s.span**2))[0]
    return _binned("band_hz", edges, energy)


def _binned(key: str, edges: np.ndarray, energy) -> list[dict]:
    """Return the bins between edges, each with its fraction of the energy."""
    rows = zip(edges[:-1], edges[1:], _shares(energy), strict=True)
    return [{key: [float(a), float(b)], "share": float(v)} for a, b, v in rows]


def _harmonics(seen: Seen, errors) -> dict:
    """Return error fractions at multiples of a sine input's frequency, and "other"; empty without a sine."""
    totals: dict[str, float] = {}
    for s, e in zip(seen.motions, errors, strict=True):
        # for other inputs no line shows which multiple an error belongs to
        if kind(s.record) != "sine":
            continue
        line = int(np.argmax(spectrum(s.record)[1:]) + 1)
        power = np.abs(np.fft.rfft(e * (s.weight > 0) * np.hanning(len(e)))) ** 2 / s.span**2 / len(e)
        # mean square of a Hann window: its gain for white noise
        power = power - 0.375 * s.noise**2 / s.span**2
        order = np.arange(len(power)) / line
        # two lines on either side, because the window widens a line to four
        near = np.abs(order - np.round(order)) * line <= 2
        for name, mask in [("0f", order * line <= 2), *((f"{k}f", near & (np.round(order) == k)) for k in range(1, 7))]:
            totals[name] = totals.get(name, 0.0) + float(np.maximum(power[mask], 0).sum())
        other = ~near | (np.round(order) > 6)
        totals["other"] = totals.get("other", 0.0) + max(float(power[other].sum()), 0.0)
    return dict(zip(totals, map(float, _shares(list(totals.values()))), strict=True))


def _tone(seen: Seen, errors) -> dict | None:
    """Return frequency (Hz), records and energy fraction of a `steady_tone` in the residuals; None without one."""
    tone = steady_tone(
        [e * (s.weight > 0) for s, e in zip(seen.motions, errors, strict=True)],
        [s.record.voltage for s in seen.motions],
        [seen.dt] * len(errors),
    )
    # within one of the lowest lines a drift has as much of its energy
    if tone is not None and tone[0] * seen.dt * max(map(len, errors)) >= _PERIODS:
        return {"hz": tone[0], "records": len(errors), "share": tone[1]}
    return None


def _time(seen: Seen, errors) -> list[dict]:
    """Return the fractions of the error energy by tenths of a record, all records together."""
    energy = np.zeros(_BINS)
    for s, e in zip(seen.motions, errors, strict=True):
        parts = np.array_split(s.weight * (e**2 - s.noise**2), _BINS)
        energy += [p.sum() for p in parts]
    return _binned("part", np.arange(_BINS + 1) / _BINS, energy)


def _axis(seen: Seen, quiet: float, index: int | None) -> list[dict]:
    scale = seen.length if index is not None else 1.0
    values = [m.record.voltage if index is None else m.states[:, index] for m in seen.motions]
    # not the extremes, because a single overshoot would leave the outer bins empty
    low = min(float(np.quantile(v, 0.001)) for v in values)
    high = max(float(np.quantile(v, 0.999)) for v in values)
    edges = np.linspace(low, high, _BINS + 1)
    energy = np.zeros(_BINS)
    for m, v in zip(seen.motions, values, strict=True):
        energy += np.histogram(np.clip(v, low, high), edges, weights=(m.weight > 0) * (m.force**2 - quiet) / len(v))[0]
    return _binned("range", edges * scale, energy)


def _cells(seen: Seen, quiet: float) -> list[dict]:
    """Return cells of local input frequency and amplitude, with their fractions of the missing force's energy."""
    bands, reach = _edges_hz(seen), seen.reach
    energy, weight = np.zeros((2, len(bands) - 1, len(AMPLITUDE_EDGES) - 1))
    for m in seen.motions:
        for first, last, hz, amplitude in windows(m, seen):
            i = int(np.clip(np.searchsorted(bands, hz, "right") - 1, 0, len(bands) - 2))
            j = int(np.clip(np.searchsorted(AMPLITUDE_EDGES, amplitude / reach, "right") - 1, 0, energy.shape[1] - 1))
            there = m.weight[first:last] > 0
            energy[i, j] += np.sum((m.force[first:last] ** 2 - quiet)[there])
            weight[i, j] += there.sum()
    density = np.maximum(energy, 0) / np.maximum(weight, 1)
    # density instead of energy, so that a frequently visited cell does not stand out
    loud = density.max()
    flagged = (density > _FLAG**2 * loud) & (density > 3 * quiet) & (weight > 0)
    shares = _shares(energy.ravel()).reshape(energy.shape)
    scale = seen.length * reach
    return [
        {
            "band_hz": [float(bands[i]), float(bands[i + 1])],
            "amplitude": [float(AMPLITUDE_EDGES[j] * scale), float(AMPLITUDE_EDGES[j + 1] * scale)],
            "share": float(shares[i, j]),
            "flagged": bool(flagged[i, j]),
        }
        for i in range(energy.shape[0])
        for j in range(energy.shape[1])
        if weight[i, j] > 0
    ]


def windows(s: Motion, seen: Seen):
    """Return windows between mean crossings of the input: (first, last, frequency in Hz, largest |X|)."""
    u = s.record.voltage - (s.record.voltage.max() + s.record.voltage.min()) / 2
    crossings = np.flatnonzero(np.diff(np.signbit(u)))
    shortest = max(int(np.pi / seen.omega / seen.dt), 4)
    longest = max(int(10 * 2 * np.pi / seen.omega / seen.dt), 16)
    edges = [0]
    for c in [*crossings, len(u) - 1]:
        # a slow input crosses seldom, so its windows end after ten natural periods
        while c - edges[-1] > longest:
            edges.append(edges[-1] + longest)
        if c - edges[-1] >= shortest:
            edges.append(int(c))
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        inside = ((crossings > first) & (crossings <= last)).sum()
        hz = inside / 2 / ((last - first) * seen.dt)
        yield first, last, float(hz), float(np.abs(s.states[first:last, 0]).max())


def _sentence(seen: Seen, out: dict) -> str:
    """Describe the cell with the largest missing force, and the record and the band with the largest error."""
    texts = []
    band = max(out["frequency"], key=lambda f: f["share"])
    record, share = max(out["records"].items(), key=lambda item: item[1])
    for cell in sorted(out["cells"], key=lambda c: -c["share"])[:1]:
        low, high = (from_base(size, seen.unit) for size in cell["amplitude"])
        texts.append(
            f"The missing force is largest for inputs of {_hertz(cell)} and motions of {low:.3g} to {high:.3g} "
            f"{shown_unit(seen.unit)} ({percent(cell['share'])} of it)."
        )
    if len(out["records"]) > 1:
        texts.append(f"{percent(share)} of the error is in {record}.")
    return " ".join([*texts, f"{percent(band['share'])} of the error is at {_hertz(band)}."])


def _hertz(row: dict) -> str:
    return "{:.3g} to {:.3g} Hz".format(*row["band_hz"])
