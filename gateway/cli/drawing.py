"""Common parts of all figures."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure


def save(figure: Figure, path: Path, *, tight: bool = True) -> Path:
    """Write a figure and let go of it; returns the file. ``tight``: lay it out, unless it is laid out already."""
    if tight:
        figure.tight_layout(rect=(0, 0.06, 1, 1) if figure.legends else (0, 0, 1, 1))
    figure.savefig(path, dpi=120)
    plt.close(figure)
    return path
