"""The harness of a virtual ECU: the faults that its frames get on their way to the bus.

Frames come in chunks, in order of time; a fault keeps its memory (since when, the value that it holds) from chunk to
chunk, so that a run all at once and one step by step are the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, EXTENDED, ID_MASK, Frames, empty
from gateway.signals.bits import mask_of
from gateway.signals.columns import limits
from gateway.signals.database import Database
from gateway.signals.protection.protection import Protection
from gateway.signals.signal_access import ChangedMessage, ChangedSignal, words_of
from gateway_bench.vecu.conditions import Condition, within
from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.databases import database_of
from gateway_bench.vecu.message_faults import EcuKind, Effect, MessageFault, SignalKind
from gateway_bench.vecu.wire_faults import WireKind, disturbed
from gateway_checks.signal.parts import no_value
from gateway_fdi.errors import InputError, named, under

Mask = NDArray[np.bool_]
#: Kind -> what the wire calls it.
_WIRE: dict[str, WireKind] = {"lost": "lost", "late": "late", "doubled": "duplicated", "short": "short"}


class Sender:
    """Messages that an ECU sends; looked up when it is asked for.

    Args:
        bus: index of its bus.
        files: databases of the bus.
        sends: returns message -> how it is protected; None: any message of the bus.
        known: database, message -> its protection, of an ECU that does not say it.
    """

    def __init__(
        self,
        bus: int,
        files: Sequence[Path],
        sends: Callable[[], Mapping[str, Protection]] | None,
        known: Callable[[Database, str], Protection],
    ) -> None:
        self.bus = bus
        self._files, self._sends, self._known = files, sends, known

    @cached_property
    def database(self) -> Database:
        """The messages of its bus."""
        return database_of(self._files)

    @cached_property
    def _protections(self) -> Mapping[str, Protection] | None:
        return None if self._sends is None else self._sends()

    def has(self, message: str) -> bool:
        """Return whether it sends a message, as far as that is known."""
        if self._protections is not None:
            return message in self._protections
        return any(one.name == message for one in self.database)

    def message(self, name: str) -> ChangedMessage:
        """Return a message that is to be changed.

        Raises:
            InputError: it is not sent; names close ones.
        """
        if self._protections is None:
            protection = self._known(self.database, name)
        elif name in self._protections:
            protection = self._protections[name]
        else:
            raise InputError(named("the messages sent are", name, self._protections), value=name)
        return ChangedMessage(self.bus, self.database, name, protection)

    def signal(self, name: str) -> ChangedSignal:
        """Return a signal "Message.Signal" that is to be changed.

        Raises:
            InputError: there is none; names close ones.
        """
        message, _, own = name.rpartition(".")
        if not message:
            raise InputError('a signal is named "Message.Signal"', value=name)
        return ChangedSignal(self.bus, self.database, message, own)


class _Fault(ABC):
    """A fault that is active between two times, while its condition holds."""

    def __init__(self, fault: MessageFault, condition: Condition | None) -> None:
        self.fault, self.condition = fault, condition
        self._first_ns, self._count = -1, 0

    def active(self, t_ns: NDArray[np.int64]) -> Mask:
        """Return at which of some times it is active."""
        return within(t_ns, self.fault.from_s, self.fault.to_s, self.condition)

    def end(self, now_ns: int) -> None:
        """End it now, if it has not ended yet."""
        to_s = now_ns * 1e-9
        if self.fault.to_s is None or self.fault.to_s > to_s:
            self.fault = self.fault.model_copy(update={"to_s": to_s})

    def note(self, t_ns: NDArray[np.int64]) -> None:
        """Note frames that it concerned."""
        if len(t_ns):
            self._first_ns = int(t_ns[0]) if self._first_ns < 0 else self._first_ns
            self._count += len(t_ns)

    @property
    def truth(self) -> list[Truth]:
        """Its injected faults so far."""
        return [Truth(self._first_ns, self.fault.kind, self._count)] if self._count else []

    @abstractmethod
    def apply(self, frames: Frames, end_ns: int) -> Frames:
        """Return frames with the fault in them; ``end_ns``: of the chunk."""


class _OfSignal(_Fault):
    def __init__(
        self, fault: MessageFault, condition: Condition | None, sender: Sender, rng: np.random.Generator
    ) -> None:
        super().__init__(fault, condition)
        self._message = sender.message(str(fault.target))
        name = str(fault.signal)
        self._signal = sender.signal(name)
        if mask_of(self._signal.row) & int.from_bytes(self._message.protection.owned.tobytes(), "little"):
            raise InputError("the message's protection makes this signal: kinds counter, checksum", value=name)
        self._effect = Effect(fault.kind, self._size(fault, sender), rng)

    def _size(self, fault: MessageFault, sender: Sender) -> float:
        """Return the size, or the value that the database has for it.

        Raises:
            InputError: it has none.
        """
        if fault.size is not None:
            return fault.size
        name = str(fault.signal)
        message, _, own = name.rpartition(".")
        signal, (low, high) = sender.database.signal(message, own), limits(self._signal.row)
        if fault.kind == "sna":
            texts = no_value(signal)
            if texts:
                return texts[0]
            if np.isfinite(high) and not signal.is_signed:
                return high if signal.scale > 0 else low  # all bits 1
            raise InputError(
                "which value says that there is none? The database has no such text: give size", value=name
            )
        if fault.kind == "out_of_range":
            if signal.maximum is not None and np.isfinite(high) and high > float(signal.maximum):
                return high
            if signal.minimum is not None and np.isfinite(low) and low < float(signal.minimum):
                return low
            text = "its bits carry no value out of the range that the database gives; give a size, or another kind"
            raise InputError(text, value=name)
        return 0.0

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        mine = np.flatnonzero(self._message.among(frames))
        hit = self.active(frames["t_ns"][mine])
        if hit.any():
            frames = frames.copy()
        changed = []
        for k, active in zip(mine, hit, strict=True):
            words, length = words_of(frames[k]), int(frames[k]["length"])
            self._message.sent_before(words)  # of SecOC it is asked of each frame
            now = self._signal.value(words, length)
            if np.isnan(now):
                continue  # this frame does not carry it
            value = self._effect(now, int(frames[k]["t_ns"]), active=bool(active))
            if active:
                self._signal.put(words, value)
                self._message.renew(words, length)
                frames[k]["data"] = words.view(np.uint8)
                changed.append(int(k))
        self.note(frames["t_ns"][changed])
        return frames


class _OfProtection(_Fault):
    def __init__(self, fault: MessageFault, condition: Condition | None, sender: Sender) -> None:
        super().__init__(fault, condition)
        self._message = sender.message(str(fault.target))
        row = self._message.protection
        if not (self._message.counts if fault.kind == "counter" else row.has_checksum):
            raise InputError(f"its protection has no {fault.kind}", value=fault.message)
        self._good: int | None = None  # the counter in the last frame before
        self._wrong = 0

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        mine = np.flatnonzero(self._message.among(frames))
        hit = self.active(frames["t_ns"][mine])
        if hit.any():
            frames = frames.copy()
        for k, active in zip(mine, hit, strict=True):
            words = words_of(frames[k])
            if not active:
                self._good, self._wrong = self._message.sent_before(words), 0
                continue
            if self.fault.kind == "checksum":
                words ^= np.frombuffer(mask_of(self._message.protection.field).to_bytes(64, "little"), "<u8")
            else:  # the checksum over a wrong counter is right: its sender made both
                self._good = self._message.sent_before(words) if self._good is None else self._good
                self._wrong += 1
                sent = self._good + round(self.fault.size or 0.0) * self._wrong
                self._message.renew(words, int(frames[k]["length"]), sent)
            frames[k]["data"] = words.view(np.uint8)
        self.note(frames["t_ns"][mine[hit]])
        return frames


class _OfFrames(_Fault):
    def __init__(
        self, fault: MessageFault, condition: Condition | None, sender: Sender, rng: np.random.Generator
    ) -> None:
        super().__init__(fault, condition)
        self._message, self._rng = sender.message(str(fault.target)), rng

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        hit = self._message.among(frames)
        hit &= self.active(frames["t_ns"])
        hit &= self._rng.random(len(frames)) < self.fault.probability
        self.note(frames["t_ns"][hit])
        return disturbed(_WIRE[self.fault.kind], frames, hit, self.fault.delay_ms, self._rng)


class _Babbling(_Fault):
    """The ECU sends one message again and again, counted and protected as ever, as fast as the bus takes it."""

    def __init__(self, fault: MessageFault, condition: Condition | None, sender: Sender) -> None:
        super().__init__(fault, condition)
        self._message = sender.message(str(fault.target))
        self._priority = _priority(np.array([self._message.can_id], np.uint32))[0]
        self._period_ns = round(fault.period_ms * 1e6)
        self._last = empty(0)
        self._extra = 0  # frames more than there should be so far: the counter goes on with them
        self._next_ns = round((fault.from_s or 0.0) * 1e9)

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        mine = self._message.among(frames)
        end_ns = min(end_ns, end_ns if self.fault.to_s is None else round(self.fault.to_s * 1e9))
        times = np.arange(self._next_ns, max(end_ns, self._next_ns), self._period_ns, dtype=np.int64)
        if len(times):
            self._next_ns = int(times[-1]) + self._period_ns
        own = np.concatenate([self._last, frames[mine]])
        times = times[self.active(times)]
        place = np.searchsorted(own["t_ns"], times, side="right") - 1
        times, place = times[place >= 0], place[place >= 0]  # before its first frame it has nothing to send
        self.note(times)
        again = own[place]
        again["t_ns"] = times
        every = np.concatenate([frames[mine], again])
        order = np.argsort(every["t_ns"], kind="stable")
        self._last = own[-1:].copy()
        every = every[order]
        for frame, more in zip(every, order >= int(mine.sum()), strict=True):
            self._extra += int(more)
            words = words_of(frame)
            sent = self._message.sent_before(words) + self._extra
            self._message.renew(words, int(frame["length"]), sent if self._message.counts else None)
            frame["data"] = words.view(np.uint8)
        frames = np.concatenate([frames[~mine], every])
        return frames[np.argsort(frames["t_ns"], kind="stable")]

    def starves(self, frames: Frames) -> Mask:
        """Return which frames of other messages lose the arbitration again and again."""
        hit = (frames["bus"] == self._message.bus) & (frames["can_id"] & ERROR == 0)
        hit &= _priority(frames["can_id"]) > self._priority
        return np.asarray(hit & self.active(frames["t_ns"]), np.bool_)


def _priority(can_id: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return what arbitration goes by, lower wins: of one base identifier the standard frame before the extended."""
    long = can_id & EXTENDED != 0
    number = (can_id & ID_MASK).astype(np.int64)
    extended = (number >> 18 << 19) | 1 << 18 | (number & 0x3FFFF)
    return np.where(long, extended, number << 19)


