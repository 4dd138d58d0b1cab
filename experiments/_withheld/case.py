"""One withheld case: a plant, a form of an effect, its strength from a wanted gap, two sets of records.

    gap = sqrt(mean over records of (rms(real - healthy) / range(real))^2), noise-free, under the same drive

Strength 1 wants a gap of 6 to 14 % (3 to 8 % outside the catalogue; over sqrt 2 each of two), strength 0.4 that times
0.4: the same actuator, weaker.
"""

import hashlib
import json
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pitp_jax import Record

from . import plant as integrator
from . import protocol
from .catalogue import FORMS, OUTSIDE
from .form import Stats
from .scale import cut, gap, search

_VERSION = 1  # of the generator: a cached case of another one is never taken


@dataclass(frozen=True)
class Spec:
    """What a case is: names of its effects (none: ()), kind, seed, strength, noise."""

    names: tuple[str, ...]
    kind: str
    seed: int
    strength: float = 1.0
    noise: str = "white"

    @property
    def key(self) -> str:
        """A name that does not tell the effect."""
        return hashlib.sha256(json.dumps([_VERSION, asdict(self)]).encode()).hexdigest()[:12]

    @property
    def label(self) -> str:
        """The effects in words."""
        return "+".join(self.names) or "none"

    def rng(self, part: str) -> np.random.Generator:
        """Draws of one part; the same actuator at every strength and noise."""
        return np.random.default_rng([self.seed, *(zlib.crc32(s.encode()) for s in (self.kind, self.label, part))])


@dataclass(frozen=True)
class Case:
    """Two sets of records and the truth about the second.

    Attributes:
        clean, real: healthy records, each from time 0; records with the effect, on the session clock.
        true: noise-free outputs of `real` in m, by name.
        missing: force that the healthy equation lacks along `real`, by name, in shares of a_0 X; only where asked for.
        facts: gap in %, noise floor in %, forms, strengths, plant.
    """

    clean: list[Record]
    real: list[Record]
    true: dict[str, np.ndarray]
    missing: dict[str, np.ndarray]
    facts: dict


def make(spec: Spec, locate: bool = False) -> Case:
    """Draw, scale and record a case; `locate` also keeps the missing force."""
    kind, rng = protocol.KINDS[spec.kind], spec.rng("plant")
    plant = protocol.draw_plant(kind, rng)
    clean_u, real_u = (protocol.draw_voltages(plant, rng) for _ in range(2))
    clean_y = _healthy(plant, clean_u)
    real_y, missing, facts = _with_effects(spec, plant, real_u, locate)
    sensor, zeros = spec.rng("sensor"), np.zeros(len(clean_u))
    scaled = [[plant.scale * y for y in rows] for rows in (clean_y, real_y)]
    clean, real = (
        protocol.records(kind, start, u, protocol.measure(y, spec.noise, sensor))
        for start, u, y in zip((zeros, protocol.clocks(kind)), (clean_u, real_u), scaled, strict=True)
    )
    floor = 100 * np.sqrt(np.mean([(protocol.noise_std(scaled[1]) / np.ptp(y)) ** 2 for y in scaled[1]]))
    facts |= {"floor_percent": float(floor), "zeta": plant.zeta, "f0_hz": plant.f0, "scale_m": plant.scale}
    by_name = {r.name: y for r, y in zip(real, scaled[1], strict=True)}
    return Case(clean, real, by_name, dict(zip(by_name, missing, strict=True)) if missing else {}, facts)


def _healthy(plant: protocol.Healthy, voltages) -> list[np.ndarray]:
    step = plant.constants["step"]
    return [integrator.healthy(u / plant.kind.top, step, plant.zeta)[0] for u in voltages]


