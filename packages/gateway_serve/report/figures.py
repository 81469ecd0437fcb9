"""The figures of a report, by bokeh."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from bokeh.core.json_encoder import serialize_json
from bokeh.document import Document
from bokeh.models import ColumnDataSource, HoverTool, Range1d
from bokeh.plotting import figure

from gateway_serve.report.collect import STEP_NS, Collector

BAND, BAD, INK, EDGE = "#3d7fc0", "#b3261e", "#55616e", "#dfe4ea"
HEIGHT = 190
#: Times the limit at which an axis ends.
FAR = 10.0
_ID = re.compile(r'"id": ?"(p\d+)"')


@dataclass(frozen=True)
class Figure:
    """A figure with its place in the page and its description, for people who do not see it."""

    place: str
    model: Any
    text: str


def documents(figures: Sequence[Figure]) -> tuple[str, str]:
    """Return the figures as JSON for BokehJS, and which goes where; the same figures give the same text."""
    document = Document()
    for each in figures:
        document.add_root(each.model)
    text = serialize_json(document.to_json(deferred=False))
    numbers: dict[str, str] = {}

    def renamed(found: re.Match[str]) -> str:
        return f'"id": "{numbers.setdefault(found[1], f"f{len(numbers)}")}"'

    text = _ID.sub(renamed, text)
    roots = {numbers[each.model.id]: each.place for each in figures}
    return _safe(text), _safe(json.dumps([{"docid": "report", "roots": roots, "root_ids": list(roots)}]))


def _safe(text: str) -> str:
    """Return JSON that cannot end the script that it stands in."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _blank() -> Any:
    # Without a title: one that the browser sets goes on in a second line where there is no room.
    made: Any = figure(height=HEIGHT, sizing_mode="stretch_width", toolbar_location=None, tools="")
    made.background_fill_color = made.border_fill_color = None
    made.outline_line_color = None
    for axis in (*made.xaxis, *made.yaxis):
        axis.axis_line_color = axis.major_tick_line_color = EDGE
        axis.minor_tick_line_color = None
        axis.major_label_text_color = axis.axis_label_text_color = INK
        axis.axis_label_text_font_style = "normal"
    for grid in (*made.xgrid, *made.ygrid):
        grid.grid_line_color = EDGE
    return made


def band(columns: Iterable[tuple[float, float, Any]], unit: str = "", *, marks: Sequence[float] = ()) -> Any:
    """Return a residual over time.

    Args:
        columns: middle and width [s], and the bucket.
        unit: of the residual; "": none.
        marks: times to be marked [s].
    """
    rows = list(columns)
    # A limit is to be seen beside values that are far beyond it: the axis ends before these.
    end = FAR * max((abs(float(row["limit"])) for _, _, row in rows), default=0.0)
    beyond = end > 0 and any(max(abs(float(row["low"])), abs(float(row["high"]))) > end for _, _, row in rows)
    data = {
        "x": [_short(x) for x, _, _ in rows],
        "w": [_short(w) for _, w, _ in rows],
        "low": [_short(row["low"]) for _, _, row in rows],
        "high": [_short(row["high"]) for _, _, row in rows],
        "limit": [_short(row["limit"]) for _, _, row in rows],
        "near": [_short(row["ratio"]) for _, _, row in rows],
        "c": [BAD if row["ratio"] >= 1 else BAND for _, _, row in rows],
    }
    made = _blank()
    source = ColumnDataSource(data)
    bars = made.vbar(
        x="x", width="w", top="high", bottom="low", fill_color="c", line_color="c", fill_alpha=0.75, source=source
    )
    made.line(x="x", y="limit", line_color=BAD, line_dash=[6, 4], line_width=1.6, source=source)
    if marks:
        made.vspan(x="x", line_color=INK, line_dash="dotted", source=ColumnDataSource({"x": list(marks)}))
    shown = [("time", "@x s"), ("values", "@low to @high"), ("limit", "@limit"), ("times the limit", "@near")]
    made.add_tools(HoverTool(renderers=[bars], tooltips=shown))
    made.xaxis.axis_label = "s"
    if unit:
        made.yaxis.axis_label = unit
    if beyond:
        low = min(float(row[name]) for _, _, row in rows for name in ("low", "limit"))
        high = max(float(row[name]) for _, _, row in rows for name in ("high", "limit"))
        made.y_range = Range1d(start=max(low, -end), end=min(high, end))
    return made


def load(found: Collector, bus: int, rates: tuple[int | None, int | None]) -> tuple[Any, str]:
    """Return how busy a bus was, and in what unit: share of time where the bit rate is known, else kbit/s."""
    width = found.width_ns / 1e9
    places = sorted(found.loads)
    if rates[0]:
        values = [
            found.loads[k][bus][0] / rates[0] / width + (found.loads[k][bus][1] / rates[1] / width if rates[1] else 0.0)
            for k in places
        ]
        unit = "share of time"
    else:
        values = [float(found.loads[k][bus][:2].sum()) / width / 1e3 for k in places]
        unit = "kbit/s; no bit rate is configured"
    made = _blank()
    data = {
        "x": [_short((k * found.width_ns - found.first_ns) / 1e9 + width / 2) for k in places],
        "top": [_short(v) for v in values],
    }
    made.vbar(x="x", top="top", width=width, fill_color=BAND, line_color=BAND, source=ColumnDataSource(data))
    made.xaxis.axis_label = "s"
    return made, unit


def columns_of(found: Collector, fault: int) -> list[tuple[float, float, Any]]:
    """Return the columns of a fault over the whole run: middle and width [s], bucket."""
    width = found.width_ns / 1e9
    return [
        ((place * found.width_ns - found.first_ns) / 1e9 + width / 2, width, buckets[fault])
        for place, buckets in sorted(found.columns.items())
        if buckets[fault]["count"] > 0 and buckets[fault]["numbers"] > 0
    ]


def fine_columns(columns: dict[int, Any], first_ns: int) -> list[tuple[float, float, Any]]:
    """Return the columns around a failure: middle and width [s], bucket."""
    width = STEP_NS / 1e9
    return [((k * STEP_NS - first_ns) / 1e9 + width / 2, width, row) for k, row in sorted(columns.items())]


def _short(value: float) -> float:
    return float(f"{float(value):.7g}")
