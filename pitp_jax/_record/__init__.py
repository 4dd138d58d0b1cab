"""Read files into checked recordings in V, m and s (or V and V), as NumPy float64.

Verbs: `read` (files and folders to records), `read_target` (a wanted motion), `read_voltage` (an input alone). A record
is one excitation of one actuator, sampled uniformly; missing output samples are nan. `preprocess` filters and
differentiates it (paper, eqs. 8 and 9), `initial_state` estimates its initial state, `excitation` makes the inputs of
the paper's protocol, and `writing` writes files completely or not at all.
"""

from . import excitation as excitation
from .reading import Target as Target
from .reading import read as read
from .reading import read_target as read_target
from .record import Record as Record
from .voltage_file import Drive as Drive
from .voltage_file import read_voltage as read_voltage
