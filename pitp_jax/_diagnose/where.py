"""Where the gap lies: residual energy of the nominal, noise subtracted, over every axis a rig has.

    output     share of  sum w (e^2 - sigma^2)  by record, frequency of the residual, harmonic of the drive, and time
    force      r = F - sum_i sigma_i x^(i) - sigma_off  (what the equation lacks), by displacement, velocity, voltage,
               and by cells of the drive's local frequency x the local amplitude of the motion

A cell is flagged where the missing force stands out of what noise leaves there, and is no mere spill of the filter.
"""

import numpy as np

from .._record.excitation_kind import kind, spectrum
from .case import Case, Series
from .noise import Noise
from .steady_tone import steady_tone

AMPLITUDE_EDGES = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.01])  # of the largest displacement
BAND_EDGES = np.array([0.0, 0.15, 0.35, 0.7, 1.4, 2.8, 6.0])  # of the nominal's natural frequency
_BINS = 10
_MOST = 0.6  # of the missing force's energy, in the cells that the sentence spans
_FLAG = 0.15  # a flagged cell's missing force, rms, beside that of the loudest cell


def locate(case: Case, errors: list[np.ndarray], noise: Noise) -> dict:
    """The `where` of docs/contract.md: shares that sum to 1 per axis, and one plain sentence."""
    series = case.series
    out = {
        "records": _records(case, errors, noise),
        "frequency": _frequency(case, errors, noise),
        "harmonics": _harmonics(case, errors, noise),
        "time": _time(case, errors, noise),
        "tone": _tone(case, errors),
    }
    forces = [missing_force(s) for s in series]
    quiet = _quiet(case, noise)
    for name, value in (("displacement", 0), ("velocity", 1), ("voltage", None)):
        out[name] = _axis(case, forces, quiet, name, value)
    out["cells"] = _cells(case, forces, quiet)
    out["summary"] = _sentence(case, out)
    return out


def missing_force(s: Series, factors: float | np.ndarray = 1.0) -> np.ndarray:
    """Scaled F - sum_i sigma_i x^(i) - sigma_off along the measured motion; `factors` on the tokens."""
    return s.force - np.einsum("ti,ti->t", s.tokens * factors, s.motion) - s.offset


def _quiet(case: Case, noise: Noise) -> float:
    """Mean square of the missing force that noise alone makes: the lower decile of its local mean squares."""
    size = max(int(np.pi / case.surroundings.omega / case.dt), 8)
    local = [np.convolve(missing_force(s) ** 2, np.ones(size) / size, "valid")[::size] for s in case.series]
    return float(np.quantile(np.concatenate(local), 0.05))


def _shares(values) -> np.ndarray:
    values = np.maximum(np.asarray(values, float), 0.0)
    return values / values.sum() if values.sum() > 0 else np.full(len(values), 1 / max(len(values), 1))


def _records(case: Case, errors, noise: Noise) -> dict:
    energy = [np.sum(s.weight * (e**2 - noise.sigma**2)) for s, e in zip(case.series, errors, strict=True)]
    return {s.record.name: float(v) for s, v in zip(case.series, _shares(energy), strict=True)}


def _edges_hz(case: Case) -> np.ndarray:
    edges, top = BAND_EDGES * case.surroundings.omega / (2 * np.pi), 0.5 / case.dt
    return np.append(edges[edges < 0.9 * top], top)


def _frequency(case: Case, errors, noise: Noise) -> list[dict]:
    edges, energy = _edges_hz(case), 0.0
    for s, e in zip(case.series, errors, strict=True):
        power = np.abs(np.fft.rfft(e * (s.weight > 0))) ** 2 / len(e) * 2
        frequency = np.fft.rfftfreq(len(e), case.dt)
        floor = np.interp(frequency, *noise.spectrum.T) / case.dt
        energy = energy + np.histogram(frequency, edges, weights=(power - floor) / (len(e) * s.span**2))[0]
    return [
        {"band_hz": [float(a), float(b)], "share": float(v)}
        for a, b, v in zip(edges[:-1], edges[1:], _shares(energy), strict=True)
    ]


def _harmonics(case: Case, errors, noise: Noise) -> dict:
    """Shares at multiples of the drive's line (sines only), the rest under "other"; empty without a sine."""
    totals: dict[str, float] = {}
    for s, e in zip(case.series, errors, strict=True):
        if kind(s.record) != "sine":
            continue
        line = int(np.argmax(spectrum(s.record)[1:]) + 1)
        power = np.abs(np.fft.rfft(e * (s.weight > 0) * np.hanning(len(e)))) ** 2 / s.span**2 / len(e)
        floor = np.interp(np.fft.rfftfreq(len(e), case.dt), *noise.spectrum.T) / case.dt / 2 * 0.375 / s.span**2
        power = power - floor
        order = np.arange(len(power)) / line
        near = np.abs(order - np.round(order)) * line <= 2
        for name, mask in [("0f", order * line <= 2), *((f"{k}f", near & (np.round(order) == k)) for k in range(1, 7))]:
            totals[name] = totals.get(name, 0.0) + float(np.maximum(power[mask], 0).sum())
        other = ~near | (np.round(order) > 6)
        totals["other"] = totals.get("other", 0.0) + max(float(power[other].sum()), 0.0)
    return dict(zip(totals, map(float, _shares(list(totals.values()))), strict=True))


