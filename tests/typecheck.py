"""How arguments are checked while the tests run: by beartype, an int where a float is wanted being fine (PEP 484).

Modules with arrays are checked by jaxtyping, which takes 40 us a call; an identification makes 800,000 of them.
What it finds depends on types, shapes and dtypes alone. So a call like an earlier one, with a result like the earlier
one's, is not checked again. All other modules are checked by beartype alone.
"""

import dataclasses
import inspect
from functools import cached_property, partial, wraps
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ParamSpecArgs, ParamSpecKwargs, get_type_hints

import jax
import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype
from beartype.door import is_bearable
from jax.core import Tracer

CONF = BeartypeConf(is_pep484_tower=True, claw_is_pep526=False)  # of variables, pyright sees the types


def check(value, hint) -> bool:
    """Return whether a value is of an annotation; beartype generates one checker for all functions that use it."""
    return is_bearable(value, hint, conf=CONF)


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


def _of_array(value):
    return type(value), value.dtype, value.shape


def _of_number(value):
    return (int, value) if -16 < value < 16 else int


def _of_value(value):
    return type(value), value


def _of_container(value):
    if len(value) > 16:
        raise LookupError
    return (type(value), *map(told, value))


def _of_dict(value):
    return (*_of_container(value), *map(told, value.values()))


_ways: dict[type, Any] = {int: _of_number, **dict.fromkeys((str, bool, type(None)), _of_value),
         **dict.fromkeys((tuple, list), _of_container), dict: _of_dict, np.ndarray: _of_array}  # fmt: skip


def told(value):
    """What a check of a value depends on: types, shapes, dtypes, and small values that a `Literal` may name.

    Raises:
        LookupError: a long container, of which beartype checks an item at random.
    """
    kind = type(value)
    way = _ways.get(kind)
    if way is None:
        way = _ways[kind] = _of_array if issubclass(kind, np.ndarray | jax.Array | Tracer) else type
    return way(value)


_jaxtyped = jaxtyping.jaxtyped
_checks: dict[tuple, "_Check"] = {}


def _of_text(annotation, names):
    """Resolve an annotation given as text; a name that only the type checker knows becomes `Any`."""

    def known():
        """Carry the annotation."""

    known.__annotations__["value"] = annotation
    try:
        return get_type_hints(known, names, include_extras=True)["value"]
    except Exception:
        return Any


class _Check:
    """The check of all functions of one definition: an inner one is defined anew in each call of the outer one.

    Two generated functions for each definition, as jaxtyping has them, take 5 ms; checkers of annotations are shared.
    """

    def __init__(self, fn, typechecker):
        self.seen, self.typechecker = {}, typechecker  # calls, each with its results
        self.signature, self.names = inspect.signature(fn), fn.__globals__
        kinds = {p.kind for p in self.signature.parameters.values()}
        self.starred = bool(kinds & {inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD})
        self.where = f"{fn.__module__}.{fn.__qualname__}"

    @cached_property
    def hints(self) -> dict[str, Any]:
        """The annotations by name of parameter, and of the result."""
        told = {name: p.annotation for name, p in self.signature.parameters.items()}
        told["return"] = self.signature.return_annotation
        told = {k: _of_text(v, self.names) for k, v in told.items() if v is not inspect.Parameter.empty}
        return {k: v for k, v in told.items() if v is not Any and not isinstance(v, ParamSpecArgs | ParamSpecKwargs)}

    def hold(self, what, hint, value):
        """Raise a TypeCheckError where the value is not of the annotation."""
        if not self.typechecker(value, hint):
            raise jaxtyping.TypeCheckError(
                f"Type-check error whilst checking the {what} of {self.where}: {_shown(value)} is not of {hint}"
            )

    def __call__(self, fn, args, options):
        """The result of `fn`, with its arguments and its result checked; equal axes have equal lengths."""
        hints = self.hints
        with _jaxtyped("context"):
            for name, value in self._given(args, options):
                if name in hints:
                    self.hold(f"parameters ({name})", hints[name], value)
            out = fn(*args, **options)
            if "return" in hints:
                self.hold("return value", hints["return"], out)
        return out

    def _given(self, args, options):
        """Every argument with the name of its parameter; a wrong number of them is for the function to refuse."""
        if not self.starred:
            return (*zip(self.signature.parameters, args, strict=False), *options.items())
        several = {inspect.Parameter.VAR_POSITIONAL: tuple, inspect.Parameter.VAR_KEYWORD: dict.values}
        given, listed = self.signature.bind(*args, **options).arguments, []
        for name, value in given.items():
            kind = self.signature.parameters[name].kind
            listed += [(name, one) for one in several[kind](value)] if kind in several else [(name, value)]
        return listed


def _shown(value) -> str:
    """The value in a message: an array by its dtype and shape."""
    return f"{value.dtype}{value.shape}" if hasattr(value, "shape") else f"{value!r:.200}"


def _of_init(kind: Any, typechecker):
    """A class whose generated `__init__` is checked, as jaxtyping checks that of a dataclass."""
    if dataclasses.is_dataclass(kind) and getattr(kind.__init__, "__globals__", {}) is not globals():
        kind.__init__ = remembering(kind.__init__, typechecker=typechecker)
    return kind


def remembering(fn: Any = None, *, typechecker) -> Any:
    """`jaxtyping.jaxtyped` that does not check a call like an earlier one again."""
    if fn is None:
        return partial(remembering, typechecker=typechecker)
    if inspect.isclass(fn):
        return _of_init(fn, typechecker)
    if not inspect.isfunction(fn):
        return _jaxtyped(fn, typechecker=beartype(conf=CONF))
    if not fn.__annotations__:
        return fn
    definition = (typechecker, fn.__module__, fn.__qualname__, fn.__code__, repr(fn.__annotations__))
    check = _checks.get(definition)
    if check is None:
        check = _checks[definition] = _Check(fn, typechecker)
    seen = check.seen

    ways, config = _ways, jaxtyping.config

    @wraps(fn)
    def call(*args, **options):
        if config.jaxtyping_disable:
            return fn(*args, **options)
        try:
            key = (*[ways.get(type(a), told)(a) for a in args],)
            if options:
                # the key holds the type beside a str, so that an argument cannot equal the name of an option
                key = (*key, *options, *map(told, options.values()))
            results = seen.get(key)
        except (LookupError, TypeError):
            return check(fn, args, options)
        out = fn(*args, **options) if results else check(fn, args, options)
        try:
            found = ways.get(type(out), told)(out)
        except LookupError:
            found = None
        if not results:
            seen[key] = {None, found}
        elif found is None or found not in results:
            check(lambda *_, **__: out, args, options)
            results.add(found)
        return out

    return call
