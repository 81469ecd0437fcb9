"""Exact names: of messages that share one, and of signals of one name in several multiplex branches.

A database may give one name to several messages, or to signals in several branches of a multiplexer. Each of them has
an exact name beside it, made of what tells them apart: ``Wheel_0x123`` by the identifier, ``Temp_m1`` by the
multiplexer value as DBC writes it. Exact names can be written wherever a configuration, a rule or a command has names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from copy import copy
from typing import TYPE_CHECKING

from gateway.signals.ranges import Ranges, runs

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Names that CANdb++ writes shorter than they are: identifier, name in the file, whole name.
_LONG = re.compile(r'^BA_ +"SystemSignalLongSymbol" +SG_ +(\d+) +(\w+) +"([^"\n]*)"', re.MULTILINE)
_FLAG = 1 << 31
#: Protocol of a J1939 message of one source.
ONE_SOURCE = "j1939 of one source"
#: Name of a message of one source: that of the database, and the identifier.
_OF_SOURCE = re.compile(r"(\w+)_0x([0-9A-F]{4,8})")
#: Attributes by which a signal says where its bits are and what they mean.
_SAYS = (
    "name", "start", "length", "byte_order", "is_signed", "is_float", "scale", "offset", "unit", "choices",
    "is_multiplexer", "multiplexer_ids", "multiplexer_signal",
)  # fmt: skip


def exact_signals(message: Message) -> tuple[Message, dict[str, tuple[Signal, ...]]]:
    """Return a message whose signals of one name have exact names (itself if it has none of these), and such names.

    The latter are those that several signals had -> these signals, renamed.
    """
    by_name: dict[str, list[Signal]] = {}
    for signal in message.signals:
        by_name.setdefault(signal.name, []).append(signal)
    if len(by_name) == len(message.signals):
        return message, {}
    taken, joined, own = set(by_name), dict[str, tuple["Signal", ...]](), dict[int, "Signal"]()
    for name, mine in by_name.items():
        if len(mine) > 1:
            found = next(found for found in _names(name, mine) if len({*found} - taken) == len(mine))
            taken.update(found)
            joined[name] = tuple(map(renamed, mine, found))
            own |= {id(signal): exact for signal, exact in zip(mine, joined[name], strict=True)}
    made = copy(message)
    made._signals = [own.get(id(signal), signal) for signal in message.signals]
    made.refresh(strict=False)
    return made, joined


def _names(name: str, signals: Sequence[Signal]) -> Iterator[list[str]]:
    """Yield exact names of signals, the shortest first; the last ones differ in any case."""
    ids = [f"_m{runs(signal.multiplexer_ids)[0][0]}" if signal.multiplexer_ids else "" for signal in signals]
    yield [f"{name}{branch}" for branch in ids]
    yield [f"{name}_{signal.multiplexer_signal}{branch}" for signal, branch in zip(signals, ids, strict=True)]
    yield [f"{name}_bit{signal.start}{branch}" for signal, branch in zip(signals, ids, strict=True)]
    begin = 1
    while True:
        yield [f"{name}_{begin + k}" for k in range(len(signals))]
        begin += 1


def needs(signal: Signal) -> int:
    """Return the length from which on a payload has all bits of a signal [byte]."""
    start = signal.start
    if signal.byte_order == "big_endian":
        start = 8 * (start // 8) + 7 - start % 8
    return (start + signal.length + 7) // 8


def sticks_out(message: Message, signal: Signal) -> bool:
    """Return whether a signal needs more bytes than its message has."""
    return needs(signal) > message.length


def renamed(signal: Signal, name: str) -> Signal:
    """Return a signal under another name."""
    own = copy(signal)
    own.name = name
    return own


def together(name: str, signals: Sequence[Signal]) -> Signal:
    """Return what several signals of one name are together: the first, there where any of them is."""
    own = renamed(signals[0], name)
    if len({signal.multiplexer_signal for signal in signals}) == 1:
        every = Ranges(pair for signal in signals for pair in runs(signal.multiplexer_ids or ()))
        own.multiplexer_ids = every or None  # type: ignore[assignment]
    else:
        own.multiplexer_signal = own.multiplexer_ids = None
    return own


def exact_name(message: Message) -> str:
    """Return the name of a message with its identifier."""
    return f"{message.name}_0x{message.frame_id:X}"


def of_source(message: Message, can_id: int) -> Message:
    """Return a J1939 message as one source sends it: known by that identifier and source, not by its group alone."""
    own = copy(message)
    own.frame_id = can_id
    own.name = f"{message.name}_0x{can_id:X}"
    own._protocol = ONE_SOURCE
    return own


def source_named(name: str) -> tuple[str, int] | None:
    """Return the message and the identifier that the exact name of a source has; None: it is none."""
    found = _OF_SOURCE.fullmatch(name)
    return None if found is None else (found[1], int(found[2], 16))


def same(one: Message, other: Message) -> bool:
    """Return whether two messages say the same of their frames."""
    return _said(one) == _said(other)


def _said(message: Message) -> list[object]:
    signals = [tuple(str(getattr(signal, key)) for key in _SAYS) for signal in message.signals]
    return [message.length, *sorted(signals)]


def long_names(text: str) -> dict[tuple[int, str], str]:
    """Return the names that CANdb++ writes shorter than they are: (identifier as in the file, name) -> whole name."""
    return {(int(number), short): whole for number, short, whole in _LONG.findall(text)}


def repair_references(messages: list[Message], text: str) -> list[Message]:
    """Return the messages of a DBC file, each multiplexed signal with the multiplexer that it has in the file.

    cantools gives a multiplexer the long name that CANdb++ keeps beside one of 32 letters, but leaves the short one
    with the signals that it selects; they would be lost.
    """
    long: dict[tuple[int, str], str] = {}
    for message in messages:
        known = {None, *(signal.name for signal in message.signals)}
        lost = [signal for signal in message.signals if signal.multiplexer_signal not in known]
        long = long or (long_names(text) if lost else {})
        for signal in lost:
            key = message.frame_id | (_FLAG if message.is_extended_frame else 0), signal.multiplexer_signal or ""
            signal.multiplexer_signal = long.get(key, signal.multiplexer_signal)
        if lost:
            message.refresh(strict=False)
    return messages
