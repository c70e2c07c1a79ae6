"""Waves to draw, and what a figure shows."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import xarray as xr

TIMES = np.arange(40) * 0.11 / 40


def texts(figure) -> set[str]:
    """All words in a figure."""
    figure.canvas.draw()
    return {t.get_text() for t in figure.findobj(mpl.text.Text)}


def band_of(axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge of a filled band, at the study's times."""
    [band] = [c for c in axes.collections if c.get_label() == label]
    vertices = band.get_paths()[0].vertices
    x = 1e3 * TIMES
    low = [vertices[np.isclose(vertices[:, 0], t), 1].min() for t in x]
    high = [vertices[np.isclose(vertices[:, 0], t), 1].max() for t in x]
    return np.array(low), np.array(high)


def fake_waves(n_vessels: int = 9, level: float = 15.0, n: int = 60) -> xr.Dataset:
    """Waves with a level that falls by 0.5 mmHg a vessel, an area proportional to the pressure."""
    rng = np.random.default_rng(4)
    vessel = np.arange(1, n_vessels + 1)
    shape = level + 2 * np.sin(57 * TIMES) - 0.5 * (vessel[:, None, None] - 1)
    pressure = shape + 0.3 * rng.standard_normal((n, 1, 1, 1)) * np.ones((2, 1))
    dims = ("draw", "vessel", "position", "time")
    return xr.Dataset(
        {
            "pressure_mmHg": (dims, pressure),
            "flow_ml_s": (dims, pressure / 100),
            "area_cm2": (dims, pressure / 5000),
            "sigma2": ("draw", np.full(n, 0.04)),
            "error_variance_pressure_mmHg": (("draw", "time"), np.full((n, len(TIMES)), 0.04)),
        },
        coords={
            "vessel": vessel,
            "radius_cm": ("vessel", np.linspace(0.05, 0.02, n_vessels)),
            "name": ("vessel", ["trunk", *(f"v{v}" for v in vessel[1:])]),
            "position": [0.0, 0.5],
            "time": TIMES,
        },
        attrs={"error": "iid", "root": 1, "model": "A"},
    )


def lines_of(axes) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for line in axes.get_lines()]


def fill_of(collection) -> tuple[float, float]:
    """Lowest and highest value at time 0."""
    vertices = collection.get_paths()[0].vertices
    at = vertices[vertices[:, 0] == 0, 1]
    return at.min(), at.max()
