"""Lanes: many parameter vectors of composite models rolled out at once, each under its own record.

A composite carries the nominal's own effects and a group of forms, neutral unless a lane's numbers say otherwise, so
candidates (and all finite differences of each) are rows of one array under one compiled program. A lane pays for every
form of its composite: with one per name, not all names in one, a fit of 13 forms of five names took 0.12 for 0.32 us a
lane and sample (with all forms of the name, asked for or not, a diagnosis of a roll took 92 for 76 s). What was
compiled once serves all splits and fits of a nominal. Time runs in chunks of fixed length and lanes in blocks of fixed
width: records of any length, candidates in any number. Over a mesh every device has a block of its own; no lane asks
another, so nothing is communicated.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain, zip_longest

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, PartitionSpec

from .._effects import EFFECTS
from .._effects.kernels import DELAY
from .._effects.spec import EffectSpec
from .._model.model import Model
from .._model.programs import jit
from .._numerics.intersample import between
from .._simulate import ports
from .._simulate.decoder import step
from .case import Case, Series

CHUNK, WIDTH, THREADS = 2000, 32, 2
Forms = Sequence[EffectSpec]


@dataclass(frozen=True)
class Lane:
    """One run: forms with their parameters, factors on the nominal's coefficients, and a record."""

    forms: tuple[EffectSpec, ...]
    values: tuple[tuple[float, ...], ...]
    factors: np.ndarray
    series: int


class Lanes:
    """The composites of a case: one per group of forms, compiled when a lane first asks for it."""

    def __init__(self, case: Case, groups: Sequence[Forms]):
        self.case = case
        self._stages = [_staged(case, s.voltage) for s in case.series]
        self._composites = [_Composite(case, forms, self._stages) for forms in groups]

    def run(self, lanes: Sequence[Lane]) -> list[np.ndarray]:
        """Scaled readings of every lane, each (T,) of its record; nan from where it left every range.

        A lane runs in the first composite that holds all of its forms.
        """
        held: list[list[int]] = [[] for _ in self._composites]
        for k, lane in enumerate(lanes):
            held[next(i for i, c in enumerate(self._composites) if c.holds(lane.forms))].append(k)
        queues = []
        for composite, which in zip(self._composites, held, strict=True):
            which.sort(key=lambda k: -self.case.series[lanes[k].series].record.samples)
            queues.append([(composite, which[k : k + composite.width]) for k in range(0, len(which), composite.width)])
        blocks = [b for b in chain(*zip_longest(*queues)) if b]  # in turn: two threads compile two programs
        found: list = [None] * len(lanes)
        with ThreadPoolExecutor(THREADS if self.case.mesh is None else 1) as pool:
            runs = pool.map(lambda b: b[0].run([lanes[k] for k in b[1]]), blocks)
            for (_, block), rows in zip(blocks, runs, strict=True):
                for k, row in zip(block, rows, strict=True):
                    found[k] = row
        return found


