"""A robot beside its simulator: two sets of records in; what the simulator lacks, as numbers to type into it, out.

    SIM -> identify -> diagnose on SIM -> nominal with the simulator's own effects -> diagnose on the robot's records

Verb: `diagnose`, which with a model is that of `_diagnose` and with `against=` this one.
"""

from .entry import diagnose as diagnose
from .result import SimToReal as SimToReal
