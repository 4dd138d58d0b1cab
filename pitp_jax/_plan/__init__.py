"""Plan: proposes the recordings to take, from the limits of the rig and what is known of the actuator.

    limits (voltage, slew, displacement, band) -> drives      growth, sweep, a space-filling set, repeats
    trained model + its records -> Fisher information of free runs -> those that lower the expected error most

Verb: `plan`. `limits` says what every drive keeps, `drives` how points become voltages, `first_session` their order,
`strokes` how far a drive goes,
`expected_error` and `information` what recordings tell of a model, `page` what each is for.
"""

from .planning import Plan as Plan
from .planning import plan as plan
from .strokes import scaled_to_limits as scaled_to_limits
from .strokes import strokes as strokes
