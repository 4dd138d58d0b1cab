"""Diagnosis: a model and real records in; where they disagree, which effect is missing, how far it closes the gap.

    sum_i a_i x^(i) = coupling(V, x) - f_effect(x, x', states),   fitted on some excitations, judged on the others

Verb: `diagnose`. The way: noise floor -> where -> screening of every form -> fits on whole rollouts -> ranking on held
out excitations -> pairs -> verdict; `report/` draws and words the result.
"""

from .diagnosis import Diagnosis as Diagnosis
from .diagnosis import diagnose as diagnose
