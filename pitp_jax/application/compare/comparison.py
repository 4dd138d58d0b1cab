"""Compare two models or two sets of recordings."""

from collections.abc import Sequence
from os import PathLike

from ...common.errors import BadInput
from ...method.model.fitted import Fitted, fitted_of
from ...method.model.model import Model
from ...method.signal.record import Record
from .models import compare_models
from .records import compare_records
from .result import Comparison


def compare(a, b, *, names: tuple[str, str] = ("A", "B")) -> Comparison:
    """Compare two models or two sets of recordings.

    Args:
        a, b: two models (or results that hold a `.model`, as a diagnosis does), or two sequences of records, whose
            recordings are paired by their commands.
        names: of the two.

    Returns:
        every quantity of both (models: coefficients, resonances, free runs; recordings: delay, size and shape of the
        motion) with the 95 % interval of its difference, and whether it differs.

    Raises:
        BadInput: two things of different kinds, or of a kind that cannot be compared.

    Examples:
        >>> pitp.compare(model, model).different
        ()
    """
    kinds = [_kind(one) for one in (a, b)]
    if kinds[0] != kinds[1]:
        raise BadInput(f"{names[0]} is {kinds[0]}, {names[1]} {kinds[1]}; give two of the same kind")
    if kinds[0] == "a model":
        return compare_models(fitted_of(a), fitted_of(b), names)
    return compare_records(list(a), list(b), names)


def _kind(one) -> str:
    if isinstance(one, Model | Fitted) or isinstance(getattr(one, "model", None), Model | Fitted):
        return "a model"
    if isinstance(one, Sequence) and len(one) and all(isinstance(r, Record) for r in one):
        return "a set of recordings"
    # a path is what a user of the command line would give
    hint = "; give pitp.load(FILE) or pitp.read(PATH)" if isinstance(one, (str, PathLike)) else ""
    raise BadInput(f"a {type(one).__name__} cannot be compared{hint}; give models or lists of records")
