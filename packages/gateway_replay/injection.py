"""Faults put into recorded frames: answers of the gateway if this sensor, or this sender, failed.

A fault of a signal leaves the message's protection right, as the sender would: it is computed again over the changed
payload. A fault of the frame does not.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ID_MASK, Frames
from gateway.common.times import NEVER
from gateway.engine.checks.communication import CheckInstance
from gateway.signals.database import Database
from gateway.signals.protection.params import protection_for
from gateway.signals.protection.protection import Protection
from gateway.signals.signal_access import ChangedMessage, ChangedSignal
from gateway_fdi.errors import InputError, nearest
from gateway_replay.injected_frames import ALONE, BESIDE, InjectedFrames

#: Of a frame: it does not come; the one before comes again; each is as the first; one bit is wrong.
FRAME_KINDS = ("drop", "repeat", "freeze", "flip")
#: Of a signal: it stays; something is added; it is multiplied; it has one value; something is added and taken off in
#: turn; so much more is added each second.
SIGNAL_KINDS = ("stuck", "offset", "scale", "value", "jump", "drift")
#: Of another sender beside the message's own (see gateway_replay.injected_frames).
ADDED_KINDS = (*BESIDE, ALONE)
#: Of these, those that want a number; and kinds of another sender that may have one.
_NUMBERED, _MAY = ("offset", "scale", "value", "jump", "drift", "forge"), ("replay", ALONE)

_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_TEXT = re.compile(
    r"(?P<kind>[a-z]+) +(?P<target>[^\s=]+)(?: *= *(?P<value>[^\s]+))?"
    rf"(?: +@ *(?P<first>{_NUMBER})(?: *\.\. *(?P<last>{_NUMBER}))?)?\s*"
)

#: Form of an injection, for messages of errors.
USAGE = 'e.g. "drop SPEED @10..12", "offset SPEED.SPEED=40 @10": KIND MESSAGE[.SIGNAL][=VALUE] [@FROM[..TO] seconds]'


@dataclass(frozen=True)
class Injection:
    """A fault that is put into frames.

    Attributes:
        kind: of FRAME_KINDS, SIGNAL_KINDS or ADDED_KINDS.
        bus: index of the bus.
        message: its name; of ``unknown`` the identifier, as 0x3A1.
        signal: its name, None for a fault of the frame.
        value: added, or the signal's own; signal's unit, of a drift in each second. Of a replay how old it is [s], of
            ``unknown`` a second.
        from_s, to_s: when, from the log's first frame on [s]; to_s None: to its end.
    """

    kind: str
    bus: int
    message: str
    signal: str | None = None
    value: float = 0.0
    from_s: float = 0.0
    to_s: float | None = None


def parse_injection(text: str, names: Sequence[str], databases: Sequence[Database]) -> Injection:
    """Read a fault as the command line has it.

    Raises:
        InputError: it is none, or names what is not there.
    """
    key = "--inject"
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise InputError(USAGE, key=key, value=text)
    kind = found["kind"]
    kinds = (*FRAME_KINDS, *SIGNAL_KINDS, *ADDED_KINDS)
    if kind not in kinds:
        raise InputError(f"the kinds are {', '.join(kinds)}{nearest(kind, kinds)}; {USAGE}", key=key, value=text)
    bus, parts = _bus_of(found["target"].split("."), names)
    of_signal = kind in SIGNAL_KINDS or kind == "forge"
    if len(parts) != (2 if of_signal else 1):
        wanted = "Message.Signal" if of_signal else "Message"
        what = "signal" if of_signal else "whole message"
        raise InputError(f"{kind} is a fault of a {what}, {wanted}; {USAGE}", key=key, value=text)
    if (found["value"] is not None) != (kind in _NUMBERED) and kind not in _MAY:
        wanted = "wants a" if kind in _NUMBERED else "has no"
        raise InputError(f"{kind} {wanted} value; {USAGE}", key=key, value=text)
    try:
        bus = _refused_or_bus(kind, bus, parts, databases)
        numbers = [float(found[name]) if found[name] else None for name in ("value", "first", "last")]
    except InputError as error:
        raise InputError(error.message, key=key, value=text) from error
    except ValueError as error:
        raise InputError(f"this is no number; {USAGE}", key=key, value=text) from error
    value, first, last = numbers
    if last is not None and last <= (first or 0.0):
        raise InputError("it ends before it begins", key=key, value=text)
    if kind in _MAY and value is not None and not 0.0 < value < 1e6:
        raise InputError("a number above 0", key=key, value=text)
    return Injection(kind, bus, parts[0], parts[1] if of_signal else None, value or 0.0, first or 0.0, last)


def _refused_or_bus(kind: str, bus: int, parts: Sequence[str], databases: Sequence[Database]) -> int:
    """Return the bus of a target.

    Raises:
        InputError: it has no such message or signal.
        ValueError: the target of ``unknown`` is no identifier.
    """
    if kind == ALONE:
        if not 0 <= int(parts[0], 0) <= ID_MASK:
            raise InputError("an identifier has 29 bits", value=parts[0])
        return max(bus, 0)
    bus = _having(parts[0], bus, databases)
    databases[bus].message(parts[0])
    if len(parts) == 2:
        databases[bus].signal(parts[0], parts[1])
    return bus


def _bus_of(parts: list[str], names: Sequence[str]) -> tuple[int, list[str]]:
    """Return the bus that a name begins with, -1 if with none, and the rest."""
    if parts[0] in names and len(parts) > 1:
        return list(names).index(parts[0]), parts[1:]
    return -1, parts


def _having(message: str, bus: int, databases: Sequence[Database]) -> int:
    if bus >= 0:
        return bus
    having = [k for k, database in enumerate(databases) if database.has(message)]
    if len(having) > 1:
        raise InputError("several buses have this message: name the bus before it, bus.Message", value=message)
    return having[0] if having else 0


class Injector:
    """Puts a fault into frames, batch after batch.

    Args:
        asked: the fault.
        databases: of the buses.
        checks: of messages, whose protection is kept right by a fault of a signal.
        rng: source of all randomness.
        start_ns: the log's first stamp; None: that of the first batch.
        pgn: buses whose extended identifiers match by PGN.

    Attributes:
        bus: index of the bus.
        count: frames that it has changed, taken out or added.
    """

    def __init__(
        self,
        asked: Injection,
        databases: Sequence[Database],
        checks: Sequence[CheckInstance],
        rng: np.random.Generator,
        start_ns: int | None = None,
        pgn: Collection[int] = (),
    ) -> None:
        self._asked, self._rng, self._start_ns = asked, rng, start_ns
        self.bus, self.count = asked.bus, 0
        self._added = InjectedFrames(rng)
        self._signal = self._change = self._message = None
        self._held, self._turn, self._from_ns = np.nan, 1.0, 0
        if asked.kind == ALONE:
            return
        mine = [check for check in checks if (check.bus, check.params.message) == (asked.bus, asked.message)]
        database = databases[asked.bus]
        protection = protection_for(database.message(asked.message), mine[0].params) if mine else Protection()
        self._message = ChangedMessage(asked.bus, database, asked.message, protection, pgn)
        if asked.signal is not None:
            self._signal = ChangedSignal(asked.bus, database, asked.message, asked.signal)
        self._change = _OF_FRAME[asked.kind](rng) if asked.kind in _OF_FRAME else None

    def apply(self, frames: Frames) -> Frames:
        """Return the frames with the fault in them."""
        if not len(frames):
            return frames
        if self._start_ns is None:
            self._start_ns = int(frames["t_ns"][0])
        from_ns = self._from_ns = self._start_ns + round(self._asked.from_s * 1e9)
        to_ns = NEVER if self._asked.to_s is None else self._start_ns + round(self._asked.to_s * 1e9)
        if self._message is None:
            can_id = int(self._asked.message, 0)
            frames, count = self._added.alone(frames, self.bus, can_id, self._asked.value, from_ns, to_ns)
            self.count += count
            return frames
        mine = self._message.among(frames)
        hit = mine & (frames["t_ns"] >= from_ns) & (frames["t_ns"] < to_ns)
        if self._asked.kind in BESIDE:
            more = (frames[mine], hit[mine], self._asked.value, self._forge)
            frames, count = self._added.beside(self._asked.kind, frames, *more)
            self.count += count
            return frames
        self.count += int(hit.sum())
        if self._asked.kind == "drop":
            return frames[~hit]
        if not mine.any():
            return frames
        frames = frames.copy()
        places = np.flatnonzero(mine)
        if self._change is None:
            self._change_signal(frames, places, hit[places])
            return frames
        for k in places:
            self._change(frames[k : k + 1], bool(hit[k]))
        return frames

    def _forge(self, frames: Frames) -> None:
        """Give the signal in frames of its message another value."""
        self._change_signal(frames, np.arange(len(frames)), np.ones(len(frames), np.bool_))

    def _change_signal(self, frames: Frames, places: NDArray[np.intp], hit: NDArray[np.bool_]) -> None:
        """Give the signal in frames of its message the values that the fault gives it, where it is hit."""
        assert self._signal is not None
        assert self._message is not None
        mine = frames[places]
        now = self._signal.values(mine)
        carries = ~np.isnan(now)  # else the frame does not carry the signal
        words = np.ascontiguousarray(mine["data"]).view("<u8").reshape(len(mine), 8)
        where = hit & carries
        since_s = (mine["t_ns"] - self._from_ns) * 1e-9
        self._signal.put_all(words, self._faulty(now, where, carries, since_s), where)
        self._message.renew_all(words, mine["length"].astype(np.int64), where)
        mine["data"] = words.view(np.uint8).reshape(len(mine), -1)
        frames[places] = mine

    def _faulty(
        self,
        now: NDArray[np.float64],
        where: NDArray[np.bool_],
        carries: NDArray[np.bool_],
        since_s: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return what the fault makes of values, where it is to; ``since_s``: times since it began."""
        kind, value = self._asked.kind, self._asked.value
        if kind == "stuck":
            held = np.empty(len(now))
            for k in range(len(now)):
                if carries[k] and (not where[k] or np.isnan(self._held)):
                    self._held = now[k]
                held[k] = self._held
            return held
        if kind == "value":
            return np.full(len(now), value)
        if kind == "scale":
            return now * value
        if kind in ("offset", "forge"):
            return now + value
        if kind == "drift":
            return now + value * since_s
        turns = np.cumsum(where)  # the first one down, then in turn
        signs = self._turn * np.where(turns % 2 == 1, -1.0, 1.0)
        if turns[-1] % 2 == 1:
            self._turn = -self._turn
        return now + signs * value


