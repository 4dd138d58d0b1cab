"""Split the scalar program of a step: what depends on the parameters alone, and what changes with time.

once a run:         f(p)            before the loop over time
every time step:    g(p, s, u)      inside; states that no output depends on are dropped
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import numpy as np

from ...numerics.scalar.jaxpr import program
from ...numerics.scalar.scalars import Node, Program


@dataclass(frozen=True, eq=False)
class Split:
    """A step as scalar operations.

    Attributes:
        sizes: numbers of parameters, states and inputs, which are the program's inputs in this order.
        states: places of the states that outputs depend on.
        next, outputs: nodes or numbers, of these states after the step, and of the outputs.
        once, always: nodes in the order in which they can be written.
    """

    sizes: tuple[int, int, int]
    states: tuple[int, ...]
    next: tuple
    outputs: tuple
    once: tuple[Node, ...]
    always: tuple[Node, ...]


def split(step: Callable, parameters: int, states: int, inputs: tuple[int, ...]) -> Split:
    """Trace a step of one run and split its operations; call it under `jax.enable_x64(True)`.

    `inputs`: shape of the input of one time step, () or (k,).

    Raises:
        BadInput: the step contains an operation that has no scalar form.
    """
    # abstract shapes, because an array would start JAX's device
    shapes = [jax.ShapeDtypeStruct(shape, np.float64) for shape in ((parameters,), (states,), inputs)]
    whole = program(step, *shapes, still=parameters)
    after, outputs = whole.outputs[:states], whole.outputs[states:]
    first, last = parameters, parameters + states

    def reads(targets: Sequence) -> set[int]:
        places = {n.args[0] for n in Program(0, tuple(targets)).nodes() if n.op == "input"}
        return {k - first for k in places if first <= k < last}

    needed: set[int] = set()
    closure = reads(outputs)
    while closure != needed:
        needed, closure = closure, closure | reads([after[k] for k in closure])
    kept = tuple(sorted(needed))
    following = tuple(after[k] for k in kept)
    changes: dict[Node, bool] = {}
    for n in Program(0, (*following, *outputs)).nodes():
        arguments = [a for a in n.args if isinstance(a, Node)]
        changes[n] = n.args[0] >= first if n.op == "input" else any(changes[a] for a in arguments)
    once, always = (tuple(n for n in changes if changes[n] is late) for late in (False, True))
    sizes = parameters, states, int(np.prod(inputs))
    return Split(sizes, kept, following, outputs, once, always)
