"""Multiplexer values as ranges: DBC writes ``SG_MUL_VAL_ ... 0-4294967295``, cantools keeps each number by itself.

Wide ranges are taken out of the text before cantools reads it, and put back as :class:`Ranges`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from cantools.database.can import Message

#: A range of more numbers is wide.
WIDE = 16
_STATEMENT = re.compile(
    r"^([ \t]*SG_MUL_VAL_\s+(\d+)\s+(\w+)\s+(\w+)\s+)(\d+\s*-\s*\d+(?:\s*,\s*\d+\s*-\s*\d+)*)(?=\s*;)", re.M
)
_FLAG = 1 << 31

Pairs = list[tuple[int, int]]
#: (identifier with DBC's flag, name of a signal) -> ranges of the multiplexer values that select it.
Wide = dict[tuple[int, str], Pairs]


class Ranges(Sequence[int]):
    """Whole numbers, in order, kept as pairs of least and greatest; pairs that are given may overlap."""

    def __init__(self, pairs: Iterable[tuple[int, int]]) -> None:
        self.pairs: Pairs = []
        for low, high in sorted(pairs):
            if self.pairs and low <= self.pairs[-1][1] + 1:
                self.pairs[-1] = self.pairs[-1][0], max(high, self.pairs[-1][1])
            else:
                self.pairs.append((low, high))
        self._count = sum(high - low + 1 for low, high in self.pairs)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[int]:
        for low, high in self.pairs:
            yield from range(low, high + 1)

    def __contains__(self, value: object) -> bool:
        return any(low <= value <= high for low, high in self.pairs) if isinstance(value, int | float) else False

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> list[int]: ...
    def __getitem__(self, index: int | slice) -> int | list[int]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        at = index if index >= 0 else len(self) + index
        for low, high in self.pairs:
            if 0 <= at <= high - low:
                return low + at
            at -= high - low + 1
        raise IndexError(index)

    def __repr__(self) -> str:
        return f"Ranges({self.pairs})"


def runs(values: Iterable[int]) -> Pairs:
    """Return whole numbers as ranges, (least, greatest) each, in order."""
    return values.pairs if isinstance(values, Ranges) else Ranges((value, value) for value in values).pairs


def narrowed(text: str) -> tuple[str, Wide]:
    """Return a DBC file with the first number of each range only, where one is wide, and all ranges."""
    found: Wide = {}
    for _, number, signal, _, ranges in _STATEMENT.findall(text):
        pairs = [(int(low), int(high)) for low, high in (one.split("-") for one in ranges.split(","))]
        found.setdefault((int(number), signal), []).extend(pairs)
    if not any(high - low >= WIDE for pairs in found.values() for low, high in pairs):
        return text, {}
    return _STATEMENT.sub(lambda one: one[1] + re.sub(r"(\d+)\s*-\s*\d+", r"\1-\1", one[5]), text), found


def widened(messages: Iterable[Message], wide: Wide, long: dict[tuple[int, str], str]) -> None:
    """Give the signals of messages (:mod:`gateway.signals.compact`) the ranges that were taken out of their file.

    ``long``: (identifier, name in the file) -> name of the signal, where that is another one.
    """
    mine: dict[int, dict[str, Pairs]] = defaultdict(dict)
    for (number, name), pairs in wide.items():
        mine[number][long.get((number, name), name)] = pairs
    for message in messages:
        ranges = mine.get(message.frame_id | (_FLAG if message.is_extended_frame else 0), {})
        for signal in message.signals:
            if signal.name in ranges:
                every = Ranges([*ranges[signal.name], *runs(signal.multiplexer_ids or ())])
                signal.multiplexer_ids = every  # type: ignore[assignment]
        if ranges:
            message.refresh(strict=False)
