"""Any laboratory computer: paths with blanks and umlauts, file names that Windows takes, terminals of few letters."""

import ast
import io
import json
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest
from cli_cases import refused, tree

import pitp_jax
from pitp_jax.application.commands.main import main
from pitp_jax.application.demo import files, protocol

PACKAGE = Path(pitp_jax.__file__).parent
FORBIDDEN = re.compile(r'[<>:"/\\|?*\x00-\x1f]|[. ]$')  # in a file's name on Windows


@pytest.fixture
def folder(tmp_path):
    """Blanks, umlauts and a letter outside every Western code page."""
    made = tmp_path / "Messung Müller 1" / "größe Ω"
    made.mkdir(parents=True)
    return made


@pytest.fixture
def placed(bench, folder):
    """The bench's files under names of that kind; where they are."""
    for name, source in (("modell ü", "nominal"), ("ziel ä.csv", "target.csv"), ("sinus ö Ω.csv", "records/sine2.csv")):
        (folder / name).write_bytes((bench / source).read_bytes())
    return folder


def test_identify_and_predict_there(call, placed, quick_identify):
    assert call("identify", placed / "sinus ö Ω.csv", "--out", placed / "neu ß", "--json", placed / "ß.json")[0] == 0
    assert quick_identify[0][0] == ["sinus ö Ω"]
    record, out, scores = placed / "sinus ö Ω.csv", placed / "läufe 1", placed / "ö.json"
    code, said, _ = call("predict", placed / "modell ü", record, "--out", out, "--json", scores)
    assert code == 0 and "sinus ö Ω" in said
    assert tree(out) == ["index.html", "report.html", "sinus ö Ω.csv"]
    assert list(json.loads(scores.read_text(encoding="utf-8"))["records"]) == ["sinus ö Ω"]


def test_invert_and_info_there(call, placed, quick_inverse):
    assert call("invert", placed / "modell ü", placed / "ziel ä.csv", "--out", placed / "spannung 1 ä.csv")[0] == 0
    assert call("info", placed / "modell ü", "--json", placed / "info ä.json")[0] == 0
    assert {"spannung 1 ä.csv", "info ä.json"} <= set(tree(placed))


def test_messages_name_such_paths_whole(call, folder):
    missing = folder / "nicht da.csv"
    assert str(missing) in refused(call("identify", missing, "--out", folder / "m"))


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_terminal_without_these_letters_shows_escapes(placed, monkeypatch, encoding):
    said = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", said)
    assert main(["predict", str(placed / "modell ü"), str(placed / "sinus ö Ω.csv")]) == 0
    said.flush()
    assert rb"\u03a9" in said.buffer.getvalue()


def test_names_of_output_files_are_names_everywhere():
    drives = [e.name for p in ("cone100", "roll") for part in ("sweep", "train", "test")
              for e in protocol.excitations(p, part, True)]  # fmt: skip
    names = [*files.FILES, *import_module("pitp_jax.application.commands.diagnose").FILES, *drives]
    parts = [part for n in names for part in n.split("/")]  # a folder of the output, then a file
    assert [n for n in parts if FORBIDDEN.search(n) or not n.isascii()] == []


def test_text_files_have_an_encoding_and_nothing_is_posix_alone():
    """Text in the system's code page could not be read elsewhere; these modules and calls do not exist on Windows."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                found += [f"{path.name}: {m}" for m in modules if m in ("fcntl", "resource", "pwd", "grp", "termios")]
            if isinstance(node, ast.Call) and _text_without_encoding(node):
                found.append(f"{path.name}:{node.lineno}: {ast.unparse(node)}")
    assert found == []


def _text_without_encoding(call):
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if name not in ("open", "read_text", "write_text") or any(k.arg == "encoding" for k in call.keywords):
        return False
    modes = [a.value for a in call.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
    return not any("b" in m for m in modes) and ast.unparse(call) not in (
        "open(os.devnull, 'w')",
        "archive.open(name)",  # of a zip file: bytes
    )
