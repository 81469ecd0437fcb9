"""What a frame says by its database, signal by signal: cantools reads the bits of each one alone.

cantools itself takes a message whole: it refuses a frame whose multiplexer selects nothing, and chooses a branch by the
scaled value of the multiplexer instead of its raw one. So here it has messages of one signal, without multiplexing.
"""

from copy import copy
from functools import cache

import cantools.database.can as can_database


@cache
def _alone(signal):
    own = copy(signal)
    own.multiplexer_ids = own.multiplexer_signal = None
    own.is_multiplexer = False
    return can_database.Message(1, "alone", 64, [own], is_fd=True, strict=False)


def end(signal):
    """Return the byte behind the last of a signal."""
    start = signal.start
    if signal.byte_order == "big_endian":
        start = 8 * (start // 8) + 7 - start % 8
    return (start + signal.length + 7) // 8


def value(signal, body, *, scaling=True):
    """Return the value of a signal as if it were in a payload."""
    padded = bytes(body).ljust(64, b"\0")
    return _alone(signal).decode(padded, decode_choices=False, scaling=scaling)[signal.name]


def unclear(message, body):
    """Return whether two multiplexers of one name in a payload say different things: nobody knows what they select."""
    selecting = {signal.multiplexer_signal for signal in message.signals}
    raws = said(message, body, scaling=False)
    return any(len({*raws.get(name, ())}) > 1 for name in selecting)


def said(message, body, *, scaling=True):
    """Return the values that a payload has: name -> those of all signals of the name that are there."""
    there = {}

    def is_there(signal):
        if id(signal) not in there:
            there[id(signal)] = False  # of a circle nothing is there
            found = end(signal) <= len(body)
            if found and signal.multiplexer_signal is not None:
                outer = [one for one in message.signals if one.name == signal.multiplexer_signal]
                found = any(is_there(one) and raw(one) in (signal.multiplexer_ids or []) for one in outer)
            there[id(signal)] = found
        return there[id(signal)]

    def raw(signal):
        number = value(signal, body, scaling=False)
        return number % (1 << signal.length)

    found = {}
    for signal in message.signals:
        if signal.length <= 64 and is_there(signal):
            found.setdefault(signal.name, []).append(value(signal, body) if scaling else raw(signal))
    return found
