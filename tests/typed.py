"""For the type checker: what a test knows of a value and its declared type does not."""

from typing import Any, TypeVar

_T = TypeVar("_T")


def some(value: _T | None) -> _T:
    """The value, which is there."""
    assert value is not None
    return value


def of_kind(kind: type[_T], value: object) -> _T:
    """The value, which is of that class."""
    assert isinstance(value, kind)
    return value


def untyped(value: object) -> Any:
    """The value, for attributes that its stub does not declare."""
    return value
