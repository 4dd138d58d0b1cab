"""Prepare recordings for a diagnosis: thinned, in the model's scaled units, with folds for cross-validation.

    a_0 X + a_1 X' + a_2 X'' = F,   y = lag or filter of X        (orders three and four: the slower two poles, then a
                                                                   lag or a filter of the output for the others)

Every k-th sample is kept. Input (as a force) and motion are averaged over the k samples around it with the same
weights, so a linear plant's response to the averaged input is its averaged response. All records together keep some
thousand samples, so that few are not averaged at all: dry friction sticks elsewhere under an averaged input. Below 10
samples a period the simulator's own error would be reported as effects. Offset and direction of each record are
removed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...common.errors import BadInput
from ..model.model import Model
from ..model.substeps import substeps
from ..signal.initial_state import aligned, noise_std
from ..signal.preprocess import force_band
from ..signal.record import Record
from ..signal.reduced import centred_means, fastest_hz, samples_before
from ..signal.sets import session_clock
from ..simulate.model_runs import film_of
from ..simulate.prediction import at_rate, begin, predict, reaches
from .library import CORE, INDEX, slots_of
from .simulator import Drive, Film, Simulator, root

THINNED_SAMPLES, COARSEST = 6_000, 16.0  # left of all records; of a period of the fastest mode or input, at least
_ENOUGH = 5_000  # samples from which no further record is needed to recognise a promising start
STEPS = 4  # steps a thinned sample of a linear core, at most
FEWEST_FOLDS = 4  # with fewer records each is cut into blocks
_MOST_FOLDS = 6  # each fold is another refit of every hypothesis
_AROUND = 1e-3  # of the force's energy: outside of the band that was excited


@dataclass(frozen=True)
class Series:
    """A thinned record in the model's scaled units.

    Attributes:
        record: as given.
        output: scaled X as measured, nan where missing, shape (T,).
        counts: True for samples that count, shape (T,).
        span: peak to peak of the measurement, scaled.
        begins: rest, held or moving; the initial state of the last two is estimated.
        noise: scaled standard deviation of the sensor's noise (fifth differences), of one thinned sample.
        zero, direction: measured = direction * (scale X) + zero.
    """

    record: Record
    output: np.ndarray
    counts: np.ndarray
    span: float
    begins: str
    noise: float
    zero: float
    direction: float


@dataclass(frozen=True)
class Case:
    """A nominal model with thinned records, their simulator, and the folds for cross-validation.

    Attributes:
        model: the nominal.
        series: thinned, in the order given.
        simulator: of all of them.
        nominal: slots of the nominal, shape (slots,).
        starts: (x, v) at the first samples, shape (records, 2).
        thinned: samples of a record per thinned sample.
        folds: records left out together; with fewer than four records (or one that shows the gap), blocks of records,
            so that there are at least four.
    """

    model: Model
    series: tuple[Series, ...]
    simulator: Simulator
    nominal: np.ndarray
    starts: np.ndarray
    thinned: int
    folds: tuple[tuple[int, ...], ...]

    @property
    def dt(self) -> float:
        """Return the time between thinned samples, s."""
        return self.simulator.drives[0].dt

    @property
    def blocks(self) -> int:
        """Return the number of blocks that each record is cut into for cross-validation; 1: it is left out whole."""
        return sum(0 in fold for fold in self.folds)

    def masks(self, fold: int | None) -> list[np.ndarray]:
        """Return weights 0 or 1 of the samples that a fit without this fold uses; None: all valid samples."""
        rows = [s.counts.astype(float) for s in self.series]
        if fold is not None:
            for k in self.folds[fold]:
                rows[k][self._fold_slice(fold, k, len(rows[k]) // 100)] = 0.0
        return rows

    def _fold_slice(self, fold: int, record: int, margin: int = 0) -> slice:
        """Return the slice of a record's samples that a fold leaves out."""
        size, block = len(self.series[record].output), fold % self.blocks
        first, last = block * size // self.blocks, (block + 1) * size // self.blocks
        return slice(max(first - margin, 0), last + margin)

    def alone(self, places: Sequence[int]) -> "Case":
        """Return the case with only the records of these indices."""
        series = tuple(self.series[k] for k in places)
        simulator = replace(self.simulator, drives=tuple(self.simulator.drives[k] for k in places))
        return replace(self, series=series, simulator=simulator, starts=self.starts[[*places]], folds=_folds(series))

    def in_parts(self) -> "Case":
        """Return the case with folds that leave out a quarter of every record, as of a single one."""
        return replace(self, folds=(tuple(range(len(self.series))),) * FEWEST_FOLDS)

    def screened(self) -> list[np.ndarray]:
        """Return weights 0 or 1 of the samples for the first steps of a fit: `_ENOUGH` of the largest motions."""
        rows = [s.counts.astype(float) for s in self.series]
        kept = 0
        for k in np.argsort([-s.span for s in self.series], kind="stable"):
            if kept >= _ENOUGH:
                rows[k] = np.zeros_like(rows[k])
            kept += int(rows[k].sum())
        return rows

    def tested(self, fold: int) -> list[np.ndarray]:
        """Return, for every record, the mask of the samples on which a fold is scored."""
        rows = [np.zeros(len(s.output), bool) for s in self.series]
        for k in self.folds[fold]:
            place = self._fold_slice(fold, k)
            rows[k][place] = self.series[k].counts[place]
        return rows


