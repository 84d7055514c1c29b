"""docs/tutorial.ipynb runs from its first cell to its last, and shows what it should."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "tutorial.ipynb"


# Added to the notebook: while this cell waits, the kernel goes on with the run of the live view.
WAITED = """
import asyncio
while touched.time < 0.1 or tp.read_results("out/touched").status == "running":
    await asyncio.sleep(0.05)
tp.read_results("out/touched").status
"""


@pytest.mark.slow
def test_the_notebook_runs_and_shows_its_progress_pictures_movie_and_widgets(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    book = nbformat.read(NOTEBOOK, as_version=4)
    book.cells.append(nbformat.v4.new_code_cell(WAITED))
    NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    shown = [output.data for output in outputs if "data" in output]
    html = "".join(data.get("text/html", "") for data in shown)
    for part in ("<b>Case: Dam break</b>", '<progress value="1.0000"', "<b>Simulation: Dam break</b>", "dataframe"):
        assert part in html
    assert '<td style="text-align: left">complete</td>' in html
    assert "video/mp4;base64," in html
    widgets = [data for data in shown if "application/vnd.jupyter.widget-view+json" in data]
    assert [data["text/plain"] for data in widgets] == ["View(notebook)", "View(touched)"]
    assert sum("image/png" in data for data in shown) == 2 + len(widgets)
    assert shown[-1]["text/plain"] == "'complete'"
    assert "the water reaches x = 0." in "".join(output.get("text", "") for output in outputs)
    assert (tmp_path / "out" / "notebook" / "fields.vtkhdf").is_file()


def test_the_notebook_is_stored_without_outputs():
    book = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(book)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book.cells)
