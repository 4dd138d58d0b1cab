"""Identify a step without tracing it, if functions and classes of this package alone determine its program.

    identity = names of functions and classes, sizes of arrays, static values; the package's sources, versions of JAX

A function or a class from elsewhere, such as a user's encoder, has no identity, because its body may change.
"""

import hashlib
import sys
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

_PACKAGE = __name__.partition(".")[0]


def identity(step: Any) -> str | None:
    """Return a text that is equal for equal programs; None where it is unknown."""
    try:
        return f"{_sources()} {_description(step)}"
    except (LookupError, OSError):
        return None


def _description(value: Any) -> Any:
    """Return plain values that determine a part of a step; `LookupError` where they are unknown."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return repr(value)
    if isinstance(value, (tuple, list)):
        return [type(value).__name__, *map(_description, value)]
    if isinstance(value, jax.ShapeDtypeStruct):
        return "array", value.shape
    kind = value if callable(value) and hasattr(value, "__qualname__") else type(value)
    home = kind.__module__.partition(".")[0]
    if home not in (_PACKAGE, "equinox") or getattr(sys.modules[kind.__module__], kind.__qualname__, None) is not kind:
        raise LookupError(kind)
    name = kind.__module__, kind.__qualname__
    if kind is value:
        return name
    part: Any = value
    if isinstance(getattr(part, "tree", None), jax.tree_util.PyTreeDef):
        return name, _description(jax.tree.unflatten(part.tree, part.leaves))
    if not is_dataclass(value):
        raise LookupError(kind)
    return name, [_description(getattr(value, field.name)) for field in fields(value)]


@lru_cache(1)
def _sources() -> str:
    """Return a hash of the package's methods and the versions of the libraries that trace them."""
    texts = sorted(Path(__file__).parents[2].rglob("*.py"))
    if not texts:
        raise LookupError("no sources")
    versions = f"{jax.__version__} {eqx.__version__} {np.__version__}"
    return hashlib.sha256(b"\0".join([versions.encode(), *(path.read_bytes() for path in texts)])).hexdigest()
