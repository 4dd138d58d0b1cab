"""The order of the storeys and of the rooms of `method`, held over the syntax trees."""

import ast
from pathlib import Path

import pitp_jax

PACKAGE = Path(pitp_jax.__file__).parent
STOREYS = ("common", "method", "files", "application")  # each imports itself and those before it
ROOMS = ("numerics", "signal", "model", "effects", "simulate", "fit")  # inside `method`, likewise; the methods follow


def imported(path):
    """Yield the module of the package, as a tuple of names, of each import in a file."""
    package = path.relative_to(PACKAGE).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            yield (*package[: len(package) - node.level + 1], *(node.module or node.names[0].name).split("."))


def rank(module):
    """Return the place of a module: its storey, its room inside `method`; all methods share the last place."""
    room = module[1] if module[0] == "method" else ""
    return STOREYS.index(module[0]), ROOMS.index(room) if room in ROOMS else len(ROOMS)


def against_the_order(here, there):
    """Return whether the import leads upward, or from one method to another."""
    if here[0] != "method" or there[0] != "method":
        return rank(there)[0] > rank(here)[0]
    return rank(there) > rank(here) or rank(there) == rank(here) and here[1] != there[1]


def test_no_import_leads_upward_or_from_one_method_to_another():
    found = {
        (".".join(here), ".".join(there))
        for path in PACKAGE.rglob("*.py")
        for here in [path.relative_to(PACKAGE).with_suffix("").parts]
        for there in imported(path)
        if here[0] in STOREYS and there[0] in STOREYS and against_the_order(here, there)
    }
    assert not found


def test_no_module_is_imported_by_name():
    """But by the command line, which loads the module of one command, and the readers: a new one is one new file."""
    users = {
        p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*.py") if "import_module(" in p.read_text("utf-8")
    }
    assert users <= {"application/commands/main.py", "files/containers/formats/__init__.py"}
