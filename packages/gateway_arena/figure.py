"""ROC curves of the arena: one panel a plant, one line a method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.lines import Line2D

from gateway_arena.score import Row
from gateway_replay.drawing import save


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the rows' curves into a file."""
    plants = list(dict.fromkeys(row.plant for row in rows))
    across = min(5, len(plants))
    down = -(-len(plants) // across)
    figure, panels = plt.subplots(down, across, figsize=(2.6 * across, 2.6 * down + 0.6), squeeze=False)
    methods = list(dict.fromkeys(row.method for row in rows))
    colours = dict(zip(methods, plt.colormaps["tab10"](np.arange(len(methods)) % 10), strict=True))
    for axes in panels.flat[len(plants) :]:
        axes.set_visible(False)
    for axes, plant in zip(panels.flat, plants, strict=False):
        for row in (row for row in rows if row.plant == plant and row.roc):
            x, y = np.array(row.roc).T
            axes.step(x, y, where="post", color=colours[row.method], lw=1.2, label=row.method)
        axes.set_title(plant, fontsize=9, loc="left")
        axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        axes.tick_params(labelsize=7)
    handles = [Line2D([], [], color=colours[name], label=name) for name in methods]
    figure.legend(handles=handles, loc="lower center", ncols=len(methods), fontsize=8, frameon=False)
    figure.supxlabel("false alarms", fontsize=8, y=0.06)
    figure.supylabel("detections", fontsize=8)
    figure.tight_layout(rect=(0.01, 0.08, 1, 1))
    save(figure, path)
    plt.close(figure)
