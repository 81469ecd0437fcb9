"""A page of a fleet as one file without scripts: its frame and its tables."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from gateway_fdi.errors import InputError

_STYLE = (
    ":root{color-scheme:light dark}body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:75rem;"
    "padding:0 1rem}.wide{overflow-x:auto}table{border-collapse:collapse;margin:1rem 0;width:100%}"
    "td,th{padding:.25rem .8rem .25rem 0;border-bottom:1px solid #8886;text-align:left;vertical-align:top;"
    "overflow-wrap:anywhere;min-width:4rem}th{border-bottom:2px solid #888}.lead{font-size:1.25rem;font-weight:600}"
    ".strip{position:relative;height:1.6rem;border-bottom:1px solid #888;margin:0 .5rem}.strip i{position:absolute;"
    "bottom:.2rem;width:.6rem;height:.6rem;margin-left:-.3rem;border-radius:50%;background:#3d7fc0aa}"
    ".strip i.odd{background:#b3261e}.axis{display:flex;justify-content:space-between;gap:1rem;font-size:.87rem}"
    "@media(max-width:40rem){body{margin:1rem auto}thead{display:none}tr{display:block;border-bottom:1px solid #8886;"
    "padding:.4rem 0}td{display:flex;gap:.6rem;border:0;padding:.1rem 0}td::before{content:attr(data-of);flex:0 0 6rem;"
    "opacity:.75}}"
)
#: Rows of a table at most.
_MOST = 200


def write(out: Path, title: str, parts: Sequence[str]) -> None:
    """Write a page.

    Raises:
        InputError: it cannot be written.
    """
    text = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style><h1>{escape(title)}</h1>{''.join(parts)}</html>\n"
    )
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(error.strerror or str(error), file=out) from error


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table; on a phone each row is a block."""
    if not rows:
        return "<p>None.</p>"
    names = [escape(name.replace("_", " ")) for name in rows[0]]
    head = "".join(f"<th>{name}</th>" for name in names)
    lines = "".join(
        "<tr>"
        + "".join(f'<td data-of="{n}">{escape(shown(v))}</td>' for n, v in zip(names, row.values(), strict=True))
        + "</tr>"
        for row in rows[:_MOST]
    )
    more = f"<p>and {len(rows) - _MOST} more</p>" if len(rows) > _MOST else ""
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead>{lines}</table></div>{more}'


def shown(value: Any) -> str:
    """Return a value as people read it."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)
