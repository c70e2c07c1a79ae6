"""Run the notebooks and store them with what they give, pictures in few colours as those of a report.

python notebooks/store.py [NOTEBOOK...]
"""

from __future__ import annotations

import base64
import sys
from io import BytesIO
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

from zoo.report.page import COLOURS

FOLDER = Path(__file__).parent


def small(png: str) -> str:
    """A picture in base64, a quarter of the size."""
    image, stored = Image.open(BytesIO(base64.b64decode(png))).convert("RGB"), BytesIO()
    image.quantize(COLOURS).save(stored, "PNG", optimize=True)
    return base64.b64encode(stored.getvalue()).decode("ascii")


def store(path: Path) -> None:
    """Run one from a clean kernel, in its folder, and write it."""
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources=resources, record_timing=False
    ).execute()
    for data in (output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", [])):
        if "image/png" in data:
            data["image/png"] = small(data["image/png"])
        if len(data) > 1:  # what a picture or a formula is called beside it has the address of an object
            data.pop("text/plain", None)
    notebook.metadata["language_info"] = {"name": "python"}
    nbformat.write(notebook, path)


if __name__ == "__main__":
    given = [Path(one).resolve() for one in sys.argv[1:]]
    for one in given or sorted(FOLDER.glob("*.ipynb")):
        store(one)
