"""Export: writes a model and its inverse as C99, as an FMU and as MATLAB functions.

    make_jaxpr(one step, the model's numbers in it) -> scalar expressions -> text; templates around it

`steps` says what is written, `jaxpr` and `scalars` take it apart, `writing` writes it, `c99`, `fmu` and `matlab` frame
it; `pi_gains` tunes the controller, `differentiator` weighs a target's window. An effect stays written once, in
Python: what can be stepped can be exported.
"""

from .c99 import export_c as export_c
from .c99 import loop_text as loop_text
from .fmu import export_fmu as export_fmu
from .matlab import export_matlab as export_matlab
from .pi_gains import PIGains as PIGains
from .pi_gains import pi_gains as pi_gains
