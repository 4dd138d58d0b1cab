"""Diagnosis: finds where a model and recordings disagree, which effect is missing, and how much of the gap it closes.

    sum_i a_i x^(i) = coupling(V, x) - f_effect(x, x', states),   every set of effects judged out of fold

Verb: `diagnose`. The way: records thinned (`data`) -> a simulator in which every effect is a slot (`simulator`,
`library`) -> fits on whole free runs (`fit`) -> sets searched (`search`) beside a flexible reference (`reference`),
compared by a bootstrap (`evidence`) -> verdict (`verdict`, `rules`), the model that is handed back (`handing_back`)
with its parts (`parts`), gap (`gap`) and budget (`shares`); `report/` draws it.
"""

from .diagnosis import Diagnosis as Diagnosis
from .diagnosis import diagnose as diagnose
