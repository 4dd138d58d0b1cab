"""Simulate virtual actuators whose known equations differ from the model's: membrane, relaxation, Maxwell stress.

Verbs: `plant` (one of the paper's four), `record` (an excitation measured on it), `simulate`, `stepper`.
"""
