"""Every tutorial runs from its first cell to its last, as the site runs it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

TUTORIALS = sorted((Path(__file__).parents[2] / "docs" / "tutorials").glob("*.md"))
SECONDS = 400  # [s] for a cell, compilation included

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_runs_from_its_first_cell_to_its_last(path, tmp_path, monkeypatch):
    reader, nbclient = pytest.importorskip("myst_nb.core.read"), pytest.importorskip("nbclient")
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
    monkeypatch.delenv("MPLBACKEND", raising=False)
    notebook = reader.read_myst_markdown_notebook(path.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert cells, f"{path.name} has no code"
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=SECONDS, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in cells for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs), f"{path.name} makes no picture"
