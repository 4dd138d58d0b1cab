"""Run a compiled step: runs in blocks of one vector each, blocks on threads.

    block b:   runs b w ... b w + w - 1,   w = 8 or 16 doubles with AVX-512, 4 or 8 with AVX2, 2 or 4 otherwise

Twice the register's width hides the latency of the arithmetic; it is used where there are more runs than one register
holds. The machine code runs without Python's lock.
"""

import ctypes
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock

import numpy as np
from jaxtyping import Float

from ....common.errors import BadInput
from ...model.programs import double_on_cpu
from . import objects
from .identity import identity
from .split import Split, split
from .vectors import text_of

_SPREAD = 100_000  # steps of all runs, from which a second thread pays
_building = Lock()


@dataclass(frozen=True)
class Kernel:
    """The machine code of one step for vectors of `width` runs; `equal`: all runs have the same parameters."""

    run: Callable
    width: int
    outputs: int
    equal: bool

    def __call__(self, parameters, start, inputs, column) -> Float[np.ndarray, "runs n o"]:
        """Compute the outputs of `free_runs`; the working memory is one copy of parameters and initial states."""
        runs, steps, columns = len(column), inputs.shape[1], inputs.reshape(len(inputs), -1)
        columns = np.ascontiguousarray(columns)
        outputs = np.empty((runs, steps, self.outputs))
        if not steps:
            return outputs
        blocks = -(-runs // self.width)
        # the last run fills the last block, and writes the same results to the same place
        fill = np.minimum(np.arange(blocks * self.width), runs - 1)
        held = np.ascontiguousarray(parameters[0]) if self.equal else self._packed(parameters, fill)
        states = self._packed(start, fill)
        places = column[fill] * columns.shape[1], fill * (steps * self.outputs)

        def part(first: int, last: int) -> None:
            size = (last - first, steps)
            here = [held if self.equal else held[first:], states[first:]]
            source, target = (p[first * self.width :] for p in places)
            self.run(*size, *(a.ctypes.data for a in (*here, source, columns, target, outputs)))

        threads = min(blocks, cores()) if runs * steps > _SPREAD else 1
        ends = np.linspace(0, blocks, threads + 1).astype(int).tolist()
        if threads == 1:
            part(0, blocks)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(part, ends[:-1], ends[1:]))
        return outputs

    def _packed(self, rows, fill) -> np.ndarray:
        """Return the numbers of all runs as [blocks][numbers][width]."""
        return np.ascontiguousarray(rows[fill].reshape(-1, self.width, rows.shape[1]).swapaxes(1, 2))


def kernel(step: Callable, parameters, start, inputs) -> Kernel | None:
    """Return the compiled step for these arguments of `free_runs`; None where it cannot be compiled."""
    if os.environ.get("PITP_COMPILED", "1") == "0":
        return None
    try:
        width = objects.widest() * (1 + (len(start) > objects.widest()))
    except Exception as error:  # of any kind: the scan gives the same answers
        _say(f"free runs are not compiled ({error}); they take longer")
        return None
    equal = bool((parameters == parameters[:1]).all())
    sizes = parameters.shape[1], start.shape[1], inputs.shape[2:]
    with _building:
        return _built(step, sizes, width, equal)


@lru_cache(256)
def _built(step: Callable, sizes: tuple, width: int, equal: bool) -> Kernel | None:
    key = identity(step)
    named = key and f"{key} {sizes} {width} {equal}"
    try:
        known = objects.look_up(named) if named else None
        if known is None:
            parts = _split(step, *sizes)
            outputs = len(parts.outputs)
            text = text_of(parts, width, equal=equal)
            known = outputs, objects.address_of(text, named=named, outputs=outputs)
    except BadInput as error:
        _say(f"a step is not compiled: {error}; its free runs take longer")
        return None
    except Exception as error:
        _say(f"a step is not compiled ({type(error).__name__}: {error}); its free runs take longer")
        return None
    outputs, address = known
    run = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 6)(address)
    return Kernel(run, width, outputs, equal)


@lru_cache(64)
def _split(step: Callable, parameters: int, states: int, inputs: tuple[int, ...]) -> Split:
    with double_on_cpu():
        return split(step, parameters, states, inputs)


def cores() -> int:
    """Return the number of cores that this process may use."""
    # a container or `taskset` may allow fewer than the machine has; macOS and Windows do not report it
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(16)
def _say(text: str) -> None:
    """Write one line on standard error, once."""
    print(f"pitp: {' '.join(text.split())}", file=sys.stderr)
