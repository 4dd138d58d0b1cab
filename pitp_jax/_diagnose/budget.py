"""Computing time: a diagnosis that runs out of it tells the best so far, and what it did not try."""

import time
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Budget:
    """Seconds from now on, the simulated steps so far, and what was not reached.

    Attributes:
        seconds: of wall time; infinite: no limit.
        lane_steps: samples x steps a sample x simulations so far.
        skipped: in plain words, in order.
        stopped: nothing more is allowed, whatever time is left.
    """

    seconds: float = np.inf
    lane_steps: int = 0
    skipped: list[str] = field(default_factory=list)
    stopped: bool = False
    began: float = field(default_factory=time.monotonic)

    def count(self, lane_steps: int) -> None:
        """Add simulated steps."""
        self.lane_steps += lane_steps

    def stop(self, what: str) -> None:
        """Allow nothing any more, and note what was not tried."""
        self.stopped = True
        self.skipped += [what]

    @property
    def remaining(self) -> float:
        """Seconds, below zero where it ran over."""
        if self.stopped:
            return 0.0
        return self.seconds - (time.monotonic() - self.began)

    def allows(self, what: str, needed: float = 0.0) -> bool:
        """Whether so many seconds are left for `what`, which else is noted as not tried."""
        if self.remaining > needed:
            return True
        self.skipped += [what] if what not in self.skipped else []
        return False

    def notes(self) -> tuple[str, ...]:
        """One line, where anything was skipped."""
        if not self.skipped:
            return ()
        after = "" if np.isinf(self.seconds) else f" after {self.seconds:.3g} s (--seconds)"
        return (f"stopped{after}, not tried: {', '.join(self.skipped)}",)
