"""How arguments are checked while the tests run: by beartype, an int where a float is wanted being fine (PEP 484).

Modules with arrays are checked by jaxtyping, which takes 40 us a call; an identification makes 800,000 of them.
What it finds depends on types, shapes and dtypes alone. So a call like an earlier one, with a result like the earlier
one's, is not checked again. All other modules are checked by beartype alone.
"""

import inspect
from functools import partial, wraps
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType

import jax
import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype
from jax.core import Tracer

CONF = BeartypeConf(is_pep484_tower=True, claw_is_pep526=False)  # of variables, pyright sees the types
check = beartype(conf=CONF)


def modules(package: str) -> tuple[list[str], list[str]]:
    """List the modules of a package that handle arrays, and all others, without importing them."""
    spec = find_spec(package)
    assert spec is not None and spec.submodule_search_locations is not None
    (folder,) = map(Path, spec.submodule_search_locations)
    shaped, plain = [], []
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder.parent).with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        text = path.read_text(encoding="utf-8")
        # names that only the type checker imports are unknown to beartype alone, which no test can switch off
        by_jaxtyping = any(word in text for word in ("jaxtyping", "TYPE_CHECKING", "ndarray"))
        (shaped if by_jaxtyping else plain).append(name)
    return shaped, plain


_forms: dict[type, str] = {}


def _form(kind: type) -> str:
    if issubclass(kind, np.ndarray | jax.Array | Tracer):
        return "array"
    if kind in (str, bool, int, type(None)):
        return "value"
    return "container" if kind in (tuple, list, dict) else "type"


def told(value):
    """What a check of a value depends on: types, shapes, dtypes, and small values that a `Literal` may name.

    Raises:
        LookupError: a long container, of which beartype checks an item at random.
    """
    kind = type(value)
    form = _forms.get(kind) or _forms.setdefault(kind, _form(kind))
    if form == "array":
        return kind, value.dtype, value.shape
    if form == "value":
        return (kind, value) if kind is not int or -16 < value < 16 else kind
    if form == "container":
        if len(value) > 16:
            raise LookupError
        return (kind, *map(told, value.items() if kind is dict else value))
    return kind


_checked = jaxtyping.jaxtyped


def remembering(fn=None, *, typechecker):
    """`jaxtyping.jaxtyped` that does not check a call like an earlier one again."""
    if fn is None:
        return partial(remembering, typechecker=typechecker)
    checked = _checked(fn, typechecker=typechecker)
    if not inspect.isfunction(fn):
        return checked
    seen, given = set(), []

    def result(*_, **__):
        return given[-1]

    # the same signature and the same names, so that a result can be checked by itself
    known = FunctionType(result.__code__, fn.__globals__, fn.__name__, None, result.__closure__)
    of_result = _checked(wraps(fn)(known), typechecker=typechecker)

    @wraps(fn)
    def call(*args, **options):
        if jaxtyping.config.jaxtyping_disable:
            return fn(*args, **options)
        try:
            key = (*map(told, args), told(options) if options else None)
            is_new = key not in seen
        except (LookupError, TypeError):
            return checked(*args, **options)
        out = (checked if is_new else fn)(*args, **options)
        try:
            whole = (*key, told(out))
        except LookupError:
            whole = None
        if not is_new and whole not in seen:
            given.append(out)
            try:
                of_result(*args, **options)
            finally:
                given.pop()
        seen.update({key, whole} - {None})
        return out

    return call
