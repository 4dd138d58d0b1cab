"""A missing force without a name: products of displacement, velocity and the film's force.

    f = c1 x x' + c2 x^2 x' + c3 x' F        F the film's force (V^2 or V)

The products that a diagnosis tries, and the reason for them: docs/decisions/term.md.
"""

from .effect import Instant
from .spec import EffectSpec, signed

PRODUCTS = ("x x'", "x^2 x'", "x' F")


def _law(p, now: Instant):
    return now.v * (now.x * (p.c1 + p.c2 * now.x) + p.c3 * now.force)


TERM = EffectSpec(
    "found_term", "products",
    (
        signed("c1", "V^2 s/x^2", length=-1, speed=-1, force=1),
        signed("c2", "V^2 s/x^3", length=-2, speed=-1, force=1),
        signed("c3", "s/x", speed=-1),
    ),
    "An equation found in the data, if no effect of the catalogue fits.", "f = c1 x x' + c2 x^2 x' + c3 x' "
    "F", "found", "C",
    law=_law, driven=True,
)  # fmt: skip
