"""Layouts of the answers to diagnostic requests: which bits of an answer are which signal.

An answer to a request ``22 F1 90`` is ``62 F1 90`` and data. Its layout is a message of a database, whose bits count
from the first byte after the identifier, so that all that is done with signals of frames is done with those of answers.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from gateway.config.ecu import request_name

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Bits of a signal that the decoder reads, at most.
LONGEST_SIGNAL = 64


@dataclass(frozen=True)
class Address:
    """Address of an ECU on ISO-TP.

    Attributes:
        request: identifier of requests, with EXTENDED if it has 29 bits.
        response: identifier of its answers; None: the file does not say.
        extended: address byte before the transport's own in requests (extended addressing); None: there is none.
        tester: the same in answers.
    """

    request: int
    response: int | None = None
    extended: int | None = None
    tester: int | None = None


class Limits(NamedTuple):
    """Physical values of a signal that a file calls no values, or unlikely; None: it does not say.

    Attributes:
        void_low: at most this: the signal carries no value.
        void_high: at least this: the signal carries no value.
        low: below this the value is unlikely.
        high: above this the value is unlikely.
    """

    void_low: float | None = None
    void_high: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class AnswerLayout:
    """Layout of the answers to one request.

    Attributes:
        service: of the request: 0x22, 0x01, 0x21, 0x09 ...
        identifier: DID (0..0xFFFF) or PID (0..0xFF).
        message: extended, its identifier ``service << 16 | identifier``; bits count from the first byte after the
            identifier; its length is what its signals need [byte], and may be more than 64.
        address: ECU that answers so; None: any.
        limits: by the names of signals.
        every_s: how often the file asks for it [s]; None: it does not say.
    """

    service: int
    identifier: int
    message: Message
    address: Address | None = None
    limits: Mapping[str, Limits] = field(default_factory=dict)
    every_s: float | None = None

    @property
    def name(self) -> str:
        """Return the request as hexadecimal digits, as people write it: 22F190, 010C."""
        return request_name(self.service, self.identifier)


class LeftOut(NamedTuple):
    """A part of a file that has no layout.

    Attributes:
        where: in the file: request, signal.
        why: in words.
    """

    where: str
    why: str


class Layouts(NamedTuple):
    """Contents of a file of layouts.

    Attributes:
        layouts: in the file's order.
        left_out: what has none.
    """

    layouts: tuple[AnswerLayout, ...]
    left_out: tuple[LeftOut, ...] = ()


def signal_of(
    name: str,
    start: int,
    length: int,
    *,
    big: bool,
    signed: bool = False,
    real: bool = False,
    scale: float = 1,
    offset: float = 0,
    texts: Mapping[int, str] | None = None,
    unit: str | None = None,
    limits: tuple[float, float] | None = None,
    comment: str = "",
) -> Signal:
    """Return a signal of a layout.

    Args:
        name: of the signal.
        start: as databases number bits: of the lowest one, big-endian of the highest one.
        length: its bits.
        big: most significant bit first.
        signed: whether its number has a sign.
        real: whether it is a floating-point number.
        scale: factor of the number.
        offset: what is added [unit].
        texts: number -> its meaning.
        unit: of the value.
        limits: least and greatest value that the file gives [unit].
        comment: for people.
    """
    from cantools.database.can.signal import Signal  # noqa: PLC0415 - takes a while to load
    from cantools.database.conversion import BaseConversion  # noqa: PLC0415
    from cantools.database.namedsignalvalue import NamedSignalValue  # noqa: PLC0415

    named = OrderedDict((number, NamedSignalValue(number, text)) for number, text in (texts or {}).items())
    low, high = limits or (None, None)
    return Signal(
        name,
        start,
        length,
        "big_endian" if big else "little_endian",
        is_signed=signed,
        conversion=BaseConversion.factory(scale, offset, named or None, is_float=real),  # type: ignore[arg-type]
        minimum=low,
        maximum=high,
        unit=unit,
        comment=comment or None,
    )


def message_of(service: int, identifier: int, signals: Sequence[Any], *, name: str = "", comment: str = "") -> Message:
    """Return the message of a layout.

    Args:
        service: of the request.
        identifier: DID or PID.
        signals: of cantools, shape (signals,); bits count from the first byte after the identifier.
        name: of the message; "": the request's.
        comment: for people.
    """
    from cantools.database.can import Message  # noqa: PLC0415 - takes a while to load

    ends = [bits_needed(signal) for signal in signals]
    return Message(
        frame_id=service << 16 | identifier,
        name=name or f"A_{request_name(service, identifier)}",
        length=-(-max(ends, default=0) // 8),
        signals=list(signals),
        comment=comment or None,
        is_extended_frame=True,
        strict=False,
    )


def bits_needed(signal: Any) -> int:
    """Return how many bits of a payload a signal needs."""
    start = int(signal.start)
    if signal.byte_order == "big_endian":
        start = 8 * (start // 8) + 7 - start % 8
    return start + int(signal.length)


def layouts_for(layouts: Iterable[AnswerLayout], address: Address) -> dict[tuple[int, int], AnswerLayout]:
    """Return the layouts of one ECU's answers, by service and identifier; its own win over those of any ECU."""
    chosen: dict[tuple[int, int], AnswerLayout] = {}
    for layout in sorted(layouts, key=lambda each: each.address is not None):
        own = layout.address
        if own is None or (own.request, own.extended) == (address.request, address.extended):
            chosen[layout.service, layout.identifier] = layout
    return chosen
