"""The one kind of model that is identified, trained, rolled out, inverted, diagnosed, saved: frozen pytrees.

    F = sigma_off + sum_i sigma_i(S, m) x^(i),    F = map(V),  V = drive(u),    S = [x, ..., x^(n-1)]  (paper, eqs. 2-7)

Parts: encoder (what the model sees to tokens), memory (what it sees beside S), input map (u^2 or u), drive (the
electrodes), output (the sensor's zero and direction), domain (what it was shown) and the effects of `_effects`. A
`Fitted` is a model beside its origin.
"""

from .fitted import Fitted as Fitted
from .fitted import Origin as Origin
from .model import Model as Model
