"""Diagnose a robot against its simulator: find the parameters that the simulator lacks, from recordings of both.

    SIM -> identify -> diagnose on SIM -> nominal with the simulator's own effects -> diagnose on the robot's records

Verb: `diagnose`, which with a model is that of `_diagnose` and with `against=` this one.
"""

from .entry import diagnose as diagnose
from .result import SimToReal as SimToReal
