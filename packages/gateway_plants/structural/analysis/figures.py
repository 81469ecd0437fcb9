"""The picture of a structural analysis: the paper's Fig. 2, the decomposed model, and its tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from gateway_fdi.structure.analysis import Analysis
from gateway_replay.drawing import save

_PANELS = (
    ("a", "SDI", "mixed causality"),
    ("b", "SI", "integral causality"),
    ("c", "SD", "derivative causality"),
)
_UNDER, _JUST, _OVER, _CLASS = "#c9b8de", "#a9d3a5", "#cfe0f3", "#9dbfe3"
_FAULT = "#c0392b"
#: Beyond this number of rows labels would be unreadable.
_MOST_LABELS = 120


def _bars(axes: Axes, analysis: Analysis, letter: str, causality: str, words: str) -> None:
    edges = np.arange(len(analysis.msos) + 1) + 0.5
    narrow = len(analysis.msos) > 300
    layers = (
        (analysis.msos.sum(1), "white", "equations of the set"),
        (analysis.counts(causality, "realizable"), "#9a9a9a", "realizable"),
        (analysis.counts(causality, "unique"), "black", "unique"),
    )
    for values, colour, label in layers:
        if narrow:
            axes.stairs(values, edges, fill=True, facecolor=colour, edgecolor="0.5", lw=0.3, label=label)
        else:
            axes.bar(edges[:-1] + 0.5, values, 0.85, color=colour, edgecolor="0.35", lw=0.4, label=label)
    table = analysis.candidates.table["modified"]
    unique, realizable = table["unique"][causality], table["realizable"][causality]
    axes.set_title(
        f"({letter}) {causality}, {words}: {unique[1]} unique of {unique[0]} sets, {realizable[1]} realizable of"
        f" {realizable[0]} sets",
        fontsize=9,
        loc="left",
    )
    axes.set_xlim(0.3, len(analysis.msos) + 0.7)
    axes.set_ylabel("candidates", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)


def _decomposition(axes: Axes, analysis: Analysis) -> None:
    parts, structure = analysis.parts, analysis.structure
    blocks = [(parts.under, _UNDER)] if parts.under.equations or parts.under.variables else []
    blocks += [(block, _JUST) for block in parts.just]
    blocks += [(block, _CLASS) for block in sorted(parts.classes, key=lambda b: -len(b.equations))]
    rows = [e for block, _ in blocks for e in block.equations]
    own = [v for block, _ in blocks for v in block.variables]
    # Parts that several classes share stand at the right.
    columns = own + [v for v in structure.variables if v not in set(own)]
    place = {v: k for k, v in enumerate(columns)}
    over = (len(rows) - len(parts.over.equations), len(columns) - len(parts.over.variables))
    if parts.over.equations:
        corner = (over[1] - 0.5, over[0] - 0.5)
        axes.add_patch(Rectangle(corner, len(parts.over.variables), len(parts.over.equations), color=_OVER, lw=0))
    top, left = 0, 0
    for block, colour in blocks:
        size = (len(block.variables), len(block.equations))
        axes.add_patch(Rectangle((left - 0.5, top - 0.5), *size, facecolor=colour, edgecolor="0.3", lw=0.6))
        left, top = left + size[0], top + size[1]
    faulty = {e.name for e in analysis.model.equations if e.faults}
    states = set(analysis.model.lumped_states)
    at = {name: k for k, name in enumerate(structure.equations)}
    for y, name in enumerate(rows):
        there = [structure.variables[v] for v in np.flatnonzero(structure.dense[at[name]])]
        derivatives = analysis.model.by_name[name].derivatives
        for v in there:
            if v in derivatives and v in states:
                axes.text(place[v], y, "D", ha="center", va="center", fontsize=7, weight="bold")
            else:
                axes.plot(place[v], y, "o", ms=3.4, color=_FAULT if name in faulty else "0.15")
    axes.set_xlim(-0.6, len(columns) - 0.4)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    if max(len(rows), len(columns)) <= _MOST_LABELS:
        axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
        axes.set_yticks(range(len(rows)), rows, fontsize=7)
        for label, name in zip(axes.get_yticklabels(), rows, strict=True):
            label.set_color(_FAULT if name in faulty else "black")
    axes.set_title(
        f"Dulmage-Mendelsohn: {len(structure.equations)} equations, {len(columns)} unknowns, redundancy"
        f" {parts.redundancy}\n(D: differentiated, red: with a fault)",
        fontsize=9,
        loc="left",
    )
    legend = [
        Patch(color=_OVER, label="overdetermined"),
        Patch(color=_CLASS, label="equivalence classes"),
    ]
    legend += [Patch(color=_JUST, label="just determined")] * bool(parts.just)
    legend += [Patch(color=_UNDER, label="underdetermined")] * bool(parts.under.equations)
    axes.legend(handles=legend, fontsize=7, loc="lower left", framealpha=0.95)


def _matrix(axes: Axes, values: Any, rows: list[str], columns: list[str], title: str) -> None:
    axes.imshow(values, cmap="Blues", vmin=0, vmax=1.4, aspect="auto")
    for y, row in enumerate(values):
        for x, value in enumerate(row):
            if value:
                axes.text(x, y, "x", ha="center", va="center", fontsize=8)
    axes.set_xticks(range(len(columns)), columns, rotation=35, ha="right", fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_title(title, fontsize=9, loc="left")
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=1.5)
    axes.tick_params(which="both", length=0)


def _tests(axes: Axes, analysis: Analysis) -> None:
    faults = list(analysis.model.faults)
    if analysis.tests:
        rows = list(analysis.tests)
        values = [[f in test.faults for f in faults] for test in analysis.tests.values()]
        title = "Fault signature matrix of the model's residuals"
    else:
        rows = [f"set {k + 1}" for k in analysis.fewest]
        values = analysis.signature[analysis.fewest].tolist()
        title = "Fault signature matrix of the fewest sets"
    if rows:
        _matrix(axes, np.array(values, float).reshape(len(rows), len(faults)), rows, faults, title)
    else:
        axes.set_axis_off()


def draw(path: Path, analysis: Analysis) -> Path:
    """Draw an analysis; the format is that of the file's name; returns the file."""
    faults = list(analysis.model.faults)
    height = min(max(6.5, 0.19 * len(analysis.model.equations)), 16.0)
    figure = plt.figure(figsize=(12, 6.4 + height))
    grid = figure.add_gridspec(
        2, 1, height_ratios=[5.4, height], hspace=0.17, left=0.07, right=0.98, top=0.94, bottom=0.07
    )
    bars = grid[0].subgridspec(len(_PANELS), 1, hspace=0.42)
    for k, panel in enumerate(_PANELS):
        axes = figure.add_subplot(bars[k])
        _bars(axes, analysis, *panel)
        if k == 0:
            axes.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
        if k == len(_PANELS) - 1:
            axes.set_xlabel("MSO set", fontsize=8)
    low = grid[1].subgridspec(2, 2, width_ratios=[2.1, 1], wspace=0.22, hspace=0.45)
    _decomposition(figure.add_subplot(low[:, 0]), analysis)
    if faults:
        _tests(figure.add_subplot(low[0, 1]), analysis)
        best = analysis.best.confused.astype(float)
        title = "Isolability: which fault (column) explains\nwhich (row) too"
        _matrix(figure.add_subplot(low[1, 1]), best, faults, faults, title)
    figure.suptitle(
        f"{analysis.model.name}: {len(analysis.msos)} MSO sets, {len(analysis.candidates)} candidates",
        fontsize=12,
    )
    try:
        return save(figure, path, tight=False)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
