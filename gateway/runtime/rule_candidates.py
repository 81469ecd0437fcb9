"""Which known rules fit frames of a message: for a check that no frame passes, the rule may be another one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gateway.signals.bits import field_of, mask_of
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.crc import KNOWN
from gateway.signals.protection.e2e import PROFILES, E2eCheck
from gateway.signals.protection.judge import FRAME_CONSTANT, FRAME_OK, judge_frame
from gateway.signals.protection.params import COUNTERS, signal_of
from gateway.signals.protection.protection import Counter, Protection, compiled
from gateway.signals.protection.rules import RULES, Frame
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message


def _candidates(message: Message) -> Iterator[tuple[str, Checksum]]:
    """Yield known checksums by the text that a configuration has for them."""
    for name, rule in RULES.items():
        made = rule(Frame(message.frame_id, message.is_extended_frame, message.length))
        yield f'checksum = "{name}"', made
    low, high = message.frame_id & 0xFF, message.frame_id >> 8 & 0xFF
    for name, crc in KNOWN.items():
        text = f'crc = {{ algorithm = "{name}"'
        yield f"{text} }}", Checksum(crc)
        yield f"{text}, data_id = 0x{message.frame_id & 0xFFFF:X} }}", Checksum(crc, after=(low, high))
        yield f'{text}, data_id = {{ bytes = [{low}, {high}], place = "before" }} }}', Checksum(crc, before=(low, high))
        yield f'{text}, data_id = {{ bytes = [{high}, {low}], place = "after" }} }}', Checksum(crc, after=(high, low))
    for kind in ("sum", "xor"):
        for of in ("bytes", "nibbles"):
            text = f'checksum = {{ rule = "{kind}", of = "{of}" }}'
            yield text, Checksum(xor=kind == "xor", nibbles=of == "nibbles")


def _judged(asked: Protection, payloads: Sequence[bytes]) -> list[tuple[int, int, int]]:
    """Return what :func:`judge_frame` says of each payload."""
    words = [np.frombuffer(data.ljust(64, b"\0"), "<u8").copy() for data in payloads]
    made = compiled(asked)
    return [judge_frame(each, len(data), *made) for each, data in zip(words, payloads, strict=True)]


def differing(asked: Protection, payloads: Sequence[bytes]) -> list[str]:
    """Return which constants of the header are others in all payloads, their checksums being right, in words."""
    judged = _judged(asked, payloads)
    said = []
    for k, (_, _, name) in enumerate(asked.constants):
        received = {int(value) for value, _, verdict in judged if verdict == FRAME_CONSTANT + k}
        if len(received) == 1 and all(verdict == FRAME_CONSTANT + k for _, _, verdict in judged):
            expected = int(judged[0][1])
            said.append(f"{name}: received 0x{received.pop():X}, configured 0x{expected:X}")
    return said


def fitting_modes(message: Message, asked: E2eCheck, payloads: Sequence[bytes]) -> list[str]:
    """Return the same profile with other modes of its data id that all payloads have, as a configuration says it."""
    found = []
    for mode in PROFILES[asked.profile].modes:
        other = asked.model_copy(update={"data_id_mode": mode})
        if all(verdict == FRAME_OK for _, _, verdict in _judged(other.protection(message), payloads)):
            text = f'profile = "{asked.profile}", data_id = {asked.data_id}, data_id_mode = "{mode}"'
            found.append(f"e2e = {{ {text} }}")
    return found


def fitting(message: Message, field: np.void, payloads: Sequence[bytes]) -> list[str]:
    """Return the known checksums that all payloads have, as a configuration says them.

    Args:
        message: that the payloads are of.
        field: where the checksum lies, a record of :class:`gateway.signals.bits.Field`.
        payloads: different ones; with four of them a checksum of 8 bits fits by chance once in 4 x 10^9.
    """
    counter = None
    try:
        signal = signal_of(message, None, COUNTERS, "counter")
        counter = Counter(field_of(signal), 1 << signal.length)
    except InputError:
        pass  # then no rule with a list of data ids can fit
    assert mask_of(field)
    found: list[str] = []
    for text, checksum in _candidates(message):
        if checksum.crc is not None and checksum.crc.width != field["length"]:
            continue
        if all(verdict == FRAME_OK for _, _, verdict in _judged(Protection(checksum, field, counter), payloads)):
            found.append(text)
    return found
