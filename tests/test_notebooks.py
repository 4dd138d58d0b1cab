"""The notebooks of the manual run from their first cell to their last; what they claim is asserted in their cells."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Jupyter's, in this process; the notebook's own run in its kernel
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs_and_was_stored_with_its_results(path):
    nbformat, client = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    if path.stem == "robot":
        pytest.importorskip("mujoco")
    book = nbformat.read(path, as_version=4)
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    assert len(cells) > 3 and all(cell.execution_count for cell in cells)
    client.NotebookClient(book, timeout=None, kernel_name="python3").execute()


def test_there_is_one_for_a_laboratory_one_for_research_and_one_for_a_robot():
    assert [path.stem for path in NOTEBOOKS] == ["laboratory", "research", "robot"]
