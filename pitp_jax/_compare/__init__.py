"""Compare two models, two diagnoses or two sets of recordings, and report what differs beyond its confidence interval.

    differs:  |b - a| > 1.96 sqrt(s_a^2 + s_b^2)

Verb: `compare`. Recordings are paired by their commands, and by their responses where commands repeat (`pairing`).
"""

from .comparison import compare as compare
from .pairing import Pair as Pair
from .pairing import Pairing as Pairing
from .pairing import pair_records as pair_records
from .result import Comparison as Comparison
from .result import Difference as Difference
