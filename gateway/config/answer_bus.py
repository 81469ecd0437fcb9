"""The bus of the answers that come on another bus: ``answers:<bus>``, which nothing opens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from gateway.signals.database import Database


class Page(NamedTuple):
    """Page of an answer.

    Attributes:
        can_id: of its frames, with EXTENDED.
        start: its first byte of the answer's data.
        length: most bytes of the answer in it.
    """

    can_id: int
    start: int
    length: int


@dataclass(frozen=True)
class AnswerBus:
    """The bus of the answers that come on another bus.

    Attributes:
        database: its messages, a page each.
        pages: of each ECU: (service, identifier) of the request -> pages of the answer.
        lengths: of each ECU: (service, identifier) of the request -> length of the layout [byte].
        left_out: signals that are not decoded, with the reason, one line each.
    """

    database: Database
    pages: tuple[Mapping[tuple[int, int], tuple[Page, ...]], ...]
    lengths: tuple[Mapping[tuple[int, int], int], ...]
    left_out: tuple[str, ...]
