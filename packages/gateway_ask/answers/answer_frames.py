"""From an answer to frames of its bus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gateway.bus.frames import FD, Frames, empty, joined, put
from gateway.config.answer_bus import Page
from gateway.config.ecu import PAGES, READ_SERVICES, TWO_BYTES
from gateway_ask.answers.monitor_tests import LENGTH, laid_out
from gateway_ask.answers.obd_on_uds import as_classic, classic, classic_length, on_uds

#: Added to the service of a request in a positive answer; a negative answer.
POSITIVE, NEGATIVE = 0x40, 0x7F


def framed(data: bytes, pages: tuple[Page, ...], t_ns: int, bus: int) -> Frames:
    """Return the frames of an answer: its pages that have come.

    Args:
        data: of the answer, behind service and identifier.
        pages: of its layout.
        t_ns: when it was complete.
        bus: index of the bus of the answers.
    """
    came = [page for page in pages if len(data) > page.start]
    frames = empty(len(came))
    for k, page in enumerate(came):
        part = data[page.start : page.start + page.length]
        padded = bytes([len(part)]) + part.ljust(page.length, b"\0")
        put(frames, k, t_ns, page.can_id, padded, bus=bus, flags=FD)
    return frames


def records(data: bytes, lengths: Mapping[tuple[int, int], int]) -> Iterator[tuple[tuple[int, int], bytes]]:
    """Yield what a positive answer has: (service, identifier) of the request, and its data.

    Several identifiers in one answer are told apart by the lengths of their layouts, where these end where the answer
    does. Else all of it is of the first one: a shorter or a longer answer than its layout.

    Args:
        data: the answer, from the service on.
        lengths: of the layouts that are known [byte].
    """
    service = data[0] - POSITIVE
    size = 2 if service in TWO_BYTES else 1
    rest, several = data[1:], []
    while rest:
        key = (service, int.from_bytes(rest[:size], "big"))
        length = lengths.get(key)
        if len(rest) < size or length is None or len(rest) < size + length:
            break
        several.append((key, rest[size : size + length]))
        rest = rest[size + length :]
    if several and not rest:
        yield from several
    elif len(data) > size:
        yield (service, int.from_bytes(data[1 : 1 + size], "big")), data[1 + size :]


class FrameEncoder:
    """Answers of one ECU into frames.

    Args:
        pages: of the ECU: (service, identifier) -> pages.
        lengths: of the ECU's layouts.
        bus: index of the bus of the answers.

    An answer of OBD on UDS has the layout of classic OBD, where it has none of its own.

    Attributes:
        bus: it.
        counts: answers of each kind: decoded, shorter or longer than their layout, without a layout, negative.
    """

    def __init__(
        self, pages: Mapping[tuple[int, int], tuple[Page, ...]], lengths: Mapping[tuple[int, int], int], bus: int
    ) -> None:
        self._pages, self._lengths, self.bus = pages, lengths, bus
        obd = {on_uds(*key): classic_length(key[0], n) for key, n in lengths.items() if key[0] in PAGES}
        self._found = {**obd, **lengths}
        self.counts = dict.fromkeys(("decoded", "shorter", "longer", "unknown", "negative"), 0)

    def frames(self, answer: bytes, t_ns: int) -> Frames:
        """Return the frames of an answer, none of one that has no layout.

        Args:
            answer: from the service on, not empty.
            t_ns: when it was complete.
        """
        if answer[0] == NEGATIVE:
            self.counts["negative"] += 1
        if answer[0] - POSITIVE not in READ_SERVICES:
            return empty(0)
        made = []
        for found, said in records(answer, self._found):
            key = found if found in self._lengths else classic(*found) or found
            data = said if key == found else as_classic(*key, said)
            length = self._lengths.get(key)
            if length is None:
                self.counts["unknown"] += 1
                continue
            if key[0] == 0x06 and length == LENGTH:  # as many results as there are
                data = laid_out(data)
                length = len(data)
            self.counts["decoded" if len(data) == length else "longer" if len(data) > length else "shorter"] += 1
            made.append(framed(data, self._pages[key], t_ns, self.bus))
        return joined(made)