class _BusOff(_Fault):
    """The ECU's controller is bus off: it sends nothing, and counts nothing; after that its counters go on."""

    def __init__(self, fault: MessageFault, condition: Condition | None, sender: Sender) -> None:
        super().__init__(fault, condition)
        counted = [message.name for message in sender.database if sender.has(message.name)]
        self._messages = [one for one in map(sender.message, counted) if one.counts]
        self._unsent = [0] * len(self._messages)

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        hit = self.active(frames["t_ns"])
        self.note(frames["t_ns"][hit])
        frames = frames.copy()
        for place, message in enumerate(self._messages):
            for k in np.flatnonzero(message.among(frames)):
                self._unsent[place] += int(hit[k])
                if self._unsent[place]:
                    words = words_of(frames[k])
                    sent = message.sent_before(words) - self._unsent[place]
                    message.renew(words, int(frames[k]["length"]), sent)
                    frames[k]["data"] = words.view(np.uint8)
        return frames[~hit]


class Harness:
    """Puts the faults of one ECU into its frames: those of signals first, of frames and of the ECU last.

    Args:
        faults: place in the scenario, fault.
        sender: messages that the ECU sends.
        rng: source of all randomness.

    Raises:
        InputError: a fault of what is not sent, or cannot have it.
    """

    def __init__(self, faults: Sequence[tuple[int, MessageFault]], sender: Sender, rng: np.random.Generator) -> None:
        self._faults: list[_Fault] = []
        self._sender, self._rng = sender, rng
        for place, fault in faults:
            self.add(fault, f"fault[{place}]")

    def add(self, fault: MessageFault, place: str = "fault") -> None:
        """Put in one more fault, from the next chunk on.

        Raises:
            InputError: a fault of what is not sent, or cannot have it.
        """
        sender, key = self._sender, "when"
        try:
            condition = None if fault.when is None else Condition(fault.when, sender.bus, sender.database)
            key = "signal" if fault.of_signal else "message"
            self._faults.append(_made(fault, condition, sender, self._rng))
        except InputError:
            with under(f"{place}.{key}", getattr(fault, key)):
                raise
        self._faults.sort(key=_stage)

    def end(self, now_ns: int) -> None:
        """End all faults at a time [ns]; injected ones stay known."""
        for fault in self._faults:
            fault.end(now_ns)

    @property
    def conditions(self) -> list[Condition]:
        """Conditions, which take the frames of all buses before faults are put into a chunk."""
        return [fault.condition for fault in self._faults if fault.condition is not None]

    @property
    def truth(self) -> list[Truth]:
        """Faults injected so far, in order of time."""
        return sorted((fact for fault in self._faults for fact in fault.truth), key=lambda fact: fact.t_ns)

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        """Return the ECU's frames of a chunk as they go to the bus; late ones may lie after its end [ns]."""
        for fault in self._faults:
            frames = fault.apply(frames, end_ns)
        return frames

    def starved(self, frames: Frames) -> Mask:
        """Return which frames on its bus get no turn, since a babbling ECU has the higher priority."""
        hit = np.zeros(len(frames), np.bool_)
        for fault in self._faults:
            if isinstance(fault, _Babbling) and len(frames):
                hit |= fault.starves(frames)
        return hit


def _made(fault: MessageFault, condition: Condition | None, sender: Sender, rng: np.random.Generator) -> _Fault:
    if fault.kind in get_args(SignalKind):
        return _OfSignal(fault, condition, sender, rng)
    if fault.kind in ("counter", "checksum"):
        return _OfProtection(fault, condition, sender)
    if fault.kind == "babbling":
        return _Babbling(fault, condition, sender)
    if fault.kind in get_args(EcuKind):
        return _BusOff(fault, condition, sender)
    return _OfFrames(fault, condition, sender, rng)


def _stage(fault: _Fault) -> int:
    return [_OfSignal, _OfProtection, _Babbling, _OfFrames, _BusOff].index(type(fault))
