"""Export a model and its inverse as C99, as an FMU and as MATLAB functions.

    make_jaxpr(one step, with the model's numbers) -> scalar expressions -> text; templates around it

`steps` defines the programs, `jaxpr` and `scalars` convert them to expressions, `writing` writes these as text, and
`c99`, `fmu` and `matlab` add the templates. `pi_gains` tunes the controller, `differentiator` weights a target's
window. An effect is written once, in Python: every effect that can be stepped can be exported.
"""
