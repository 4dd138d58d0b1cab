"""Export a model and its inverse as C99, as an FMU and as MATLAB functions.

    make_jaxpr(one step, with the model's numbers) -> scalar expressions -> text; templates around it

`steps` defines the programs, `jaxpr` and `scalars` convert them to expressions, `writing` writes these as text, and
`c99`, `fmu` and `matlab` add the templates. `pi_gains` tunes the controller, `differentiator` weights a target's
window. An effect is written once, in Python: every effect that can be stepped can be exported.
"""

from .c99 import export_c as export_c
from .c99 import loop_text as loop_text
from .fmu import export_fmu as export_fmu
from .matlab import export_matlab as export_matlab
from .pi_gains import PIGains as PIGains
from .pi_gains import pi_gains as pi_gains