def _stats(plant: protocol.Healthy, voltages) -> Stats:
    step, us = plant.constants["step"], [u / plant.kind.top for u in voltages]
    pairs = [integrator.healthy(u, step, plant.zeta) for u in us]
    x, v = np.concatenate(pairs, axis=1)
    third = sorted(pair[0].max() for pair in pairs)[-min(3, len(pairs))]
    fall = -(np.concatenate(us) ** 2 - x - 2 * plant.zeta * v).min()
    slew = np.quantile(np.concatenate([np.abs(np.diff(u)) for u in us]), 0.999) / step
    numbers = x.max(), x.min(), third, np.abs(v).max(), fall, slew, max(u.max() for u in us)
    return Stats(*map(float, numbers), plant.zeta, plant.f0, plant.kind.length)


def _with_effects(spec: Spec, plant: protocol.Healthy, voltages, locate: bool):
    """Noise-free outputs in X, the missing force (None unless asked), and the facts of the label."""
    base, rng, stats = _healthy(plant, voltages), spec.rng("effect"), _stats(plant, voltages)
    low, high = (3.0, 8.0) if set(spec.names) & set(OUTSIDE) else (6.0, 14.0)
    target = rng.uniform(low, high) * spec.strength / np.sqrt(max(len(spec.names), 1))
    forms, ps, cs, arrays, y = [], [], [], [], base
    for name in spec.names:
        form = FORMS[name][rng.integers(len(FORMS[name]))]
        cs.append({k: float(v) for k, v in form.draw(rng, stats).items()})
        times = [
            start + np.arange(len(u)) / plant.kind.rate
            for start, u in zip(protocol.clocks(plant.kind), voltages, strict=True)
        ]
        arrays.append([form.arrays(rng, t, stats) for t in times])
        inputs = _inputs(plant, voltages, [arrays[-1]])
        p, y = search(form, cs[-1], plant.constants, inputs, base, target)
        forms, ps = [*forms, form], [*ps, p]
    inputs = _inputs(plant, voltages, arrays)
    if len(forms) > 1:
        y = cut(integrator.outputs(forms, [ps], cs, plant.constants, inputs)[0], base)
    lacking = integrator.missing(forms, ps, cs, plant.constants, inputs) if locate and forms else None
    facts = {
        "label": spec.label,
        "forms": [f.name for f in forms],
        "strengths": ps,
        "constants": cs,
        "gap_percent": gap(y, base),
    }
    return y, None if lacking is None else cut(lacking, base), facts


def _inputs(plant: protocol.Healthy, voltages, arrays) -> dict:
    """What the integrator takes; `arrays` per effect and record."""
    u = protocol.stack([u / plant.kind.top for u in voltages])
    ports = {
        port: tuple(protocol.stack([a[port] for a in per]) if port in per[0] else None for per in arrays)
        for port in ("push", "gate", "add")
    }
    return {"u": u, "clock": protocol.clocks(plant.kind), **ports}


def load_or_make(spec: Spec, cache: Path | None, locate: bool = False) -> Case:
    """A case from the cache folder, or made and kept there."""
    path = cache / f"{spec.key}{'-cells' if locate else ''}.npz" if cache else None
    if path is None or not path.exists():
        case = make(spec, locate)
        if path:
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part.npz")
            np.savez_compressed(part, **_flat(case))
            part.replace(path)
        return case
    with np.load(path) as held:
        return _unflat(dict(held))


def _flat(case: Case) -> dict:
    flat = {"facts": json.dumps(case.facts)}
    for part, rows in (("clean", case.clean), ("real", case.real)):
        for r in rows:
            flat[f"{part}/{r.name}"] = np.stack([r.time, r.voltage, r.displacement])
    for part, by_name in (("true", case.true), ("missing", case.missing)):
        flat |= {f"{part}/{name}": y for name, y in by_name.items()}
    return flat


def _unflat(flat: dict) -> Case:
    parts = {part: {} for part in ("clean", "real", "true", "missing")}
    for key in flat.keys() - {"facts"}:
        part, name = key.split("/")
        parts[part][name] = flat[key]
    sets = [
        [Record(n, *parts[p][n], displacement_unit="mm", source=f"withheld {n}") for n in protocol.NAMES]
        for p in ("clean", "real")
    ]
    return Case(
        *sets,
        *({n: parts[p][n] for n in protocol.NAMES if n in parts[p]} for p in ("true", "missing")),
        json.loads(str(flat["facts"])),
    )
