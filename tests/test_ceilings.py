"""The size of every room, counted as tokens of code: without comments, docstrings, blank lines and layout.

A room may grow up to its ceiling. A new option, rule or message in a room at its ceiling takes the place of others.
"""

import ast
import io
import tokenize
from pathlib import Path

import pytest

import pitp_jax

PACKAGE = Path(pitp_jax.__file__).parent
CEILINGS = {
    "common": 5831, "method/numerics": 9807, "method/signal": 13244, "method/model": 12500, "method/effects": 11494,
    "method/simulate": 18938, "method/fit": 7481, "method/identify": 25565, "method/train": 15378,
    "method/invert": 18970, "method/diagnose": 51335, "method/adapt": 4675, "files/containers": 32126,
    "files/recordings": 12690, "files/model_file": 5554, "files/export": 11367, "files/mjcf": 8820,
    "application/commands": 18262, "application/pages": 10657, "application/compare": 10522, "application/plan": 9206,
    "application/check": 7780, "application/against": 3386, "application/demo": 3985, "application/plant": 2431,
}  # fmt: skip
LAYOUT = {getattr(tokenize, name) for name in ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENCODING", "ENDMARKER")}
OPENS, CLOSES = (getattr(tokenize, f"FSTRING_{end}", None) for end in ("START", "END"))  # since Python 3.12


def tokens_in(text: str) -> list[tokenize.TokenInfo]:
    """Tokens of a file; an f-string is one, as before Python 3.12, which takes it apart."""
    tokens, opened = [], []
    lines = text.splitlines(keepends=True)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == OPENS:
            opened.append(token)
        elif token.type == CLOSES:
            (row, column), (last, end) = opened.pop().start, token.end
            whole = "".join(lines[row - 1 : last])[column : len("".join(lines[row - 1 : last - 1])) + end]
            token = tokenize.TokenInfo(tokenize.STRING, whole, (row, column), token.end, token.line)
        if not opened:
            tokens.append(token)
    return tokens


def tokens_of(text: str) -> int:
    """Count the tokens of a file; 60 characters of a string count as one more token."""
    docs = [
        node.body[0]
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node, clean=False)
    ]
    inside = {line for doc in docs for line in range(doc.lineno, (doc.end_lineno or doc.lineno) + 1)}
    counted = [
        t for t in tokens_in(text) if t.type not in LAYOUT and not (t.type == tokenize.STRING and t.start[0] in inside)
    ]
    return sum(1 + (t.type == tokenize.STRING) * (len(t.string) // 60) for t in counted)


def test_comments_and_docstrings_do_not_count():
    plain = 'x = 1\n\n\ndef f(a):\n    return a + "' + "b" * 130 + '"\n'
    told = '"""About."""\nx = 1  # why\n\n\ndef f(a):\n    """Say."""\n    return a + "' + "b" * 130 + '"\n'
    assert tokens_of(plain) == tokens_of(told) == 15  # 3 and 10, and 2 for the long string


def test_a_formatted_string_is_one_token_on_every_python():
    text = 'def f(a):\n    return f"{a:>{a}} and {a!r}" + f"""{f"{a}"}\n' + "b" * 60 + '"""\n'
    assert tokens_of(text) == 10 + 1  # 60 characters of the second string count as one more


@pytest.mark.parametrize("room", CEILINGS)
def test_no_room_is_above_its_ceiling(room):
    count = sum(tokens_of(path.read_text(encoding="utf-8")) for path in (PACKAGE / room).rglob("*.py"))
    assert count <= CEILINGS[room]


def test_every_room_has_a_ceiling():
    rooms = {"/".join(p.relative_to(PACKAGE).parts[:2]) for p in PACKAGE.glob("*/*/*.py")}
    assert {room for room in rooms if not room.startswith("common/")} <= set(CEILINGS)
