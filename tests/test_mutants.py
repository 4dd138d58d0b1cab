"""The faults that `benchmarks.mutants` puts in: they fit the code as it is, change what runs, and reach tests."""

import ast
from collections import Counter
from pathlib import Path

import pytest

from benchmarks import mutants

ROOT = Path(__file__).resolve().parents[1]


def text_of(mutant):
    return (ROOT / mutant.file).read_text(encoding="utf-8")


def test_what_was_written_down_still_fits():
    found = mutants.by_hand(None)
    assert len({m.id for m in found}) == len(found) == 12
    assert all(m.text != text_of(m) and ast.parse(m.text) for m in found)


def test_a_fault_that_no_longer_fits_ends_the_run(monkeypatch, tmp_path):
    place = tmp_path / "faults.json"
    place.write_text('[{"name": "gone", "file": "pitp_jax/common/metrics.py", "edits": [["no such text", ""]]}]')
    monkeypatch.setattr(mutants, "BY_HAND", place)
    with pytest.raises(SystemExit, match="gone: 0 times in pitp_jax/common/metrics.py"):
        mutants.by_hand(None)


@pytest.mark.slow
def test_a_draw_is_the_seeds_and_of_every_operator():
    found = mutants.draw(mutants.numerical_files(), 60, 1)
    assert [m.id for m in found[:10]] == [m.id for m in mutants.draw(mutants.numerical_files(), 10, 1)]
    assert set(Counter(m.operator for m in found)) == set(mutants.OPERATORS)
    for m in found:
        assert ast.dump(ast.parse(m.text)) != ast.dump(ast.parse(text_of(m)))
        assert m.before in text_of(m) and m.before != m.after
        assert mutants.reach(m.file) and all((ROOT / test).is_file() for test in mutants.reach(m.file))


@pytest.mark.parametrize(
    ("operator", "code", "becomes"),
    [
        ("sign", "a + b", ["a - b"]), ("sign", "-a", ["a"]), ("factor", "a / b", ["1.5 * (a / b)"]),
        ("index", "x[-1]", ["x[0]"]), ("index", "x[1:-2]", ["x[2:-2]", "x[1:-1]"]), ("index", "x[k]", []),
        ("branch", "a < b", ["a >= b"]), ("branch", "np.where(c, x, y)", ["np.where(c, y, x)"]),
        ("branch", "a if c else b", ["a if not c else b"]), ("constant", "0.5", ["1.0"]), ("constant", "True", []),
    ],
)  # fmt: skip
def test_operators(operator, code, becomes):
    assert [ast.unparse(new) for new in mutants.mutated(operator, ast.parse(code, mode="eval").body)] == becomes
