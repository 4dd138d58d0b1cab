"""Identification: records in, a linear model of the smallest sufficient order out.

    sum_i a_i x^(i) = u^2 (or u),    min over a, zeros and starts of  sum (y - x)^2     (output error; paper: tfest)

Verb: `identify`. Poles are stable by construction (`linear_ode`), starts come from the equation error and the spectrum
(`initial_guess`), the order from what the records can tell apart (`order_selection`).
"""

from .identification import Identification as Identification
from .identification import identify as identify
