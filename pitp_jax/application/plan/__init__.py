"""Propose the recordings to take, from the limits of the rig and what is known about the actuator.

    limits (voltage, slew, displacement, band) -> inputs      growth, sweep, a space-filling set, repeats
    trained model + its records -> Fisher information of free runs -> inputs that lower the expected error most

Verb: `plan`. `limits` holds the limits of every input, `drives` converts points to voltages, `first_session` orders
them, `strokes` predicts the stroke of an input, `expected_error` estimates the information in recordings, and
`next_recordings` chooses them by it.
"""

from . import excitation as excitation
