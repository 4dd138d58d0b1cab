"""The page of error messages and advice, made from the package's syntax trees, by the task that gives them.

An f-string becomes its fixed words with an ellipsis for each value; a choice between fixed words becomes `(a | b)`.
A message that is composed elsewhere (`BadInput("; ".join(problems))`) lists the sentences of the functions around it.
`docs/hooks.py` puts the page into the site. To print it without the site: `python docs/messages.py`.
"""

import ast
import re
import sys
from collections.abc import Collection, Iterator
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "pitp_jax"
ERRORS = {
    *("BadInput", "ComputationFailed", "Refused", "NoTable", "_Ask", "refuse_if"),
    *("ValueError", "TypeError", "ArgumentError", "ArgumentTypeError"),
}
FEWEST_WORDS = 2  # a shorter text is a name or a unit
DOCUMENTED = ast.FunctionDef | ast.ClassDef | ast.Module
FEWEST_IN_A_PART = 4  # a message that is composed elsewhere has sentences beside link words
ADVICE = re.compile(  # where a text begins to say what to do
    r"(?:(?<=; )|(?<=\. ))"
    r"(add|ask|check|choose|give|hold|identify|keep|leave|let|lower|raise|record|repeat|start|try|use)\b",
    re.IGNORECASE,
)

# heading: (rooms, the page that helps)
TASKS = {
    "Files that cannot be read": (
        ("files/containers", "files/recordings", "method/signal"),
        "[Record formats](how_to/records.md) shows each option.",
    ),
    "Options of the command line": (
        ("application/commands",),
        "`pitp COMMAND --help` lists the options; [files and commands](contract.md) explains them.",
    ),
    "Check, identify and fit": (
        ("application/check", "method/identify", "method/train"),
        "[Which recordings](which_recordings.md) shows what a model needs.",
    ),
    "Plan": (("application/plan",), "[Which recordings](which_recordings.md) shows a plan."),
    "Model files": (("method/model", "files/model_file"), "`pitp info MODEL` shows what a file holds."),
    "Predict and simulate": (("method/simulate",), "[Start](start.md) shows both with a demo."),
    "Invert and export": (("method/invert", "files/export"), "[To the rig](to_the_rig.md) shows limits and exports."),
    "Diagnose and adapt": (
        ("method/diagnose", "method/effects", "method/adapt"),
        "[My rig disagrees](my_rig_disagrees.md) and [another day](another_day.md) show both commands.",
    ),
    "A robot and its simulator": (
        ("application/against", "application/compare", "files/mjcf"),
        "[I have a simulator](i_have_a_simulator.md) shows the five commands.",
    ),
    "Python": (
        ("method/numerics", "application/plant", "application/pages", "application/demo", "common", "method/fit"),
        "[Python interface](api/README.md) lists arguments and shapes.",
    ),
}
HEAD = """# Messages

After this page you know what to do about an error or a warning. Search it for a few words of your message, without
names and numbers; "…" stands for these. The part in bold says what to do. `(a | b)` stands for one of two texts.

- Exit code 2: the input or an option is wrong. Exit code 3: the input is correct, but the computation failed.
- `unrecognized arguments`, `invalid choice`, `the following arguments are required`: `pitp COMMAND --help` lists the
  options and values that the command takes.
- `try: pitp ...`: run this command. First replace the words in capitals (`UNIT`, `SCALE`, `RATE`) by your values.
- `out of memory`: give fewer or shorter recordings.
- `unexpected ...`: this is a fault of pitp. Run again with `PITP_TRACEBACK=1` and report it."""


@cache
def page() -> str:
    """Return the page as Markdown."""
    rooms = [PACKAGE / "common", *(p for storey in PACKAGE.iterdir() for p in storey.glob("*/"))]
    found = {room.relative_to(PACKAGE).as_posix(): set(messages(room)) for room in rooms}
    missing = {name for name, here in found.items() if here} - {room for rooms, _ in TASKS.values() for room in rooms}
    if missing:
        raise ValueError(f"docs/messages.py: TASKS lists no heading for {sorted(missing)}; add one")
    text = [HEAD]
    for heading, (rooms, help_) in TASKS.items():
        here = sorted(set().union(*(found[room] for room in rooms)), key=lambda m: re.sub(r"\W", "", m.lower()))
        text += [f"## {heading}", help_, "\n".join(f"- {_marked(m)}" for m in here)]
    return "\n\n".join(text) + "\n"


