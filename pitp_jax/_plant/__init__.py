"""Simulate virtual actuators whose known equations differ from the model's: membrane, relaxation, Maxwell stress.

Verbs: `plant` (one of the paper's four), `record` (an excitation measured on it), `simulate`, `stepper`.
"""

from .virtual_actuator import plant as plant
from .virtual_actuator import record as record
from .virtual_actuator import simulate as simulate
from .virtual_actuator import stepper as stepper
