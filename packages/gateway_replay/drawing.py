"""Common parts of all figures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle, StepPatch

#: Under which name each format keeps the text of :func:`contents`.
_TEXT = {".png": "Description", ".svg": "Description", ".pdf": "Subject"}


def save(figure: Figure, path: Path, *, tight: bool = True) -> Path:
    """Write a figure and let go of it; returns the file. ``tight``: lay it out, unless it is laid out already."""
    if tight:
        figure.tight_layout(rect=(0, 0.06, 1, 1) if figure.legends else (0, 0, 1, 1))
    kind = path.suffix.lower()
    dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(kind, {})  # equal figures, equal files
    told = {_TEXT[kind]: json.dumps(contents(figure)), **dates} if kind in _TEXT else None
    figure.savefig(path, dpi=120, metadata=told)
    plt.close(figure)
    return path


def contents(figure: Figure) -> list[dict[str, Any]]:
    """Return what is drawn in each axes: its words, of each line how many points and their range, where areas are.

    It lies in the file, so that a later figure can be held against it.
    """
    return [_contents(axes) for axes in figure.axes]


def _contents(axes: Axes) -> dict[str, Any]:
    legend = axes.get_legend()
    words = [axes.get_title(), axes.get_xlabel(), axes.get_ylabel(), *(text.get_text() for text in axes.texts)]
    words += [text.get_text() for text in legend.get_texts()] if legend is not None else []
    words += filter(None, [axes.get_title("left")])
    boxes = [patch.get_bbox().bounds for patch in axes.patches if isinstance(patch, Rectangle)]
    boxes += [each.get_datalim(axes.transData).bounds for each in axes.collections]
    stairs = [patch.get_data() for patch in axes.patches if isinstance(patch, StepPatch)]
    return {
        "words": words,
        "lines": [_summary(line.get_xdata(), line.get_ydata()) for line in axes.lines]
        + [_summary(edges, values) for values, edges, _ in stairs],
        "boxes": [[float(f"{value:.4g}") if math.isfinite(value) else None for value in box] for box in boxes],
    }


def _summary(*xy: Any) -> list[float | None]:
    """Return how many points there are, and of x and y the least, the mean and the greatest; None: there is none."""
    found: list[float | None] = [len(xy[0])]
    for values in xy:
        finite = np.asarray(values, float)[np.isfinite(np.asarray(values, float))]
        found += [float(f"{f(finite):.4g}") if finite.size else None for f in (np.min, np.mean, np.max)]
    return found