class _Repeat:
    """Every second frame comes with the payload of the one before."""

    def __init__(self, _rng: np.random.Generator) -> None:
        self._before: Any = None
        self._turn = False

    def __call__(self, frame: Frames, hit: bool) -> None:
        original = frame[0].copy()
        self._turn = hit and not self._turn
        if self._turn and self._before is not None:
            _copy(frame, self._before)
        self._before = original


class _Freeze:
    """Each frame comes with the payload of the last good one."""

    def __init__(self, _rng: np.random.Generator) -> None:
        self._before: Any = None

    def __call__(self, frame: Frames, hit: bool) -> None:
        if hit and self._before is not None:
            _copy(frame, self._before)
        else:
            self._before = frame[0].copy()


class _Flip:
    """One bit of each frame is wrong."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, frame: Frames, hit: bool) -> None:
        bits = 8 * int(frame["length"][0])
        if hit and bits:
            bit = int(self._rng.integers(bits))
            frame["data"][0, bit // 8] ^= np.uint8(1 << bit % 8)


def _copy(frame: Frames, other: Any) -> None:
    frame["data"][0], frame["length"][0] = other["data"], other["length"]


_OF_FRAME: dict[str, Callable[[np.random.Generator], Callable[[Frames, bool], None]]] = {
    "repeat": _Repeat,
    "freeze": _Freeze,
    "flip": _Flip,
}
