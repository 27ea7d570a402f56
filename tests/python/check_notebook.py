"""Runs examples/first_steps.ipynb as it stands: python check_notebook.py. No cell may fail; three must show motions."""

import pathlib
import tempfile

import nbformat
from nbclient import NotebookClient

NOTEBOOK = pathlib.Path(__file__).parents[2] / "pipeline" / "python" / "examples" / "first_steps.ipynb"
SHOWN = ["clip", "edit", "own"]

notebook = nbformat.read(NOTEBOOK, as_version=4)
nbformat.validate(notebook)
for cell in notebook.cells:
    assert not cell.get("outputs") and not cell.get("execution_count"), f"clear the outputs of cell {cell.id}"

with tempfile.TemporaryDirectory() as work:
    # A cell that fails raises here.
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": work}}).execute()

pages = {
    cell.id: output.data["text/html"]
    for cell in notebook.cells
    for output in cell.get("outputs", [])
    if "text/html" in output.get("data", {})
}
assert list(pages) == SHOWN, list(pages)
for cell, page in pages.items():
    assert page.startswith("<iframe srcdoc=") and "viewer-data" in page, cell
    # Script and style are 30 kB, a frame of a motion 224 bytes; MotionCutMix's clips have some hundred frames.
    assert len(page) < 250_000, (cell, len(page))
print(f"{NOTEBOOK.name}: {len(notebook.cells)} cells run, {len(pages)} show motions")
