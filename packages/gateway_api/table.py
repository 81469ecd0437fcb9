"""A table of results: columns of NumPy, and Arrow for programs that take it (pandas, polars, DuckDB)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.common.extras import need
from gateway_fdi.errors import MissingError, named

#: Rows, and characters of a cell, that are shown.
SHOWN, WIDEST = 20, 60


class Table(Mapping[str, "NDArray[Any]"]):
    """Columns by their names, all of one length; ``dict(table)`` for pandas, or the table itself for Arrow.

    Args:
        columns: name -> values, shape (rows,).
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = dict(columns)

    @classmethod
    def of(cls, types: Mapping[str, type], rows: Iterable[Sequence[Any]]) -> Table:
        """Return a table of rows.

        Args:
            types: name of each column -> str (an array of objects), float (None is NaN), int or bool.
            rows: a value for each column.
        """
        columns = list(zip(*rows, strict=True)) or [()] * len(types)
        return cls(
            {
                name: np.array(values, object if type_ is str else type_)
                for (name, type_), values in zip(types.items(), columns, strict=True)
            }
        )

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._columns:
            raise MissingError(named("the columns are", name, self._columns), value=name)
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self._columns.values()), ()))

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield the rows, each by the names of the columns."""
        values = [column.tolist() for column in self._columns.values()]
        for row in zip(*values, strict=True):
            yield dict(zip(self._columns, row, strict=True))

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the table by Arrow's PyCapsule protocol.

        Raises:
            InputError: pyarrow is not installed.
        """
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    def to_arrow(self) -> Any:
        """Return a ``pyarrow.Table``.

        Raises:
            InputError: pyarrow is not installed.
        """
        need("parquet", "Arrow tables")
        import pyarrow as pa  # noqa: PLC0415 - slow to load, and an extra

        text = pa.string()
        return pa.table({k: pa.array(x, text if x.dtype == object else None) for k, x in self._columns.items()})

    def _shown(self) -> list[list[str]]:
        columns = [[_text(value) for value in column[:SHOWN].tolist()] for column in self._columns.values()]
        return [list(row) for row in zip(*columns, strict=True)]

    def __repr__(self) -> str:
        lines = [list(self._columns), *self._shown()]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        text = "\n".join(
            "  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
        )
        return text + self._rest()

    def _rest(self) -> str:
        return f"\n... {self.rows} rows" if self.rows > SHOWN else ""

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(name)}</th>" for name in self._columns)
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in self._shown())
        rest = f"<p>{escape(self._rest().strip())}</p>" if self._rest() else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{rest}"


def _text(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."
