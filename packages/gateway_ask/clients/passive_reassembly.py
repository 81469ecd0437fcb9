"""Messages of one sender, put together from frames that are only heard: flow control is the other side's business."""

from __future__ import annotations

from gateway.isotp.edges import CONSECUTIVE, FIRST, MOST_SHORT, SINGLE, judge

#: Longest time between two frames of a message (ISO 15765-2, N_Cr) [ns].
N_CR_NS = 1_000_000_000


class Reassembler:
    """Puts messages together by the stamps of their frames, so that a log gives what was heard live.

    A message that is cut (by another one, by a wrong sequence number, by silence) is counted, and left out.

    Args:
        address: byte before the transport's own in each frame (extended addressing); None: there is none.
        most: longest message [byte].

    Attributes:
        errors: frames that break ISO-TP, and messages that were cut or too long.
        too_long: whether the last frame began a message that is too long.
    """

    def __init__(self, address: int | None = None, most: int = MOST_SHORT) -> None:
        self._address = b"" if address is None else bytes([address])
        self._most = most
        self._data = bytearray()
        self._length = self._number = 0
        self._last_ns = 0
        self.errors, self.too_long = 0, False

    @property
    def receiving(self) -> bool:
        """Whether a message of several frames is under way."""
        return self._length > 0

    def take(self, data: bytes, t_ns: int) -> bytes | None:
        """Take a frame; returns the message that it completes, None: none."""
        before, self.too_long = len(self._address), False
        if data[:before] != self._address:
            return None
        judged = judge(data[before:], before).data
        if not judged:
            self.errors += 1
            return None
        if self._length and t_ns - self._last_ns > N_CR_NS:
            self._cut()
        kind = judged[0] >> 4
        if kind == CONSECUTIVE:
            return self._go_on(judged, t_ns)
        if kind in (SINGLE, FIRST) and self._length:
            self._cut()
        if kind == SINGLE:
            return self._single(judged, classic=len(data) <= 8)
        if kind == FIRST:
            self._begin(judged, t_ns)
        return None

    def _cut(self) -> None:
        self._length = 0
        self.errors += 1

    def _single(self, data: bytes, *, classic: bool) -> bytes | None:
        length, start = (data[0] & 0x0F, 1) if classic else (data[1] if data[0] == 0 else 0, 2)
        if not 0 < length <= len(data) - start:
            self.errors += 1
            return None
        return data[start : start + length]

    def _begin(self, data: bytes, t_ns: int) -> None:
        length, start = (data[0] & 0x0F) << 8 | data[1], 2
        if not length:
            length, start = int.from_bytes(data[2:6], "big"), 6
        if length > self._most:
            self.errors, self.too_long = self.errors + 1, True
            return
        self._data[:] = data[start:]
        self._length, self._number, self._last_ns = length, 0, t_ns

    def _go_on(self, data: bytes, t_ns: int) -> bytes | None:
        if not self._length:
            return None  # of a message whose begin was not heard, or that was cut
        self._number = (self._number + 1) & 0xF
        if data[0] & 0xF != self._number:
            self._cut()
            return None
        self._data += data[1:]
        self._last_ns = t_ns
        if len(self._data) < self._length:
            return None
        whole = bytes(self._data[: self._length])
        self._length = 0
        return whole
