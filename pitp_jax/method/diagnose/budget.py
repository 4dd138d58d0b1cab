"""The wall time of a diagnosis, if the user limits it, and its progress.

Nothing else ends a search, so the answer is the same on every computer. If the time ends it, this is reported with the
best answer so far.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

_EVERY_S = 5.0  # between lines of progress


@dataclass
class Budget:
    """The time and step limits of a diagnosis, the steps simulated so far, and the work that was skipped.

    Attributes:
        seconds: of wall time; infinite: no limit.
        reserve: s of these, reserved for the steps after the search.
        simulated_steps: samples x steps a sample x simulations so far.
        run_steps: samples x steps a sample of one run of all records.
        stage: the current stage, in words.
        progress: called with a line when a stage begins, and every few seconds within it.
        skipped: skipped steps in plain words, in order.
        stopped: no further step is allowed.
    """

    seconds: float = np.inf
    reserve: float = 0.0
    simulated_steps: int = 0
    run_steps: int = 0
    stage: str = "fitting"
    progress: Callable[[str], None] = lambda line: None
    skipped: list[str] = field(default_factory=list)
    stopped: bool = False
    began: float = field(default_factory=time.monotonic)
    _reported: float = 0.0  # s since `began`, of the last line

    def count(self, steps: int) -> None:
        """Add simulated steps to the count, and report progress every few seconds."""
        self.simulated_steps += steps
        elapsed = self.elapsed
        if elapsed - self._reported >= _EVERY_S:
            self._reported = elapsed
            # the depth of a search is known only at its end, so no remaining time is printed
            of = f" of at most {self.seconds:.0f} s" if np.isfinite(self.seconds) else " s"
            self.progress(f"{self.stage}: {elapsed:.0f}{of} elapsed")

    def begin(self, stage: str) -> None:
        """Report the start of a part of the diagnosis, such as the search of sets of two effects."""
        self.stage = stage
        self.progress(stage)

    @property
    def elapsed(self) -> float:
        """Return the wall time since the start, s."""
        return time.monotonic() - self.began

    @contextmanager
    def keeping(self, steps: int) -> Iterator[None]:
        """Reserve time for the work that follows a `with` block, of so many simulated steps."""
        seconds = min(steps * self.elapsed / max(self.simulated_steps, 1), (self.seconds - self.reserve) / 4)
        before = self.reserve
        self.reserve += seconds if np.isfinite(self.seconds) else 0.0
        try:
            yield
        finally:
            self.reserve = before

    def stop(self, what: str) -> None:
        """Stop all further work, and note the work that was skipped."""
        self.stopped = True
        self.skipped += [what]

    @property
    def remaining(self) -> float:
        """Return the remaining wall time, s; negative beyond the limit."""
        if self.stopped:
            return 0.0
        return self.seconds - self.elapsed

    @property
    def spent(self) -> bool:
        """Return whether the time of a search is used up."""
        return self.stopped or self.remaining <= self.reserve

    def allows(self, what: str) -> bool:
        """Return whether time of the search remains; otherwise note `what` as not tried."""
        if not self.spent:
            return True
        self.skipped += [what] if what not in self.skipped else []
        return False

    def notes(self) -> tuple[str, ...]:
        """Return one line on the skipped work; empty if nothing was skipped."""
        if not self.skipped:
            return ()
        after = "" if np.isinf(self.seconds) else f" after {self.seconds:.3g} s (--seconds)"
        return (f"The search stopped{after} and did not try: {', '.join(self.skipped)}",)
