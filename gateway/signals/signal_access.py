"""One signal of one message in payloads that are there: read, written, the protection renewed over it.

For faults that are put into frames, recorded or on their way, and for values that a user sets by hand.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, Frames
from gateway.signals.columns import put_column
from gateway.signals.database import Database
from gateway.signals.decode import decode
from gateway.signals.payloads import columns, message_rows
from gateway.signals.protection.protection import Protection, compiled, protect, protect_again, sent_before
from gateway.signals.tables import SignalRef, compile_plan

Words = NDArray[np.uint64]


class ChangedMessage:
    """A message whose frames are changed.

    Args:
        bus: index of its bus.
        database: of the bus.
        message: its name.
        protection: kept right over what is changed.
        pgn: buses whose extended identifiers match by PGN.

    Raises:
        InputError: the bus has no such message.
    """

    def __init__(
        self, bus: int, database: Database, message: str, protection: Protection, pgn: Collection[int] = ()
    ) -> None:
        self.bus = bus
        found = database.message(message)
        self.can_id = found.frame_id | (EXTENDED if found.is_extended_frame else 0)
        self._plan = compile_plan([(bus, database)], [], messages=[(bus, message)], pgn=pgn)
        self.protection, self.tables = compiled(protection)
        self._least = 0

    @property
    def counts(self) -> bool:
        """Whether its frames have an alive counter or a freshness value."""
        return bool(self.protection.has_counter or (self.protection.secured and self.protection.fresh.bits))

    def among(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames are of the message, shape (n,)."""
        return np.asarray(message_rows(frames, self._plan) == 0, np.bool_)

    def sent_before(self, words: Words) -> int:
        """Return how many frames were sent before, as :func:`gateway.signals.protection.protection.sent_before`.

        Of SecOC each frame is to be asked of, in order: what is sent is the end of a longer number.
        """
        self._least = int(sent_before(words, self.protection, self._least))
        return self._least

    def renew(self, words: Words, length: int, sent: int | None = None) -> None:
        """Put the checksum right over a payload that was changed; ``sent``: with another counter."""
        if self.protection.has_checksum or sent is not None:
            sent = self.sent_before(words) if sent is None else sent
            protect(words, length, sent, self.protection, self.tables)

    def renew_all(self, words: Words, lengths: NDArray[np.int64], where: NDArray[np.bool_]) -> None:
        """Put the checksums right over payloads, shape (frames, 8), where they were changed."""
        if self.protection.has_checksum:
            kept = where.view(np.uint8)
            self._least = int(protect_again(words, lengths, kept, self.protection, self.tables, self._least))


class ChangedSignal:
    """A signal of 1 to 64 bits of a message.

    Raises:
        InputError: the message has no such signal.
    """

    def __init__(self, bus: int, database: Database, message: str, signal: str) -> None:
        # Of several signals of one name each frame has the one of its branch.
        names = [one.name for one in database.joined(message).get(signal, ())]
        refs = [SignalRef(bus, message, name) for name in (signal, *names)]
        self._plan = compile_plan([(bus, database)], refs, messages=[(bus, message)])
        self._place, *self._branches = [self._plan.position(*ref) for ref in refs]
        rows = [self._plan.signals[place] for place in self._branches or [self._place]]
        self._rows: list[Any] = [row if hasattr(row, "word") else row.view(np.recarray) for row in rows]
        self.row = self._rows[0]

    def value(self, words: Words, length: int) -> float:
        """Return the value in a payload, shape (8,), of this length [byte]; NaN where the frame does not carry it."""
        values, present = self._decoded(words, length)
        return float(values[self._place]) if present[self._place] else float("nan")

    def _decoded(self, words: Words, length: int) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        plan = self._plan
        count = int(plan.messages[0]["count"])
        values, present = np.full(count, np.nan), np.zeros(count, np.uint8)
        decode(words, length, 0, plan.messages, plan.signals, plan.mux_ids, values, present)
        return values, present

    def values(self, frames: Frames) -> NDArray[np.float64]:
        """Return what the signal has in each frame of its message, NaN where one does not carry it."""
        return columns(frames, self._plan, 0)[:, self._place]

    def put_all(self, words: Words, values: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
        """Write values into payloads, shape (frames, 8), where they are asked for."""
        if not self._branches:
            put_column(words, self.row, values, where)
            return
        there = np.array([self._decoded(one, words[0].nbytes)[1] for one in words]).reshape(len(words), -1) == 1
        for place, row in zip(self._branches, self._rows, strict=True):
            put_column(words, row, values, where & there[:, place])

    def put(self, words: Words, value: float) -> None:
        """Write a value over any bits; an integer signal takes the nearest that it can carry."""
        self.put_all(words.reshape(1, 8), np.array([value]), np.ones(1, np.bool_))


def words_of(frame: np.void) -> Words:
    """Return a frame's payload as 8 words: a copy."""
    return np.ascontiguousarray(frame["data"]).view("<u8").copy()
