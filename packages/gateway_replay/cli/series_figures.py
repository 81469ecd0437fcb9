"""The picture of series: a panel for each test value with its limit, quantity and signal, over time; DTCs marked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from gateway_replay.drawing import save
from gateway_replay.series.envelope import Envelope, Mark, Trace
from gateway_replay.series.rows import FAULT, QUANTITY, SIGNAL

#: Number of panels of a picture; the series that moved least are left out.
MOST = 16
#: A limit this many times above the values is not drawn: they would be a line at zero.
_FAR = 20.0
#: Longest title.
_LONG = 110
#: DTC marks with a name; all have a line.
_NAMED = 12
#: Width of a letter of such a name, as a share of the picture.
_LETTER = 0.0055

_LINE, _LIMIT, _SET, _HEALED, _FAILED = "#1f4e79", "#b8860b", "#c0392b", "#2e8b57", "#f3d2cd"


def _shown(envelope: Envelope) -> tuple[list[Trace], list[str]]:
    """Return the series that get a panel, in order, and notes about the rest."""
    moving: list[Trace] = []
    seen: dict[tuple[str, bytes, bytes], Trace] = {}
    for trace in envelope.traces.values():
        finite = np.isfinite(trace.low)
        if not finite.any():
            continue
        still = trace.low[finite].min() == trace.high[finite].max()
        if still and not trace.failed.any() and trace.series.kind != SIGNAL:
            continue
        same = (trace.series.monitor, trace.low.tobytes(), trace.high.tobytes())
        if trace.series.kind == FAULT and same in seen:  # several faults, decided by one number
            one = seen[same]
            one.series = replace(one.series, name=f"{one.series.name}, {trace.series.name}")
            one.failed = one.failed | trace.failed
            continue
        if trace.series.kind == FAULT:
            trace = replace(trace)  # noqa: PLW2901 - its name may grow
            seen[same] = trace
        moving.append(trace)
    order = {FAULT: 2, QUANTITY: 1, SIGNAL: 0}

    def rank(trace: Trace) -> tuple[bool, bool, int]:
        return bool(trace.failed.any()), bool(np.isfinite(trace.limit).any()), order[trace.series.kind]

    kept = sorted(moving, key=rank, reverse=True)[:MOST]
    left = [t.series.name for t in moving if not any(t is k for k in kept)]
    notes = [f"{len(left)} more are not drawn ({', '.join(left[:4])}, ...): --only names some"] if left else []
    if envelope.lost_marks:
        notes.append(f"{envelope.lost_marks} DTC events more are not marked")
    places = {id(t): k for k, t in enumerate(moving)}
    return sorted(kept, key=lambda t: (t.series.monitor, -order[t.series.kind], places[id(t)])), notes


def _panel(axes: Axes, trace: Trace, begin_ns: float) -> None:
    t = (trace.t_ns - begin_ns) / 1e9
    axes.fill_between(t, trace.low, trace.high, step="post", color=_LINE, alpha=0.35, lw=0)
    axes.plot(t, 0.5 * (trace.low + trace.high), drawstyle="steps-post", color=_LINE, lw=0.8)
    limit = np.where(np.isfinite(trace.limit), trace.limit, np.nan)
    largest = np.nanmax(np.abs([trace.low, trace.high])) if len(t) else 0.0
    if np.isfinite(limit).any() and np.nanmax(np.abs(limit)) <= _FAR * max(largest, 1e-300):
        axes.plot(t, limit, drawstyle="steps-post", color=_LIMIT, lw=1.0, ls="--")
    if trace.failed.any():
        axes.fill_between(
            t,
            0,
            1,
            where=trace.failed,
            step="post",
            color=_FAILED,
            lw=0,
            transform=axes.get_xaxis_transform(),
            zorder=0,
        )
    one = trace.series
    unit = f" [{one.unit}]" if one.unit else ""
    name = one.name if len(one.name) <= _LONG else f"{one.name[:_LONG]}..."
    axes.set_title(f"{one.monitor + ': ' if one.monitor else ''}{name}{unit}", fontsize=8, loc="left", pad=2)
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)


def _name(axes: Axes, marks: list[Mark], begin_ns: float) -> int:
    """Write the names of DTCs above their lines, as low as those before leave room; returns the number of heights."""
    low, high = axes.get_xlim()
    ends: list[float] = []  # of the last name at each height
    for mark in marks:
        at = (mark.t_ns - begin_ns) / 1e9
        level = next((k for k, end in enumerate(ends) if end < at), len(ends))
        ends[level : level + 1] = [at + (high - low) * _LETTER * len(mark.name)]
        axes.annotate(
            mark.name, (at, 1.0), xycoords=("data", "axes fraction"), xytext=(2, 10 + 8 * level),
            textcoords="offset points", fontsize=6, color=_SET, annotation_clip=False,
        )  # fmt: skip
    return len(ends)


def draw(path: Path, envelope: Envelope, title: str) -> list[str]:
    """Draw series; returns what people should know of it, one line each."""
    traces, notes = _shown(envelope)
    count = max(len(traces), 1)
    figure, grid = plt.subplots(count, 1, figsize=(10, 1.2 + 1.25 * count), sharex=True, squeeze=False)
    rows = [axes for (axes,) in grid]
    for axes, trace in zip(rows, traces, strict=False):
        _panel(axes, trace, envelope.begin_ns)
    for mark in envelope.marks:
        at, colour = (mark.t_ns - envelope.begin_ns) / 1e9, _SET if mark.is_set else _HEALED
        for axes in rows:
            axes.axvline(at, color=colour, lw=0.7, ls="-" if mark.is_set else ":")
    names = _name(rows[0], [mark for mark in envelope.marks if mark.is_set][:_NAMED], envelope.begin_ns)
    figure.set_figheight(figure.get_figheight() + 0.11 * names)
    if not traces:
        rows[0].set_title("nothing has changed", fontsize=8, loc="left")
        notes.append("nothing has changed in it")
    rows[-1].set_xlabel("t [s]; red: a DTC is set, green: healed; dashed: limit; shaded: the test fails", fontsize=8)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    save(figure, path)
    return notes
