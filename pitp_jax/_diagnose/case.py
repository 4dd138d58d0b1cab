"""A case: a nominal model beside real recordings, in the model's scaled coordinates, on the host.

    e = x_nominal - x_measured    (free run, voltage as the model holds it)
    S = [x, x', ..., x^(n)]       (measured, filtered zero-phase; missing samples filled from the free run)

Fitted and held-out records are of different excitations as far as the set allows: what is fitted must hold on a drive
the fit never saw, not on another part of the same one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from .._effects.spec import Surroundings
from .._errors import BadInput
from .._model.model import Model
from .._record.excitation_kind import kind, loudest
from .._record.initial_state import aligned
from .._record.preprocess import force_band, preprocess
from .._record.record import Record
from .._record.sets import session_clock
from .._simulate import ports
from .._simulate.decoder import rollout_batch
from .._simulate.prediction import at_rate, begin, reaches

Split = Literal["first", "second", "none"]


@dataclass(frozen=True)
class Series:
    """One record as the diagnosis reads it; arrays of shape (T,) unless said.

    Attributes:
        record: as given, cut to the budget.
        fitted: whether effects are fitted on it.
        voltage: behind the model's drive, V.
        force: scaled nominal force.
        motion: measured scaled [X_0 ... X_n], shape (T, n + 1).
        tokens, offset: the nominal's along the measured motion, shapes (T, n + 1) and (T,).
        run: scaled free run of the nominal.
        error: scaled e, interpolated where the output is missing.
        weight: 1e4 / (samples range^2) where the output counts, else 0: sum weight e^2 is e_rms_percent^2.
        rest: starts at rest.
        start: scaled decoder state of the nominal, shape (n + K,).
        age: session clock at the first sample, s (0 where it is not known).
        reached: largest scaled |x| of the session before (0 where that is not known).
        span: scaled peak to peak of the measurement.
    """

    record: Record
    fitted: bool
    voltage: np.ndarray
    force: np.ndarray
    motion: np.ndarray
    tokens: np.ndarray
    offset: np.ndarray
    run: np.ndarray
    error: np.ndarray
    weight: np.ndarray
    rest: bool
    start: np.ndarray
    age: float
    reached: float
    span: float


@dataclass(frozen=True)
class Case:
    """All records of a diagnosis.

    Attributes:
        model: the nominal at the records' rate, with enough substeps for stiff contacts.
        series: one per record, in the order given.
        surroundings: what starts and bounds of effects are taken from.
        split: which of the splits this is.
        mesh: devices that share the rollouts; None: the default one.
    """

    model: Model
    series: tuple[Series, ...]
    surroundings: Surroundings
    split: Split = "first"
    mesh: Mesh | None = None

    @property
    def dt(self) -> float:
        """Sampling interval, s."""
        return self.series[0].record.dt

    @property
    def fitted(self) -> tuple[Series, ...]:
        """Records effects are fitted on."""
        return tuple(s for s in self.series if s.fitted)

    @property
    def heldout(self) -> tuple[Series, ...]:
        """Records they are judged on."""
        return tuple(s for s in self.series if not s.fitted)


def build_case(model: Model, records: Sequence[Record], *, how: Split = "first", mesh: Mesh | None = None) -> Case:
    """Roll the nominal out beside every record and take what else a diagnosis needs; `how`: see `split`.

    Every record enters with its own zero and direction taken out (`begin`): they belong to the sensor, and no effect
    may explain them.
    """
    model = _finer(at_rate(model, records[0].dt), records[0].dt)
    known = len(records) > 1 and session_clock(records)
    starts, spent, begun = begin(model, records, known)
    records = [aligned(r, b, model.output) for r, b in zip(records, begun, strict=True)]
    fitted = split(records, how)
    size = max(r.samples for r in records)
    voltage = np.stack([np.pad(r.voltage, (0, size - r.samples), mode="edge") for r in records])
    dtype = model.coefficients.dtype
    states = rollout_batch(model, jnp.asarray(voltage, dtype), records[0].dt, starts)
    runs = np.asarray(jax.vmap(lambda s: ports.readings(model, s))(states), np.float64)
    top = force_band([model.input_map.force(r.voltage) for r in records], records[0].dt)
    cut = min(max(3 * top, 3 * model.natural_frequency / (2 * np.pi)), 0.3 / records[0].dt)
    reached = reaches(model, records) if known else [0.0] * len(records)
    ages = [model.provenance.age(r.time[0]) if known else 0.0 for r in records]
    series = tuple(
        _series(
            model, r, r.name in fitted, runs[k, : r.samples], spent[k], np.asarray(starts[k]), cut, ages[k], reached[k]
        )
        for k, r in enumerate(records)
    )
    return Case(model, series, _surroundings(model, series, known), how, mesh)


def _finer(model: Model, dt: float) -> Model:
    """Substeps of at most 0.1 / omega: stiff contacts and frozen forces need a finer step than the nominal."""
    return replace(model, substeps=max(model.substeps, int(np.ceil(model.natural_frequency * dt / 0.1))))


def split(records: Sequence[Record], how: Split = "first") -> set[str]:
    """Names of the records to fit: about half, every kind that has several on both sides, broadband held out.

    A drive of its own kind is held out where something else spans the range; sweeps and steps (the only records that
    tell slow from fast) are fitted. Sines alternate by frequency, and a drive that was played twice stays on one side;
    `second`: those that were held out are fitted; `none`: all are fitted, and none is held out.
    """
    if how == "none":
        return {r.name for r in records}
    groups: dict[str, list[Record]] = {}
    for r in records:
        groups.setdefault(kind(r), []).append(r)
    fitted: set[str] = set()
    for name, members in groups.items():
        drives = _by_drive(sorted(members, key=lambda r: (loudest(r), r.name)))
        if len(members) > 1:
            fitted |= {r.name for drive in drives[how == "second" :: 2] for r in drive}
        elif name in ("sweep", "steps") or len(groups) == 1:
            fitted.add(members[0].name)
    if not fitted:
        fitted.add(max(records, key=lambda r: np.ptp(r.voltage) * r.samples).name)
    if how == "second" and fitted == split(records, "first"):  # no kind has several: what was held out is fitted
        return {r.name for r in records} - fitted or fitted
    return fitted


def _by_drive(records: Sequence[Record]) -> list[list[Record]]:
    """Records of one voltage together (line, mean and size to 1 % of the range); one each where all have the same."""
    found: list[tuple[np.ndarray, list[Record]]] = []
    for r in records:
        size = np.ptp(r.voltage)
        drive = np.array([loudest(r) * size, r.voltage.mean(), r.voltage.std(), size])
        same = [rs for d, rs in found if np.all(np.abs(d - drive) <= 0.01 * np.array([drive[0], *[size] * 3]))]
        same[0].append(r) if same else found.append((drive, [r]))
    return [rs for _, rs in found] if len(found) > 1 else [[r] for r in records]


def _series(
    model: Model, record: Record, fitted: bool, run, spent: int, start, cut: float, age: float, reached: float
) -> Series:
    n, scale = model.order, np.asarray(model.scales.state)
    x = model.output.to_model(record.displacement) / scale[0]
    seen = np.isfinite(x)
    place = np.arange(record.samples)
    if not np.isfinite(run).all():
        raise BadInput(f"the nominal model diverges on {record.name}: it cannot be diagnosed, identify it again")
    error = np.interp(place, place[seen], (run - x)[seen])
    filled = (run - error) * scale[0]
    force = model.input_map.force(record.voltage) / model.scales.force
    motion = preprocess(record, n, cut, force, displacement=filled).states / scale
    motion[0, 0] = x[0] if seen[0] else motion[0, 0]
    counts = seen.copy()
    counts[:spent] = False
    span = float(np.ptp(x[seen]))
    weight = 1e4 * counts / (max(counts.sum(), 1) * span**2)
    rest = not np.any(start[:n])
    late = ports.delayed(model, jnp.asarray(record.voltage, jnp.float32), record.dt, jnp.asarray(rest))
    voltage = np.asarray(model.drive.film(late, record.dt, jnp.asarray(rest)))
    memory = model.memory.trajectory(
        jnp.asarray(motion[:, 0], jnp.float32), record.dt, model.memory.initial(jnp.asarray(motion[0, 0], jnp.float32))
    )
    features = jnp.concatenate([jnp.asarray(motion[:, :n], jnp.float32), memory], -1)
    tokens, offset = jax.vmap(model.tokens)(features)
    film = np.asarray(voltage, np.float64)
    return Series(
        record=record, fitted=fitted, voltage=film,
        force=model.input_map.force(film) / model.scales.force, motion=motion, tokens=np.asarray(tokens),
        offset=np.asarray(offset), run=run, error=error, weight=weight, rest=rest,
        start=start[: n + model.memory.size], age=age, reached=reached, span=span,
    )  # fmt: skip


def _surroundings(model: Model, series: Sequence[Series], known: bool) -> Surroundings:
    x = np.concatenate([s.motion[s.weight > 0, 0] for s in series])
    fastest = max(float(np.quantile(np.abs(s.motion[s.weight > 0, min(2, model.order)]), 0.999)) for s in series)
    speeds = np.concatenate([s.motion[s.weight > 0, min(1, model.order)] for s in series])
    a = np.asarray(model.coefficients, np.float64)
    dt = series[0].record.dt
    ends = [s.record.time[-1] for s in series]
    return Surroundings(
        omega=model.natural_frequency, dt=dt, duration=max(s.record.samples for s in series) * dt,
        session=float(max(ends) - min(s.record.time[0] for s in series)) if known else 0.0,
        top=float(np.quantile(x, 0.9999)), bottom=float(np.quantile(x, 0.0001)),
        speed=float(np.sqrt(np.mean(speeds**2))), acceleration=fastest,
        voltage=max(float(np.abs(s.record.voltage).max()) for s in series),
        slew=max(float(np.abs(np.diff(s.record.voltage)).max()) / dt for s in series),
        stiffness=float(a[0]), inertia=float(a[2]) if model.order >= 2 else 0.0,
        damping=float(a[1]),
    )  # fmt: skip
