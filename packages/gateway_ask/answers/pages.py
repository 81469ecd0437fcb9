"""Answers as messages of a bus ``answers:<bus>``: the database of that bus, and where each answer goes.

A frame carries at most 64 bytes, and an answer may be longer: it is cut into pages, a message each. The first byte of a
page is the number of the answer's bytes in it, and the multiplexer of all signals: where an answer is shorter than its
layout, those signals are there that fit. Pages overlap, so that each signal lies whole in one of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.bus.frames import EXTENDED
from gateway.config.answer_bus import AnswerBus, Page
from gateway.signals.database import Database
from gateway_ask.answers.model import AnswerLayout
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Bytes of an answer in a page at most; from one page to the next: a signal of 64 bits has bits in 9 bytes at most.
MOST, STRIDE = 63, 55
#: Name of the multiplexer.
BYTES = "AnswerBytes"
#: An identifier is the slot of an ECU's page, service and identifier of the request.
SLOT_BITS, SLOTS = 22, 128

#: Layouts of one ECU's answers, by service and identifier of the request.
Layouts = Mapping[tuple[int, int], AnswerLayout]


def answer_bus(ecus: Sequence[tuple[str, Layouts]]) -> AnswerBus:
    """Return the bus of the answers of ECUs.

    Names of messages that several ECUs have begin with the ECU's: ``battery_Cells``.

    Raises:
        InputError: there are more pages than slots.
    """
    count = Counter(name for _, layouts in ecus for name in {one.message.name for one in layouts.values()})
    messages: list[Message] = []
    pages, lengths, left_out = [], [], list[str]()
    slot = 0
    for ecu, layouts in ecus:
        own: dict[tuple[int, int], tuple[Page, ...]] = {}
        longest = max((_count(layout.message.length) for layout in layouts.values()), default=0)
        if slot + longest > SLOTS:
            text = f"more than {SLOTS} ECUs and pages of {STRIDE} bytes of their answers on one bus"
            raise InputError(text, value=ecu)
        for key, layout in layouts.items():
            name = layout.message.name
            made, lost = _paged(layout, slot, f"{ecu}_{name}" if count[name] > 1 else name)
            messages += [message for message, _ in made]
            own[key] = tuple(page for _, page in made)
            left_out += [f"{ecu}: {text}" for text in lost]
        pages.append(own)
        lengths.append({key: layout.message.length for key, layout in layouts.items()})
        slot += longest
    return AnswerBus(
        Database([(message, Path()) for message in messages]), tuple(pages), tuple(lengths), tuple(left_out)
    )


def _count(length: int) -> int:
    """Return the number of pages of a layout of this length [byte]."""
    return 1 if length <= MOST else 1 + -(-(length - MOST) // STRIDE)


def _extent(signal: Signal) -> tuple[int, int]:
    """Return the first byte of a signal, and the one behind its last."""
    start = int(signal.start)
    first = start // 8
    if signal.byte_order == "big_endian":
        start = 8 * first + 7 - start % 8
    return first, (start + int(signal.length) + 7) // 8


def _paged(layout: AnswerLayout, slot: int, name: str) -> tuple[list[tuple[Message, Page]], list[str]]:
    """Return the pages of a layout, and what is in none of them."""
    from cantools.database.can import Message  # noqa: PLC0415 - takes a while to load

    total = layout.message.length
    pages = [
        Page(
            EXTENDED | (slot + k) << SLOT_BITS | layout.service << 16 | layout.identifier,
            k * STRIDE,
            min(MOST, max(total - k * STRIDE, 1)),
        )
        for k in range(_count(total))
    ]
    chosen: list[list[Signal]] = [[] for _ in pages]
    of_page: dict[str, int] = {}
    lost = []
    by_name = {signal.name: signal for signal in layout.message.signals}
    for signal in layout.message.signals:
        first, end = _extent(signal)
        k = min(first // STRIDE, len(pages) - 1)
        outer = signal.multiplexer_signal
        while outer is not None and _extent(by_name[outer])[0] // STRIDE == k:
            outer = by_name[outer].multiplexer_signal
        if signal.length > 64 or end - pages[k].start > MOST:
            lost.append(f"{name}.{signal.name}: {signal.length} bits, more than 64")
        elif outer is not None:
            lost.append(f"{name}.{signal.name}: its multiplexer {outer} is more than {STRIDE} bytes away")
        else:
            chosen[k].append(signal)
            of_page[signal.name] = k
    made = []
    for k, page in enumerate(pages):
        message = Message(
            frame_id=page.can_id & ~EXTENDED,
            name=name if not k else f"{name}_{k + 1}",
            length=1 + page.length,
            signals=_multiplexed(chosen[k], page),
            comment=layout.message.comment,
            is_extended_frame=True,
            is_fd=True,
            strict=False,
        )
        made.append((message, page))
    return made, lost


def _multiplexed(signals: Sequence[Signal], page: Page) -> list[Signal]:
    """Return the signals of a page, each behind the multiplexer: there when all its bytes have come."""
    from cantools.database.can.signal import Signal as Made  # noqa: PLC0415 - takes a while to load

    name = BYTES
    while any(signal.name == name for signal in signals):
        name += "_"
    made = [Made(name, 0, 8, is_multiplexer=True)]
    for signal in signals:
        own = copy(signal)
        own.start = signal.start + 8 * (1 - page.start)
        if signal.multiplexer_signal is None:
            need = max(_extent(each)[1] for each in _within(signal, signals)) - page.start
            own.multiplexer_signal = name
            own.multiplexer_ids = list(range(need, page.length + 1))
        made.append(own)
    return made


def _within(signal: Signal, signals: Sequence[Signal]) -> list[Signal]:
    """Return a signal, and those that it multiplexes."""
    found = [signal]
    for outer in found:
        found += [each for each in signals if each.multiplexer_signal == outer.name]
    return found
