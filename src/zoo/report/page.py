"""How a page is made: one template, one style, figures inside it."""

from __future__ import annotations

import base64
import tempfile
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from zoo.core.outputs import write_file
from zoo.plots import save_figure
from zoo.report.filters import FILTERS

COLOURS = 64
"""Of a figure in the page: a quarter of the size, and no difference to the eye."""


class ReportError(ValueError):
    """A report that cannot be written; its text says what to change."""


@cache
def _templates() -> Environment:
    found = Environment(
        loader=PackageLoader("zoo.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= FILTERS
    return found


def write_page(path: Path, template: str, **values: Any) -> Path:
    """Fill a template in and write the page; returns its path."""
    return write_file(path, _templates().get_template(template).render(**values))


class Picture(NamedTuple):
    """A figure inside the page, with its size in CSS pixels, and the same for a narrow screen."""

    source: str
    width: int
    height: int
    narrow: str = ""


def picture_of(figure: Any) -> Picture:
    """A figure, or the PNG that it was saved as, in a data URI."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = figure if isinstance(figure, Path) else save_figure(figure, Path(folder) / "figure.png")
        image = Image.open(drawn).convert("RGB")
    small = BytesIO()
    image.quantize(COLOURS).save(small, "PNG", optimize=True)
    source = "data:image/png;base64," + base64.b64encode(small.getvalue()).decode("ascii")
    return Picture(source, round(0.6 * image.width), round(0.6 * image.height))  # 160 dots an inch
