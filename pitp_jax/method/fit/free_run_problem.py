"""Fit simulations to records as one least-squares problem, on all cores or all devices.

    r = [ sqrt(w) (x - x_measured) at every `every`-th sample of every run,  sqrt(rho) (p - p_0),  slow balance ]

A scan over a batch of runs keeps one core busy: on a CPU the batches are cut into parts, a thread to a core. With a
mesh every device has its own runs; their derivatives stay there, and only sums of P and P^2 numbers are transferred.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array

from ..model.model import Model
from ..simulate.compiled.kernel import cores
from ..simulate.devices import over_records, spread
from .forward_sensitivity import Runs, run_errors, run_slopes
from .lower_bound import UNBOUNDED, LowerBound
from .parameters import with_parameters

# runs at once on a core: fewer wait for kernels to start, more wait for memory
_FEWEST_RUNS, _MOST_RUNS = 4, 128


class _OverRuns(eqx.Module):
    """A function of (model, runs, dt, every) with dt and every fixed, as `over_records` needs it."""

    function: Callable = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    every: int = eqx.field(static=True)

    def __call__(self, model, runs):
        """Call the function with the simulations of one device."""
        return self.function(model, runs, self.dt, self.every)


@runtime_checkable
class Rows(Protocol):
    """Further residuals of a model, beside those of its simulations, shape (rows,)."""

    def errors(self, model: Model) -> np.ndarray:
        """Return the residuals."""
        ...

    def slopes(self, model: Model, count: int) -> np.ndarray:
        """Return their derivatives by `count` trained parameters, shape (rows, count)."""
        ...


class FreeRuns:
    """Residuals and derivatives of batches of simulations, as blocks for `minimise.accelerated`.

    Args:
        model: its trained parameters are fitted.
        batches: runs to be fitted, each batch of one length.
        dt: sampling interval, s.
        every: the error is taken at every `every`-th sample.
        prior: rho and p_0 per trained parameter.
        bound: of the trained parameters; the optimiser sees its coordinates.
        slow: residuals to be fitted as well, as the slow balance of a training.
        mesh: devices that share every batch; default one device, or all cores of a CPU.
    """

    def __init__(
        self,
        model: Model,
        batches: Sequence[Runs],
        dt: float,
        every: int,
        *,
        prior: tuple[np.ndarray, np.ndarray],
        bound: LowerBound = UNBOUNDED,
        slow: Rows | None = None,
        mesh: Mesh | None = None,
    ):
        self._model, self._how, self._slow, self._mesh = model, (dt, every), slow, mesh
        self._root, self._centre = np.sqrt(prior[0]), prior[1]  # sqrt(rho): the prior is one more block of residuals
        self.bound = bound
        if mesh is None:
            self._parts = [part for runs in batches for part in runs.parts(_parts_of(len(runs.start)))]
        else:
            self._parts = [spread(runs.filled(len(mesh.local_devices)), mesh) for runs in batches]

    def errors(self, vector: np.ndarray) -> list[np.ndarray]:
        """Compute all residuals at these coordinates, in blocks."""
        here = with_parameters(self._model, self.bound.parameters(vector))
        runs = [np.asarray(e) for e in self._each(run_errors, here)]
        slow = [] if self._slow is None else [self._slow.errors(here)]
        return [*runs, self._root * (vector - self._centre), *slow]

    def miss(self, vector: np.ndarray) -> float:
        """Compute the rms simulation error of trained parameters, % of range, without the prior; infinite: diverged."""
        inside = self.bound.parameters(self.bound.coordinates(vector))
        runs = self._each(run_errors, with_parameters(self._model, inside))
        rms = float(np.sqrt(sum(np.sum(np.square(np.asarray(e, np.float64))) for e in runs)))
        return rms if np.isfinite(rms) else np.inf  # nan would win or lose an argmin at random

    def slopes(self, vector: np.ndarray) -> list[Array | np.ndarray]:
        """Compute the derivatives of all residuals with respect to the coordinates (last axis)."""
        here = with_parameters(self._model, self.bound.parameters(vector))
        runs = self._each(run_slopes, here)
        slow = [] if self._slow is None else [self._slow.slopes(here, len(vector))]
        if ((by := self.bound.slopes(vector)) < 1).any():
            runs, slow = [b * by for b in runs], [b * by for b in slow]
        return [*runs, np.diag(self._root), *slow]

    def _each(self, function: Callable, here: Model) -> list[Array]:
        if self._mesh is not None:
            shared = _OverRuns(function, *self._how)
            return [over_records(shared, self._mesh, here, (part,)) for part in self._parts]
        if len(self._parts) == 1:
            return [function(here, self._parts[0], *self._how)]
        # threads instead of processes: XLA releases the interpreter while it runs, and arrays need no copy
        with ThreadPoolExecutor(cores()) as pool:
            return list(pool.map(lambda part: function(here, part, *self._how), self._parts))


def _parts_of(runs: int) -> int:
    """Return the number of parts that so many simulations are cut into; 1 on a GPU."""
    if jax.default_backend() != "cpu":
        return 1
    return max(min(cores(), runs // _FEWEST_RUNS), -(-runs // _MOST_RUNS), 1)
