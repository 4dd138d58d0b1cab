"""How arguments are checked while the tests run: by beartype, an int where a float is wanted being fine (PEP 484).

Modules with arrays are checked by jaxtyping, which binds the arguments of every call: 40 us each. Reading a table
calls thousands of functions of modules without arrays, so these are checked by beartype alone.
"""

from importlib.util import find_spec
from pathlib import Path

from beartype import BeartypeConf, beartype

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
