"""Pages of a layout: parts of at most 64 bytes, as frames carry them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING, NamedTuple

from gateway.answers.model import AnswerLayout, bits_needed, message_of

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Bytes that a frame carries.
PAGE = 64
#: Bits of a signal that the decoder reads, at most.
LONGEST_SIGNAL = 64


class Page(NamedTuple):
    """A part of a layout that a frame can carry.

    Attributes:
        first: byte of the answer's data that its own first one is.
        message: with the signals that lie in it, their bits counted from its own first byte.
    """

    first: int
    message: Message


def pages(layout: AnswerLayout) -> tuple[Page, ...]:
    """Return a layout as pages, which overlap where a signal would not lie whole in one.

    A multiplexer is in the page of what depends on it. :func:`unreachable` names signals that are in none.
    """
    message = layout.message
    lost = set(unreachable(message))
    by_name = {signal.name: signal for signal in message.signals}
    families: dict[str, list[Signal]] = {}
    for signal in message.signals:
        if signal.name not in lost:
            families.setdefault(_root(signal, by_name).name, []).append(signal)
    groups: list[list[Signal]] = []
    opened = 0
    for family in sorted(families.values(), key=_first_byte):
        if not groups or max(map(bits_needed, family)) > 8 * (opened + PAGE):
            # A layout that fits into one page keeps its bytes' numbers.
            opened = 0 if max(map(bits_needed, family)) <= 8 * PAGE else _first_byte(family)
            groups.append([])
        groups[-1] += family
    if len(groups) == 1 and not lost and message.length <= PAGE:
        return (Page(0, message),)
    return tuple(_page(layout, group) for group in groups)


def unreachable(message: Message) -> list[str]:
    """Return the signals that no page can carry.

    They have more than 64 bits, or lie too far from their multiplexer.
    """
    by_name = {signal.name: signal for signal in message.signals}
    found = []
    for signal in message.signals:
        root = _root(signal, by_name)
        near = _first_byte([root]) <= _first_byte([signal]) and bits_needed(signal) <= 8 * (_first_byte([root]) + PAGE)
        if signal.length > LONGEST_SIGNAL or not near:
            found.append(signal.name)
    return found


def _first_byte(signals: Sequence[Signal]) -> int:
    return min(int(signal.start) // 8 for signal in signals)


def _root(signal: Signal, by_name: dict[str, Signal]) -> Signal:
    while signal.multiplexer_signal is not None:
        signal = by_name[signal.multiplexer_signal]
    return signal


def _page(layout: AnswerLayout, group: Sequence[Signal]) -> Page:
    """Return a page of some signals of a layout."""
    first = _first_byte(group) if max(map(bits_needed, group)) > 8 * PAGE else 0
    moved = []
    for signal in group:
        other = copy(signal)
        other.start = signal.start - 8 * first
        moved.append(other)
    return Page(first, message_of(layout.service, layout.identifier, moved, name=layout.message.name))