def messages(room: Path) -> Iterator[str]:
    """Return the templates of all error messages and of all advice of a room or file."""
    for path in sorted(room.rglob("*.py")) if room.is_dir() else [room]:
        if path.suffix == ".py":
            source = path.read_text(encoding="utf-8")
            tree = ast.parse(source)
            if any(f"{name}(" in source for name in ERRORS):
                yield from _errors(tree)
            yield from filter(ADVICE.search, _sentences(tree, {}, set()))


def _errors(tree: ast.Module) -> Iterator[str]:
    """Return the messages of the errors that a module raises."""
    functions = {n.name: n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
    inside = {id(n): f for f in functions.values() for n in ast.walk(f)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name in ERRORS:  # it composes its message itself
            yield from (text for part in node.body[1:] for text in _sentences(part, {}, set()))
        if not (isinstance(node, ast.Call) and _name(node.func) in ERRORS):
            continue
        around = inside.get(id(node), tree)
        count = len(node.args) if _name(node.func) == "refuse_if" else 2  # its arguments are (check, message)
        told = [text for argument in node.args[:count] for text in _texts(argument)]
        values = [*node.args, *_assigned(node, around)]
        called = [functions.get(_name(n.func)) for v in values for n in ast.walk(v) if isinstance(n, ast.Call)]
        parts = [text for v in values[len(node.args) :] for text in _texts(v)]
        parts += [text for f in called if f for text in _sentences(f, functions, set())]
        if not told and not parts:
            parts = list(_sentences(around, functions, set())) or list(_sentences(tree, functions, set()))
        yield from told
        yield from (text for text in parts if len(_words(text)) >= FEWEST_IN_A_PART)


def _assigned(call: ast.Call, around: ast.AST) -> list[ast.AST]:
    """Return the values that the function assigns to the names of this call."""
    names = {n.id for a in call.args for n in ast.walk(a) if isinstance(n, ast.Name)}
    assignments = [n for n in ast.walk(around) if isinstance(n, ast.Assign)]
    return [n.value for n in assignments if names & {t.id for t in ast.walk(n.targets[0]) if isinstance(t, ast.Name)}]


def _sentences(around: ast.AST, functions: dict[str, ast.FunctionDef], seen: set[str]) -> Iterator[str]:
    """Return the sentences of a function or module, and of the functions of its module that it calls."""
    docstrings = {id(n.body[0]) for n in ast.walk(around) if isinstance(n, DOCUMENTED) and n.body}
    yield from _texts(around, docstrings)
    for node in ast.walk(around):
        called = _name(node.func) if isinstance(node, ast.Call) else ""
        if called in functions and called not in seen:
            seen.add(called)
            yield from _sentences(functions[called], functions, seen)


def _texts(node: ast.AST, skipped: Collection[int] = ()) -> Iterator[str]:
    """Return the string templates with enough words below a node, the outermost ones."""
    waiting = [node]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.JoinedStr | ast.Constant | ast.BinOp):
            text = " ".join(_template(node).split())
            if len(_words(text)) >= FEWEST_WORDS and " " in text and "\\" not in text:
                yield text
                continue
        if not (isinstance(node, ast.Expr) and id(node) in skipped):
            waiting.extend(ast.iter_child_nodes(node))


def _template(node: ast.AST) -> str:
    """Return the fixed words of an expression, with an ellipsis for every value."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(map(_template, parts))
        case ast.FormattedValue(value=value, conversion=conversion):
            return "'…'" if conversion == ord("r") else _template(value)
        case ast.IfExp(body=first, orelse=second):
            either = [t for t in (_template(first), _template(second)) if t.strip()]
            return either[0] if len(set(either)) == 1 else f"({' | '.join(either)})"
        case ast.BinOp(op=ast.Mult(), left=left, right=right):
            fixed = [t for t in (_template(left), _template(right)) if t != "…"]
            return f"({fixed[0]})" if fixed else "…"
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            return _template(left) + _template(right)
    return "…"


def _words(text: str) -> list[str]:
    return re.findall(r"[A-Za-z]{2,}", text)


def _name(node: ast.AST) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _marked(message: str) -> str:
    """Return a message as Markdown: the part that says what to do in bold."""
    message = message.lstrip("; ")
    advice = ADVICE.search(message)
    start = advice.start() if advice else message.rfind("; ") + 2
    what, remedy = (re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", part) for part in (message[:start], message[start:]))
    return f"{what}**{remedy}**" if start > 1 and remedy[:1].isalnum() else what + remedy


if __name__ == "__main__":
    sys.stdout.write(page())
