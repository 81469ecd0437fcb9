"""Results of a study: tables with a column a quantity for people, one JSON document for programs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

from rich.markup import escape
from rich.table import Table

from gateway.cli.present import print_json, wide_console

Row = TypeVar("Row")


def headed(title: str, texts: Iterable[str], numbers: Iterable[str] = ()) -> Table:
    """Return a table without rows; units in brackets, which rich takes for markup, are shown as they are.

    Args:
        title: of it.
        texts: headers of the first columns.
        numbers: headers of the columns after them, which are set right.
    """
    table = Table(*map(escape, texts), title=escape(title))
    for name in numbers:
        table.add_column(escape(name), justify="right")
    return table


def tabulate(
    title: str, rows: Iterable[Row], columns: Mapping[str, Callable[[Row], object]], *, texts: int = 1
) -> Table:
    """Return a table with a line for each row.

    Args:
        title: of it.
        rows: of the study.
        columns: header -> what a row shows there.
        texts: number of the first columns that are texts; the others are numbers.
    """
    headers = list(columns)
    table = headed(title, headers[:texts], headers[texts:])
    for row in rows:
        table.add_row(*(str(shown(row)) for shown in columns.values()))
    return table


@dataclass(frozen=True)
class Claim:
    """A statement of a paper that its reader looks for.

    Attributes:
        what: a figure, a table or a conclusion.
        paper: what it has.
        here: what comes out here.
        verdict: "reproduced"; or that it is not, and why.
    """

    what: str
    paper: str
    here: str
    verdict: str


def claim(what: str, paper: str, here: str, holds: bool, why: str = "") -> Claim:
    """Return a claim; ``why``: the reason that is told where it does not hold."""
    return Claim(what, paper, here, "reproduced" if holds else f"not reproduced: {why}" if why else "not reproduced")


def beside(claims: Iterable[Claim]) -> Table:
    """Return the table of what a paper has, and what comes out here."""
    columns: dict[str, Callable[[Claim], object]] = {
        "what": lambda row: row.what,
        "paper": lambda row: row.paper,
        "here": lambda row: row.here,
        "verdict": lambda row: row.verdict,
    }
    return tabulate("The paper, and here", claims, columns, texts=4)


def show(
    document: Mapping[str, Any],
    tables: Iterable[Table],
    notes: Iterable[str] = (),
    *,
    files: Sequence[Path] = (),
    json: bool,
) -> int:
    """Print a study's results; returns the exit code.

    Args:
        document: for programs; rows are dictionaries, or dataclasses.
        tables: for people.
        notes: after the tables: what their columns say.
        files: pictures that were drawn.
        json: whether the document is printed.
    """
    if json:
        print_json({**{key: _plain(value) for key, value in document.items()}, "files": [str(file) for file in files]})
        return 0
    console = wide_console()
    for each in (*tables, *notes, *(f"drawn: {file}" for file in files)):
        console.print(each)
    return 0


def _plain(value: Any) -> Any:
    """Return a value of a document as JSON has it."""
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
