"""Lanes: many parameter vectors of one composite model rolled out at once, each under its own record.

A composite carries the nominal's own effects and every form in question, neutral unless a lane's numbers say otherwise,
so all candidates (and all finite differences of each) are rows of one array under one compiled program. Time runs in
chunks of fixed length and lanes in blocks of fixed width: records of any length, candidates in any number, one
compilation. Over a mesh every device has a block of its own; no lane asks another, so nothing is communicated.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.sharding import PartitionSpec

from .._between import between
from .._decode import step
from .._effects.amplifier import Delay
from .._effects.base import AbstractEffect
from .._model import augment
from .._model.model import Model
from .case import Case

CHUNK, WIDTH, THREADS = 2000, 64, 2


@dataclass(frozen=True)
class Lane:
    """One run: parameters of all forms (in their order), factors on the nominal's coefficients, and a record."""

    values: np.ndarray
    factors: np.ndarray
    series: int


class Lanes:
    """The compiled composite of a case and a tuple of forms."""

    def __init__(self, case: Case, forms: Sequence[type[AbstractEffect]]):
        self.case, self.forms = case, tuple(forms)
        neutral = tuple(f.neutral() for f in self.forms)
        self.model = replace(case.model, effects=(*case.model.effects, *neutral))
        self.neutral = np.asarray(ravel_pytree(neutral)[0], np.float64) if forms else np.zeros(0)
        self.places, first = {}, 0
        for f in self.forms:
            self.places[f] = slice(first, first + len(f.PARAMETERS))
            first += len(f.PARAMETERS)
        advance, mesh = _chunk(case.model, neutral, case.dt), case.mesh
        if mesh is not None:
            by_lane, by_time = PartitionSpec(mesh.axis_names), PartitionSpec(None, mesh.axis_names)
            ends = (by_lane, by_lane, by_lane, by_time), (by_lane, by_time)
            advance = jax.shard_map(advance, mesh=mesh, in_specs=ends[0], out_specs=ends[1], check_vma=False)
        self._advance, self._width = jax.jit(advance), WIDTH * (1 if mesh is None else mesh.size)
        self._stages = [self._staged(s.voltage) for s in case.series]
        self._starts = [self._start(s) for s in case.series]

    def _staged(self, voltage: np.ndarray) -> np.ndarray:
        fractions = np.arange(2 * self.model.substeps + 1) / (2 * self.model.substeps)
        return between(voltage, self.model.hold, fractions, np).astype(np.float32)

    def _start(self, s) -> np.ndarray:
        x = jnp.asarray(0.0 if s.rest else s.motion[0, 0], jnp.float32)
        volts = jnp.asarray(0.0 if s.rest else s.voltage[0], jnp.float32)
        return np.concatenate([s.start, np.asarray(augment.initial(self.model, x, volts, s.age))])

    def run(self, lanes: Sequence[Lane]) -> list[np.ndarray]:
        """Scaled readings of every lane, each (T,) of its record; nan from where it left every range."""
        if not lanes:
            return []
        order = sorted(range(len(lanes)), key=lambda k: self.case.series[lanes[k].series].record.samples)
        blocks = [order[k : k + self._width] for k in range(0, len(order), self._width)]
        found: list = [None] * len(lanes)
        with ThreadPoolExecutor(THREADS if self.case.mesh is None else 1) as pool:
            for block, rows in zip(blocks, pool.map(lambda b: self._block([lanes[k] for k in b]), blocks), strict=True):
                for k, row in zip(block, rows, strict=True):
                    found[k] = row
        return found

    def _block(self, lanes: list[Lane]) -> list[np.ndarray]:
        spare = self._width - len(lanes)
        lanes = lanes + [lanes[-1]] * spare
        theta = np.stack([lane.values for lane in lanes]).astype(np.float32)
        base = np.asarray(self.model.coefficients)
        coefficients = np.stack([base * lane.factors for lane in lanes]).astype(np.float32)
        state = jnp.asarray(np.stack([self._starts[lane.series] for lane in lanes]).astype(np.float32))
        length = max(self.case.series[lane.series].record.samples for lane in lanes)
        stages = [self._lane_stages(lane) for lane in lanes]
        pieces = []
        for first in range(0, length, CHUNK):
            volts = np.stack([_piece(s, first) for s in stages], 1)
            state, y = self._advance(theta, coefficients, state, volts)
            pieces.append(np.asarray(y))
        y = np.concatenate(pieces)
        used = len(lanes) - spare
        return [y[: self.case.series[lane.series].record.samples, k] for k, lane in enumerate(lanes[:used])]

    def _lane_stages(self, lane: Lane) -> np.ndarray:
        for form in self.forms:
            if issubclass(form, Delay):
                time = float(lane.values[self.places[form]][0])
                if time > 0:
                    s = self.case.series[lane.series]
                    place = np.arange(len(s.voltage))
                    late = np.interp(
                        place - time / self.case.dt, place, s.voltage, left=0.0 if s.rest else s.voltage[0]
                    )
                    return self._staged(late)
        return self._stages[lane.series]


def _piece(stages: np.ndarray, first: int) -> np.ndarray:
    part = stages[first : first + CHUNK]
    return part if len(part) == CHUNK else np.concatenate([part, np.repeat(stages[-1:], CHUNK - len(part), 0)])


def _chunk(model: Model, forms: tuple, dt: float):
    unravel = ravel_pytree(forms)[1]

    def lane(theta, coefficients, state, stages):
        here = replace(model, effects=(*model.effects, *unravel(theta)), coefficients=coefficients)
        return step(here, state, stages, dt), augment.reading(here, state)

    def run(theta, coefficients, state, stages):
        return jax.lax.scan(lambda s, v: jax.vmap(lane)(theta, coefficients, s, v), state, stages)

    return run
