"""The tables of what a paper has and what comes out here, which stand beside the pages of docs as text."""

from dataclasses import astuple
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def text(command, claims):
    """Return the text of a table, with the command that makes it."""
    rows = [("", "paper", "here", ""), *map(astuple, claims)]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    widths.append(0)
    lines = ["  ".join(each.ljust(w) for each, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([f"What a reader of the paper looks for; {command}", "", *lines, ""])


def check(name, command, claims):
    """Compare a table with its file; another one is written beside it."""
    path = DOCS / name
    made = text(command, claims)
    if not path.exists() or path.read_text(encoding="utf-8") != made:
        path.with_suffix(".new").write_text(made, encoding="utf-8")
        raise AssertionError(f"{path} is not what {command} makes; if that is right, take {path.with_suffix('.new')}")
