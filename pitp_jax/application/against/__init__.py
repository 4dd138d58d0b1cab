"""Diagnose a robot against its simulator: find the parameters that the simulator lacks, from recordings of both.

    SIM -> identify -> diagnose on SIM -> nominal with the simulator's own effects -> diagnose on the robot's records

Verb: `diagnose`, which with a model is that of `method/diagnose` and with `against=` this one.
"""
