"""An ECU that answers what it hears."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gateway.bus.frames import EXTENDED, FD, Frames, empty, put
from gateway.signals.bits import mask_of
from gateway.signals.columns import limits
from gateway.signals.database import Database
from gateway.signals.decode import SIGNED, UNSIGNED
from gateway.signals.protection.auto import automatic
from gateway.signals.protection.params import KEYS, ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection
from gateway.signals.signal_access import ChangedMessage, ChangedSignal, words_of
from gateway_bench.vecu.conditions import Condition
from gateway_bench.vecu.contract import Run, Running, VirtualEcu
from gateway_bench.vecu.databases import database_of
from gateway_bench.vecu.responder.faults import Drawn, ResponderFault
from gateway_bench.vecu.responder.params import Reply, ResponderParams
from gateway_bench.vecu.responder.uds import UdsResponder
from gateway_bench.vecu.restbus.selection import usual
from gateway_bench.vecu.restbus.signals import start_value
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import InputError, under

if TYPE_CHECKING:
    from cantools.database.can import Message

T = TypeVar("T")
#: Where nothing asks for another: how often it hears [ns].
STEP_NS = 1_000_000


def _protection(
    reply: Reply, message: Message, database: Database, checked: Mapping[str, ProtectionParams]
) -> Protection:
    given = any(getattr(reply, name) is not None for name in KEYS)
    if given and reply.protection == "auto":
        return protection_for(message, automatic(message, database.file_of(message.name))[0])
    return protection_for(message, reply if given else usual(checked, message, database))


def _named(key: str, make: Callable[[], T]) -> T:
    """Return what is made; a mistake in it is one of a key."""
    with under(key):
        return make()


def _raw(value: float, signal: ChangedSignal, size: int) -> bytes:
    """Return what a frame has of a signal, big-endian."""
    raw = (value - float(signal.row.offset)) / float(signal.row.scale)
    if int(signal.row.kind) not in (SIGNED, UNSIGNED):  # floating-point, as IEEE 754 has it
        return np.array(raw, f">f{size}").tobytes()
    return (round(raw) & ((1 << 8 * size) - 1)).to_bytes(size, "big")


class _Replier:
    """One message that answers another."""

    def __init__(self, reply: Reply, bus: int, database: Database, checked: Mapping[str, ProtectionParams]) -> None:
        self._delay_ns, self._bus = round(reply.delay_ms * 1e6), bus
        self._asked = _named("on", partial(ChangedMessage, bus, database, reply.on, Protection()))
        message = _named("send", partial(database.message, reply.send))
        self._condition = None
        if reply.when is not None:
            self._condition = _named("when", partial(Condition, reply.when, bus, database))
        self.message = ChangedMessage(bus, database, reply.send, _protection(reply, message, database, checked))
        self._words = np.zeros(8, np.uint64)
        rows = {s.name: ChangedSignal(bus, database, reply.send, s.name) for s in message.signals if s.length <= 64}
        starts = {s.name: start_value(s) for s in message.signals if s.length <= 64}
        self._check(reply, rows, database)
        # Multiplexers and given values last: where signals share bits, these are sent.
        for signal in sorted(message.signals, key=lambda s: (s.name in reply.signals, s.is_multiplexer)):
            if signal.name in rows:
                rows[signal.name].put(self._words, reply.signals.get(signal.name, starts[signal.name]))
        self._echo = []
        for name, source in reply.echo.items():
            heard, _, own = source.rpartition(".")
            found = _named(key_path(("echo", name)), partial(ChangedSignal, bus, database, heard, own))
            self._echo.append((rows[name], heard, found))
        self._heard_of = {heard: ChangedMessage(bus, database, heard, Protection()) for _, heard, _ in self._echo}
        self._last: dict[str, Frames] = {}
        self._length = message.length
        self._can_id = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        self._flags = FD if message.is_fd else 0

    def _check(self, reply: Reply, rows: Mapping[str, ChangedSignal], database: Database) -> None:
        owned = int.from_bytes(self.message.protection.owned.tobytes(), "little")
        for table in ("signals", "echo"):
            for name, value in getattr(reply, table).items():
                key = key_path((table, name))
                _named(key, partial(database.signal, reply.send, name))
                if mask_of(rows[name].row) & owned:
                    raise InputError("the message's protection makes this signal", key=key, value=name)
                low, high = limits(rows[name].row)
                if table == "signals" and not low <= value <= high:
                    raise InputError(f"it can carry {low:g} to {high:g}", key=key, value=value)

    def step(self, heard: Frames) -> list[Frames]:
        """Return the answers to what was heard, stamped when they are due, without a protection."""
        if self._condition is not None:
            self._condition.take(heard)
        among = {name: message.among(heard) for name, message in self._heard_of.items()}
        asked, made = self._asked.among(heard), []
        for k, frame in enumerate(heard):
            for name, mine in among.items():
                if mine[k]:
                    self._last[name] = heard[k : k + 1].copy()
            if asked[k] and (self._condition is None or self._condition.holds(heard["t_ns"][k : k + 1])[0]):
                made.append(self._answer(int(frame["t_ns"]) + self._delay_ns))
        return made

    def _answer(self, stamp_ns: int) -> Frames:
        words = self._words.copy()
        for row, name, source in self._echo:
            if name in self._last:
                frame = self._last[name][0]
                value = source.value(words_of(frame), int(frame["length"]))
                if not np.isnan(value):
                    row.put(words, value)
        made = empty(1)
        put(made, 0, stamp_ns, self._can_id, words.tobytes()[: self._length], bus=self._bus, flags=self._flags)
        return made


class _Responder:
    """The running ECU."""

    step_ns = STEP_NS

    def __init__(self, params: ResponderParams, faults: Sequence[ResponderFault], run: Run) -> None:
        database = database_of(run.databases)
        self._repliers = []
        for k, reply in enumerate(params.reply):
            with under(f"reply[{k}]"):
                self._repliers.append(_Replier(reply, run.bus, database, params.checked))
        self._messages = {replier.message.can_id: replier.message for replier in self._repliers}
        self._sent: Counter[int] = Counter()
        self._uds, self._values = None, dict[str, tuple[ChangedMessage, ChangedSignal]]()
        self._bytes: dict[str, bytes] = {}
        self._due: list[Frames] = []
        if params.uds is not None:
            for name, text in params.uds.identifiers.items():
                self._identify(name, text, run.bus, database)
            self._uds = UdsResponder(params.uds, run, self._read, Drawn(faults, run.rng))

    def _identify(self, name: str, text: str, bus: int, database: Database) -> None:
        """Note what an identifier has: bytes, a signal that is on the bus, or a text.

        Raises:
            InputError: bytes that are none.
        """
        message, _, signal = text.rpartition(".")
        if text.startswith("0x"):
            try:
                self._bytes[name] = bytes.fromhex(text[2:])
            except ValueError as error:
                raise InputError("bytes in hex", key=f"uds.identifiers.{name}", value=text) from error
        elif message and any(one.name == message for one in database):
            with under(f"uds.identifiers.{name}", text):
                found = ChangedSignal(bus, database, message, signal)
            self._values[name] = ChangedMessage(bus, database, message, Protection()), found
            self._bytes[name] = bytes((int(found.row.length) + 7) // 8)
        else:
            self._bytes[name] = text.encode()

    def _read(self, name: str) -> bytes:
        return self._bytes[name]

    def _note(self, heard: Frames) -> None:
        """Keep the newest raw values of signals that identifiers have, big-endian as UDS has numbers."""
        for name, (message, signal) in self._values.items():
            for k in np.flatnonzero(message.among(heard))[::-1][:1]:
                value = signal.value(words_of(heard[k]), int(heard[k]["length"]))
                if not np.isnan(value):
                    self._bytes[name] = _raw(value, signal, len(self._bytes[name]))

    def step(self, end_ns: int, heard: Frames) -> Frames:
        """Answer what was heard, and send what is due until a time [ns]."""
        if len(heard):
            self._note(heard)
        for replier in self._repliers if len(heard) else ():
            self._due += replier.step(heard)
        if self._uds is not None:
            self._due += self._uds.step(end_ns, heard)
        if not self._due:
            return empty(0)
        frames = np.concatenate(self._due)
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        ready = frames["t_ns"] < end_ns
        self._due = [frames[~ready]] if not ready.all() else []
        return self._protected(frames[ready])

    def _protected(self, frames: Frames) -> Frames:
        """Count and protect answers as they are sent: one counter a message, for all answers."""
        for frame in frames:
            can_id = int(frame["can_id"])
            message = self._messages.get(can_id)
            if message is not None:
                words = words_of(frame)
                message.renew(words, int(frame["length"]), self._sent[can_id])
                frame["data"] = words.view(np.uint8)
                self._sent[can_id] += 1
        return frames

    def close(self) -> None:
        """Nothing is open."""


def _begin(params: ResponderParams, faults: Sequence[ResponderFault], run: Run) -> Running:
    return _Responder(params, faults, run)


def _fits(params: ResponderParams, fault: ResponderFault) -> None:
    """Refuse a fault of answers of an ECU that knows no requests."""
    if params.uds is None:
        raise ValueError(f"ECU {params.name!r} has no [ecu.uds], so it has no {fault.kind}")
    if fault.request is not None and fault.request not in params.uds.values:
        raise ValueError(f"ECU {params.name!r} has no value {fault.request!r}; it has {', '.join(params.uds.values)}")


def _sends(params: ResponderParams, databases: Sequence[Path]) -> dict[str, Protection]:
    database = database_of(databases)
    return {
        reply.send: _protection(reply, database.message(reply.send), database, params.checked) for reply in params.reply
    }


ECU = VirtualEcu(
    type="responder",
    api=2,
    params=ResponderParams,
    fault=ResponderFault,
    begin=_begin,
    fits=_fits,
    sends=_sends,
    step_ns=STEP_NS,
)
