"""The catalogue: every effect that a diagnosis may report, as table entries, in the order in which they act.

A new effect is one row in the file of its port; a new kind of memory needs one kernel as well. Velocity and friction
act on the sum of all forces before them.
"""

from ...common.errors import BadInput
from .coupling import COUPLING
from .dissipation import LOSSES
from .drive import DRIVE
from .effect import Effect
from .inertia import LIMITS, MASSES
from .memory import MEMORIES, STICKING
from .sensor import SENSOR
from .spec import EffectSpec
from .stiffness import SPRINGS

CATALOGUE: tuple[EffectSpec, ...] = (
    *SPRINGS, *MEMORIES, *MASSES, *LOSSES, *STICKING, *LIMITS, *DRIVE, *COUPLING, *SENSOR,
)  # fmt: skip


def lookup(name: str, form: str | None = None) -> EffectSpec:
    """Return the catalogue entry of an effect's name and form; without a form, the first one of this name.

    Raises:
        BadInput: it does not exist; the message lists all.
    """
    forms = [r for r in CATALOGUE if r.name == name]
    if not forms:
        names = ", ".join(dict.fromkeys(r.name for r in CATALOGUE))
        raise BadInput(f"unknown effect {name!r}; the effects are {names}")
    chosen = [r for r in forms if form in (None, r.form)]
    if not chosen:
        raise BadInput(f"{name} has no form {form!r}; its forms are {', '.join(r.form for r in forms)}")
    return chosen[0]


def effect(name: str, *, form: str | None = None, **numbers) -> Effect:
    """Build an effect with these parameters, in the model's scaled coordinates.

    Args:
        name, form: as in the catalogue; default: the effect's first form.
        numbers: every parameter of the form by its name.

    Raises:
        BadInput: the name, the form or a number is not in the catalogue, or a number is missing.

    Examples:
        >>> effect("delay", time=7.5e-3).name
        'delay'
    """
    spec = lookup(name, form)
    wanted = [p.name for p in spec.parameters]
    if set(numbers) != set(wanted):
        raise BadInput(f"{spec.key} has the parameters {', '.join(wanted)}; given: {', '.join(numbers) or 'none'}")
    return spec(*(numbers[k] for k in wanted))