def build_case(model: Model, records: Sequence[Record], *, whole: bool = False) -> Case:
    """Thin the records, remove their offsets and directions, and estimate their initial states.

    Args:
        model: the nominal.
        records: whole recordings.
        whole: keep every sample.

    Raises:
        BadInput: a nominal that diverges on a record.
    """
    model, dt = at_rate(model, records[0].dt), records[0].dt
    # an input held between samples is held at this rate: half a sample of it belongs to the delay
    model = replace(model, domain=replace(model.domain, dt=dt))
    # a single record has no earlier one
    known = len(records) > 1 and session_clock(records)
    _, _, begun = begin(model, records, known)
    for r, p in zip(records, predict(model, records), strict=True):
        if p.diverged and model.physical_coefficients[0] > 0:
            raise BadInput(f"the nominal model diverges on {r.name}, so it cannot be diagnosed; identify it again")
    nominal, others = slots_of(model)
    turned = [aligned(r, b, model.output) for r, b in zip(records, begun, strict=True)]
    fastest = _fastest(model, nominal, turned)
    k = 1 if whole else thinning(fastest, turned)
    # lines between samples lose a fraction (pi f dt)^2 / 3 of a band-limited input: 1.3 % at COARSEST
    held = model.hold == "zoh"
    smooth = model.hold == "bandlimited" and COARSEST * fastest * dt > 1
    scale, square = float(model.scales.state[0]), model.input_map.name == "square"
    drives, series, starts = [], [], []
    far = reaches(model, turned) if known else [0.0] * len(turned)  # earlier stretch remains
    for r, b, reached in zip(turned, begun, far, strict=True):
        rest = b.begins == "rest"
        first_node = r.dt * (k // 2 - samples_before(k, rest))  # s after the first sample
        start = np.full((1, model.order), float(not rest))
        voltage = film_of(replace(model, effects=()), r.voltage[None], r.dt, start)[0]  # behind the electrode's lag
        film = _film(voltage, r.dt, k, held, square, rest, first_node) if k > 1 else None
        force = ramped(voltage, linear=not held and not smooth) if square else voltage
        x = centred_means(model.output.to_model(r.displacement) / scale, k, rest)
        if film is not None:
            force = film.force(np.arange(len(x)) * r.dt * k)
        volts = root(force) if square else force
        seen = np.asarray(np.isfinite(x))
        age = model.domain.age(r.time[0]) if known else 0.0
        # of the first thinned sample, which may precede the record
        age = max(age + first_node, 0.0)
        # a mean of several samples, because a single one has the full noise
        first = x[seen][: max(1, min(5, len(x) // 100))].mean()
        starts.append((0.0, 0.0) if rest else (first, 0.0))
        jump = -r.dt / 2 if held else 0.0
        drives.append(Drive(volts, r.dt * k, starts[-1], age, 0.0 if rest else None, jump, film, float(reached)))
        noise = float(noise_std(r.displacement)) / scale / np.sqrt(k)
        series.append(Series(r, x, seen, float(np.nanmax(x) - np.nanmin(x)), b.begins, noise, b.zero, b.direction))
    run = replace(model, hold="bandlimited" if smooth else "foh")  # a held input's half sample is a delay
    simulator = Simulator(tuple(drives), run, others, nominal, steps_a_sample(model, others, dt * k))
    return Case(model, tuple(series), simulator, nominal, np.array(starts), k, _folds(series))


def _film(voltage: np.ndarray, dt: float, k: int, held: bool, square: bool, rest: bool, first: float) -> Film:
    """Integrate the drive term (V^2 or V) over time, exactly for a voltage constant or linear between samples."""
    a, b = voltage[:-1], voltage[1:]
    force = voltage * np.abs(voltage) if square else voltage
    ramp = np.sign(a + b) * (a * a + a * b + b * b) / 3 if square else (a + b) / 2
    impulse = np.append(0.0, np.cumsum(force[:-1] if held else ramp) * dt)
    late = dt / 2 if held else 0.0  # a held input's half sample is part of the nominal's delay
    return Film(impulse, dt, -first - late, k * dt, (0.0 if rest else float(force[0]), float(force[-1])))


def ramped(voltage: np.ndarray, linear: bool) -> np.ndarray:
    """Return V|V|, for a `linear` V such that straight lines between samples have the same area as its square.

    A ramp from a to b has the mean square (a^2 + a b + b^2) / 3, a straight line (a^2 + b^2) / 2: (b - a)^2 / 6 more.
    It is subtracted from the larger end. Otherwise a step within a record would come a sixth of a sample early.
    """
    force = voltage * np.abs(voltage)
    if not linear:
        return force
    # the larger end, because the smaller may be zero, and a negative force would be a pull
    rise, larger = np.diff(voltage) ** 2 / 6, np.abs(voltage[1:]) >= np.abs(voltage[:-1])
    size = np.abs(force)
    size[1:] -= rise * larger
    size[:-1] -= rise * ~larger
    return np.sign(force) * np.maximum(size, 0.0)


def _omega(slots: np.ndarray) -> float:
    """Return the natural frequency of an oscillating linear core, rad/s; 0 if it does not oscillate."""
    a0, a1, a2 = (slots[INDEX[k]] for k in CORE)
    return float(np.sqrt(a0 / a2)) if a2 > 0 and a1 < 2 * np.sqrt(a0 * a2) else 0.0


def steps_a_sample(model: Model, others: Model | None, dt: float) -> int:
    """Return the number of steps per thinned sample of `dt` (s): those of the nominal, which its training knew.

    A linear core takes no more than `STEPS`, or than its poles need.
    """
    own = at_rate(model, dt).substeps
    return own if others is not None else min(own, max(STEPS, substeps(model.physical_coefficients, dt)))


def _fastest(model: Model, nominal: np.ndarray, records: Sequence[Record]) -> float:
    """Return the fastest motion that the records show, or the nominal's mode if it is near it, Hz."""
    forces = [model.input_map.force(r.voltage) for r in records]
    return fastest_hz(records, forces, np.array([_omega(nominal) / (2 * np.pi)]))


def thinning(fastest: float, records: Sequence[Record]) -> int:
    """Return how many samples to average into one: `THINNED_SAMPLES` remain, or `COARSEST` a period of the fastest."""
    coarsest, wanted = 1 / (COARSEST * fastest * records[0].dt), sum(r.samples for r in records) / THINNED_SAMPLES
    return max(int(min(coarsest, wanted)), 1)


def _parts(records: int) -> int:
    """Return the number of parts that each of so many records is cut into, so that there are enough folds."""
    return -(-FEWEST_FOLDS // records)


def _folds(series: Sequence[Series]) -> tuple[tuple[int, ...], ...]:
    """Return, for each fold, the indices of the records left out: at most six groups, or parts of few records."""
    if len(series) < FEWEST_FOLDS:
        return tuple((k,) for k in range(len(series)) for _ in range(_parts(len(series))))
    # every group then has small and large motions
    order = np.argsort([s.span for s in series], kind="stable")
    groups = min(len(series), _MOST_FOLDS)
    return tuple(tuple(int(k) for k in order[g::groups]) for g in range(groups))


def excited_hz(case: Case) -> tuple[float, float]:
    """Return the band (Hz) with 99.9 % of the drive term's energy, and equal remainders on both sides."""
    forces = [case.simulator.signed_force(d.voltage) for d in case.simulator.drives]
    ends = [force_band(forces, case.dt, share) for share in (_AROUND / 2, 1 - _AROUND / 2)]
    return ends[0], ends[1]


def excitations(case: Case) -> int:
    """Count the distinct excitations: sixths of records whose inputs differ by 15 % in spread or frequency."""
    rows = []
    for d in case.simulator.drives:
        for part in np.array_split(d.voltage[2:], 6):  # the first two may be the rest before a jump
            w = case.model.input_map.force(part)
            spread, speed = np.std(w), np.std(np.diff(w)) / d.dt
            rows.append((spread, speed / (spread + 1e-300)))
    rows = np.array(rows)
    top, seen = rows[:, 0].max(), []
    for spread, speed in rows[rows[:, 0] > 0.05 * top]:
        near = (abs(spread - a) < 0.15 * top and abs(speed - b) < 0.15 * max(speed, b) for a, b in seen)
        if not any(near):
            seen.append((spread, speed))
    return len(seen)