class _Composite:
    """The nominal with a group of forms, in the catalogue's order: velocity and friction see all that comes before."""

    def __init__(self, case: Case, forms: Forms, stages: list[np.ndarray]):
        self.forms = tuple(f for f in EFFECTS if f in forms)
        neutral = tuple(f.neutral() for f in self.forms)
        self._case, self._stages = case, stages
        self._model = replace(case.model, effects=(*case.model.effects, *neutral))
        self._neutral = np.asarray(ravel_pytree(neutral)[0], np.float64) if forms else np.zeros(0)
        self._places, first = {}, 0
        for f in self.forms:
            self._places[f] = slice(first, first + len(f.parameters))
            first += len(f.parameters)
        self.width = WIDTH * (1 if case.mesh is None else case.mesh.size)
        self._starts = [self._start(s) for s in case.series]

    def holds(self, forms: Forms) -> bool:
        """Whether a lane with these forms can run here."""
        return set(forms) <= set(self.forms)

    def run(self, lanes: Sequence[Lane]) -> list[np.ndarray]:
        """One block, filled up to its width."""
        series = [self._case.series[lane.series] for lane in lanes]
        filled = [*lanes, *[lanes[-1]] * (self.width - len(lanes))]
        theta = np.stack([self._theta(lane) for lane in filled]).astype(np.float32)
        base = np.asarray(self._model.coefficients)
        coefficients = np.stack([base * lane.factors for lane in filled]).astype(np.float32)
        state = jnp.asarray(np.stack([self._starts[lane.series] for lane in filled]).astype(np.float32))
        stages, pieces = [self._lane_stages(lane) for lane in filled], []
        how = self._model, self.forms, self._case.mesh, self._case.dt
        for first in range(0, max(s.record.samples for s in series), CHUNK):
            volts = np.stack([_piece(s, first) for s in stages], 1)
            state, y = _advance(*how, theta, coefficients, state, volts)
            pieces.append(np.asarray(y))
        y = np.concatenate(pieces)
        return [y[: s.record.samples, k] for k, s in enumerate(series)]

    def _theta(self, lane: Lane) -> np.ndarray:
        theta = self._neutral.copy()
        for form, values in zip(lane.forms, lane.values, strict=True):
            theta[self._places[form]] = values
        return theta

    def _start(self, s: Series) -> np.ndarray:
        x = jnp.asarray(0.0 if s.rest else s.motion[0, 0], jnp.float32)
        volts = jnp.asarray(0.0 if s.rest else s.voltage[0], jnp.float32)
        return np.concatenate([s.start, np.asarray(ports.initial(self._model, x, volts, s.age, s.reached))])

    def _lane_stages(self, lane: Lane) -> np.ndarray:
        for form, values in zip(lane.forms, lane.values, strict=True):
            if form.kernel is DELAY and values[0] > 0:
                s = self._case.series[lane.series]
                place = np.arange(len(s.voltage))
                before = 0.0 if s.rest else s.voltage[0]
                return _staged(self._case, np.interp(place - values[0] / self._case.dt, place, s.voltage, left=before))
        return self._stages[lane.series]


def _staged(case: Case, voltage: np.ndarray) -> np.ndarray:
    fractions = np.arange(2 * case.model.substeps + 1) / (2 * case.model.substeps)
    return between(voltage, case.model.hold, fractions, np).astype(np.float32)


def _piece(stages: np.ndarray, first: int) -> np.ndarray:
    part = stages[first : first + CHUNK]
    return part if len(part) == CHUNK else np.concatenate([part, np.repeat(stages[-1:], CHUNK - len(part), 0)])


@jit
def _advance(model: Model, forms: Forms, mesh: Mesh | None, dt: float, theta, coefficients, state, stages):
    """States after a chunk, and (chunk, lanes) readings; the model's last effects, `forms`, have the lanes' numbers."""
    arrays, static = eqx.partition(model, eqx.is_array)

    def run(arrays, theta, coefficients, state, stages):
        model = eqx.combine(arrays, static)
        count = len(model.effects) - len(forms)
        own, unravel = model.effects[:count], ravel_pytree(model.effects[count:])[1]

        def lane(theta, coefficients, state, stages):
            here = replace(model, effects=(*own, *unravel(theta)), coefficients=coefficients)
            return step(here, state, stages, dt), ports.reading(here, state)

        return jax.lax.scan(lambda s, v: jax.vmap(lane)(theta, coefficients, s, v), state, stages)

    if mesh is not None:
        by_lane, by_time = PartitionSpec(mesh.axis_names), PartitionSpec(None, mesh.axis_names)
        ends = (PartitionSpec(), by_lane, by_lane, by_lane, by_time), (by_lane, by_time)
        run = jax.shard_map(run, mesh=mesh, in_specs=ends[0], out_specs=ends[1], check_vma=False)
    return run(arrays, theta, coefficients, state, stages)
