"""Convert a feedforward to the clock of a faster player, with straight lines between its samples.

No limit of range or slew is exceeded between samples. A slower player needs another target (`target.at_slower_rate`).
"""

from dataclasses import replace

import numpy as np

from ..signal.record import sampling_interval
from .feedforward_plan import Feedforward
from .target import SAME


def at_faster_rate(plan: Feedforward, rate: float | None) -> Feedforward:
    """Resample a feedforward at `rate` (Hz), if that is above its own rate; each flag is that of the sample before."""
    spacing = sampling_interval(plan.time)
    if rate is None or rate < (1 + SAME) / spacing:
        return plan
    count = int(np.ceil((plan.time[-1] - plan.time[0]) * rate * (1 - SAME))) + 1
    time = plan.time[0] + np.arange(count) / rate
    before = np.minimum((np.arange(count) / (rate * spacing) * (1 + SAME)).astype(int), len(plan.time) - 1)
    return replace(
        plan,
        time=time,
        voltage=np.interp(time, plan.time, plan.voltage),
        infeasible=plan.infeasible[before],
        saturated=plan.saturated[before],
        target=plan.target[before],
        wanted=np.interp(time, plan.time, plan.wanted),
    )