def _tone(case: Case, errors) -> dict | None:
    """`steady_tone` of the residuals: its frequency, in how many records, and its least share of one's gap."""
    found = steady_tone(
        [e * (s.weight > 0) for s, e in zip(case.series, errors, strict=True)],
        [s.record.voltage for s in case.series],
        [case.dt] * len(errors),
    )
    return None if found is None else {"hz": found[0], "records": len(errors), "share": found[1]}


def _time(case: Case, errors, noise: Noise) -> list[dict]:
    """By tenths of a record, all records together."""
    energy = np.zeros(_BINS)
    for s, e in zip(case.series, errors, strict=True):
        parts = np.array_split(s.weight * (e**2 - noise.sigma**2), _BINS)
        energy += [p.sum() for p in parts]
    return [{"part": [k / _BINS, (k + 1) / _BINS], "share": float(v)} for k, v in enumerate(_shares(energy))]


def _axis(case: Case, forces, quiet: float, name: str, index: int | None) -> list[dict]:
    scale = case.model.scales.state[index] if index is not None and index < len(case.model.scales.state) else 1.0
    values = [s.voltage if index is None else s.motion[:, min(index, case.model.order)] for s in case.series]
    low = min(float(np.quantile(v, 0.001)) for v in values)
    high = max(float(np.quantile(v, 0.999)) for v in values)
    edges = np.linspace(low, high, _BINS + 1)
    energy = np.zeros(_BINS)
    for s, v, f in zip(case.series, values, forces, strict=True):
        inside = np.clip(v, low, high)
        energy += np.histogram(inside, edges, weights=(s.weight > 0) * (f**2 - quiet) / len(f))[0]
    return [
        {"range": [float(a * scale), float(b * scale)], "share": float(v)}
        for a, b, v in zip(edges[:-1], edges[1:], _shares(energy), strict=True)
    ]


def _cells(case: Case, forces, quiet: float) -> list[dict]:
    """Cells of local drive frequency x local amplitude; every window of half a natural period or more is in one."""
    bands, reach = _edges_hz(case), case.surroundings.reach
    energy, weight = np.zeros((2, len(bands) - 1, len(AMPLITUDE_EDGES) - 1))
    for s, f in zip(case.series, forces, strict=True):
        for first, last, hz, amplitude in windows(s, case):
            i = int(np.clip(np.searchsorted(bands, hz, "right") - 1, 0, len(bands) - 2))
            j = int(np.clip(np.searchsorted(AMPLITUDE_EDGES, amplitude / reach, "right") - 1, 0, energy.shape[1] - 1))
            seen = s.weight[first:last] > 0
            energy[i, j] += np.sum((f[first:last] ** 2 - quiet)[seen])
            weight[i, j] += seen.sum()
    density = np.maximum(energy, 0) / np.maximum(weight, 1)
    loud = density.max()
    flagged = (density > _FLAG**2 * loud) & (density > 3 * quiet) & (weight > 0)
    shares = _shares(energy.ravel()).reshape(energy.shape)
    scale = case.model.scales.state[0] * reach
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


def windows(s: Series, case: Case):
    """(first, last, local drive frequency in Hz, largest |X|) of windows between the drive's mean crossings."""
    u = s.record.voltage - (s.record.voltage.max() + s.record.voltage.min()) / 2
    crossings = np.flatnonzero(np.diff(np.signbit(u)))
    shortest = max(int(np.pi / case.surroundings.omega / case.dt), 4)
    longest = max(int(10 * 2 * np.pi / case.surroundings.omega / case.dt), 16)
    edges = [0]
    for c in [*crossings, len(u) - 1]:
        while c - edges[-1] > longest:
            edges.append(edges[-1] + longest)
        if c - edges[-1] >= shortest:
            edges.append(int(c))
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        inside = ((crossings > first) & (crossings <= last)).sum()
        hz = inside / 2 / ((last - first) * case.dt)
        yield first, last, float(hz), float(np.abs(s.motion[first:last, 0]).max())


def _sentence(case: Case, out: dict) -> str:
    """Cells that hold most of the gap, the loudest record and band, in words."""
    from_unit = {"mm": 1e3, "um": 1e6, "m": 1.0, "mV": 1e3, "V": 1.0}
    unit = case.origin.displacement_unit
    factor = from_unit.get(unit, 1.0)
    ordered = sorted(out["cells"], key=lambda c: -c["share"])
    held = np.cumsum([c["share"] for c in ordered])
    loud = ordered[: int(np.searchsorted(held, _MOST)) + 1]
    band = [min(c["band_hz"][0] for c in loud), max(c["band_hz"][1] for c in loud)]
    size = [min(c["amplitude"][0] for c in loud), max(c["amplitude"][1] for c in loud)]
    record = max(out["records"], key=out["records"].get)
    lines = max(out["frequency"], key=lambda f: f["share"])
    tone = out["tone"]
    steady = ""
    if tone is not None:
        steady = (
            f"A steady tone at {tone['hz']:.4g} Hz makes up {100 * tone['share']:.0f} % of the gap or more in "
            f"every record, whatever its drive. "
        )
    return steady + (
        f"The missing force is largest for drives of {band[0]:.3g} to {band[1]:.3g} Hz and motions of "
        f"{factor * size[0]:.3g} to {factor * size[1]:.3g} {unit}; {100 * out['records'][record]:.0f} % of the gap is "
        f"in {record}, {100 * lines['share']:.0f} % between {lines['band_hz'][0]:.3g} and {lines['band_hz'][1]:.3g} Hz."
    )
