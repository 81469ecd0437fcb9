"""The status socket as a reader sees it: messages of one line, some with bytes after it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

#: Longest line or block that is believed [byte].
MOST_BYTES = 16 << 20


class Garbled(Exception):
    """The received bytes are not a daemon's."""


class Splitter:
    """Cuts a stream of bytes into messages."""

    def __init__(self) -> None:
        self._heard = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Take what came; yields the messages that are complete: fields and block.

        Raises:
            Garbled: it is no message.
        """
        self._heard += data
        while (end := self._heard.find(b"\n")) >= 0:
            try:
                message = json.loads(bytes(self._heard[:end]))
                size = int(message.get("size", 0))
            except (ValueError, AttributeError, TypeError) as error:
                raise Garbled("no message of a gateway") from error
            if not 0 <= size <= MOST_BYTES:
                raise Garbled("a block that is too large")
            if len(self._heard) < end + 1 + size:
                return
            block = bytes(self._heard[end + 1 : end + 1 + size])
            del self._heard[: end + 1 + size]
            yield message, block
        if len(self._heard) > MOST_BYTES:
            raise Garbled("a line that is too long")
