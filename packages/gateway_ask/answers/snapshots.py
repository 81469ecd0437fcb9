"""Snapshots of DTCs (UDS 0x19 04) whose identifiers are those of OBD on UDS: 22 F4xx, as PIDs of SAE J1979."""

from __future__ import annotations

from gateway.config.ecu import PAGES
from gateway_ask.answers.j1979 import TRIMS, j1979
from gateway_ask.answers.names import values_in_words


def snapshots_in_words(data: bytes) -> list[str]:
    """Return the records of an answer for people: "record 1: ECT 170 degC"; none: an identifier is not of OBD.

    Args:
        data: behind the DTC and its status: of each record its number, how many identifiers, each with its data.
    """
    return _records(data, of_trims=1) or _records(data, of_trims=2) or []


def _records(data: bytes, of_trims: int) -> list[str] | None:
    """Return the records, a trim with this many bytes; None: they are not of OBD, or do not end where the data do."""
    layouts = {PAGES[layout.service] | layout.identifier: layout for layout in j1979()}
    found, at = [], 0
    while at + 2 <= len(data):
        (number, count), words = data[at : at + 2], []
        at += 2
        if not count:
            return None
        for _ in range(count):
            layout = layouts.get(int.from_bytes(data[at : at + 2], "big"))
            if layout is None:
                return None
            length = of_trims if layout.identifier in TRIMS else layout.message.length
            words.append(values_in_words(layout, data[at + 2 : at + 2 + length]))
            at += 2 + length
        found.append(f"record {number}: {', '.join(words)}")
    return found if at == len(data) else None
