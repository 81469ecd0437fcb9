"""Requests of readers of the status socket: a line of JSON each, ``{"id": ..., "do": ..., ...}``.

| ``do`` | more keys | what it does |
|---|---|---|
| ``clear`` | ``dtc``: "P0336-39", or none for all | clears, durable when it is answered |
| ``cycle`` | | ends the operation cycle and begins the next one |
| ``settings`` | ``dtcs``, ``receive``, ``send``: true or false | as services 0x85 and 0x28 |
| ``present`` | | keeps what this reader has switched off, as tester present (0x3E) |
| ``values`` | ``signals``: full names | latest values |
| ``post`` | ``events``: of the kinds :data:`POSTED` | keeps events for the fleet |
| ``arrived`` | ``numbers``: of rows of the fleet's queue | takes events away that have arrived at the fleet |
| ``request`` | ``tester``: a name, ``ecu``: "self" or that of an ``[[ecu]]``, ``uds``: hex digits | asks by UDS |

``request`` is answered with ``uds``: the answers as a list of hex digits, when they are there; 0x78 is not among them.
Each name is a tester of this reader's own, with a session, key and role as on a bus; routes let pass what those of
testers by DoIP do. An answer that comes by itself is a message of the kind ``response``.

Each is answered by ``{"kind": "answer", "id": ..., "ok": true, "monitoring": {...}, ...}``, or ``"ok": false`` with
``error``. A request that changes something goes by the rules of access for testers (:mod:`gateway.servers.authority`)
and is noted as an intervention of the protocol ``local``. It takes three more keys: ``by`` (who, for people), ``force``
(true: override the rules; of the socket's owner and root) and ``why`` (the reason).

A reader's switching off ends when it leaves, when it says nothing for as long as a tester's session lasts (S3), when a
condition is met no longer (unless it was forced), and when a tester or another reader switches on.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from gateway.common.fence import Wall
from gateway.faults.dtc import ALL_DTCS, Dtc
from gateway.faults.interventions import Intervention
from gateway.host.process import NOBODY, user
from gateway.runtime.app import Gateway
from gateway.runtime.contract import DETAIL, reported_to_fleet, wrong
from gateway.servers.authority import WATCH_NS, Holder, Refusal, local_intervention
from gateway.servers.local import SELF
from gateway.servers.uds.params import S3_MS
from gateway_fdi.errors import GatewayError, InputError, nearest

_FORCE = {"by", "force", "why"}
_KEYS = {
    "clear": {"dtc", *_FORCE},
    "cycle": _FORCE,
    "settings": {"dtcs", "receive", "send", *_FORCE},
    "present": set(),
    "values": {"signals"},
    "post": {"events"},
    "arrived": {"numbers"},
    "request": {"tester", "ecu", "uds"},
}
#: Commands of a reader that only looks, or that keeps what others do.
_LOOKS = ("values", "post", "arrived")
_WANTED = f'a command is {{"do": ...}}, one of {", ".join(_KEYS)}'
#: Signals that one command may ask for.
MOST_SIGNALS = 256
#: Kinds of events that another process may have kept for the fleet; numbers in one command at most.
POSTED, MOST_NUMBERS = ("statistics", "recording", "campaign"), 4096
#: Longest ``by`` and ``why`` [characters].
MOST_LETTERS = 80
#: Name of a tester.
_TESTER = re.compile(r"[A-Za-z0-9_.:@-]{1,40}")

#: Takes what is told to a reader later: its number, the kind of message, its fields.
Say = Callable[[int, str, dict[str, Any]], None]


@dataclass
class _Session:
    """One reader: its user, the monitoring it has switched off, and until when."""

    uid: int
    by: str
    holder: Holder
    until_s: float = 0.0


@dataclass(frozen=True)
class _Asked:
    """An intervention that is asked for, and its verdict."""

    session: _Session
    action: str
    request: bytes
    refusal: Refusal
    force: bool
    why: str

    def record(self) -> Intervention:
        by = f"uid {self.session.uid}" if self.session.uid != NOBODY else "unknown"
        by += f", {self.session.by}" if self.session.by else ""
        return local_intervention(self.action, self.request, by, self.refusal, force=self.force, why=self.why)


def monitoring_of(gateway: Gateway) -> dict[str, Any]:
    """Return what is on, and ``by`` whom the rest was switched off; ``on``: whether test results count."""
    controls = gateway.controls
    return {
        "on": controls.monitoring,
        "dtcs": controls.results,
        "receive": controls.receive,
        "send": controls.send,
        "by": controls.off_by,
    }


class Commands:
    """Does what readers ask.

    Args:
        gateway: of whom.
        say: tells a reader what comes later.
        wall: around each command.
    """

    def __init__(self, gateway: Gateway, say: Say, wall: Wall) -> None:
        self._gateway, self._say, self._wall = gateway, say, wall
        self._gateway.local.push = lambda reader, tester, answer: say(
            reader, "response", {"tester": tester, "uds": answer.hex()}
        )
        uds = gateway.config.output.uds
        self._s3_s = (S3_MS if uds is None else uds.s3_ms) / 1e3
        self._sessions: dict[int, _Session] = {}
        self._now_s = self._watched_s = 0.0

    def enter(self, reader: int, uid: int = NOBODY) -> None:
        """Take a reader.

        Args:
            reader: its number.
            uid: as which user it runs.
        """
        session: _Session

        def ended(action: str) -> None:
            self._gateway.controls.note(Intervention(0, "gateway", "", 0, action, role=session.holder.name))

        name = f"reader {reader}" + (f", uid {uid}" if uid != NOBODY else "")
        session = _Session(uid, "", self._gateway.authority.holder(name, ended, yields=True))
        self._sessions[reader] = session

    def answer(self, text: bytes, reader: int) -> dict[str, Any] | None:
        """Do one command; returns what is answered; None: it is told later."""
        told: dict[str, Any] = {"id": None}
        session = self._sessions[reader]
        failed = {"ok": False, "error": "an internal error of the gateway; its log has more"}
        done = self._wall.keep(self._answer, text, session, reader, told, of=session.holder.name, instead=failed)
        return None if done is None else {**told, **done, "monitoring": monitoring_of(self._gateway)}

    def _answer(self, text: bytes, session: _Session, reader: int, told: dict[str, Any]) -> dict[str, Any] | None:
        """Do one command; ``told`` gets its ``id``."""
        try:
            asked = _loaded(text)
            told["id"] = asked.get("id")
            _refuse_unless_command(asked)
            if asked["do"] == "request":
                self._request(asked, session, reader)
                return None
            if asked["do"] not in _LOOKS:  # a reader that only looks keeps nothing
                session.until_s = self._now_s + self._s3_s
            return {"ok": True, **getattr(self, f"_{asked['do']}")(asked, session)}
        except GatewayError as error:
            refused = {"refused": int(error.refusal)} if isinstance(error, RefusedError) else {}
            return {"ok": False, "error": str(error), **refused}

    def pass_time(self, now_s: float) -> None:
        """End what readers have switched off, if their session or its conditions are over.

        Args:
            now_s: of a clock that is never set [s].
        """
        self._now_s = now_s
        watch = now_s >= self._watched_s + WATCH_NS / 1e9
        if watch:
            self._watched_s = now_s
        for session in self._sessions.values():
            if session.holder.actions and now_s >= session.until_s:
                self._wall.keep(session.holder.end, of=session.holder.name)
            elif watch:
                self._wall.keep(session.holder.end_unmet, of=session.holder.name)

    def leave(self, reader: int) -> None:
        """Switch on again what a reader switched off that is gone, and end its testers."""
        self._gateway.local.leave(reader)
        self._gateway.authority.leave(self._sessions.pop(reader).holder)

    def _request(self, asked: dict[str, Any], session: _Session, reader: int) -> None:
        """Have a request answered.

        Raises:
            InputError: it is none.
        """
        tester, ecu = asked.get("tester"), asked.get("ecu", SELF)
        if not isinstance(tester, str) or not _TESTER.fullmatch(tester):
            raise InputError("1 to 40 letters, digits and _.:@-", key="tester", value=tester)
        if not isinstance(ecu, str):
            raise InputError("a name", key="ecu", value=ecu)
        try:
            request = bytes.fromhex(asked.get("uds", ""))
        except (TypeError, ValueError) as error:
            raise InputError("an even number of hex digits", key="uds", value=asked.get("uds")) from error

        def done(answers: Sequence[bytes]) -> None:
            told = {"id": asked.get("id"), "ok": True, "uds": [each.hex() for each in answers]}
            self._say(reader, "answer", {**told, "monitoring": monitoring_of(self._gateway)})

        gateway, who = self._gateway, session.holder.name
        gateway.local.ask(reader, who, tester, (ecu, request), done)
        gateway.servers.wake(gateway.local)

    def _judge(self, asked: dict[str, Any], session: _Session, action: str, request: bytes) -> _Asked:
        """Return an intervention that is allowed, or forced.

        Raises:
            RefusedError: it is not.
        """
        force, why = asked.get("force", False), asked.get("why", "")
        if not isinstance(force, bool):
            raise InputError("true or false", key="force", value=force)
        for key in ("why", "by"):
            text = asked.get(key, "")
            if not isinstance(text, str) or len(text) > MOST_LETTERS:
                raise InputError(f"at most {MOST_LETTERS} letters", key=key, value=text)
        if force and session.uid not in (0, user()):
            raise InputError("only the owner of the status socket may override the rules", key="force", value=force)
        session.by = asked.get("by", "")
        found = _Asked(session, action, request, self._gateway.authority.local_refusal(action), force, why)
        if found.refusal and not force:
            self._gateway.controls.note(found.record())
            raise RefusedError(action, found.refusal)
        return found

    def _note(self, done: _Asked) -> None:
        self._gateway.controls.note(done.record())

    def _clear(self, asked: dict[str, Any], session: _Session) -> dict[str, Any]:
        dtc = asked.get("dtc")
        group = ALL_DTCS if dtc is None else Dtc.parse(str(dtc)).value
        if dtc is not None and group == ALL_DTCS:
            raise InputError("this is the group of all DTCs; name none to clear all", value=dtc)
        if not self._gateway.controls.knows(group):
            raise InputError("there is no such DTC here", value=dtc)
        allowed = self._judge(asked, session, "clear", b"\x14" + group.to_bytes(3, "big"))
        entries = self._gateway.memory.entries()
        count = sum(group in (ALL_DTCS, entry.dtc.value) for entry in entries)
        self._gateway.controls.clear(group)
        self._note(allowed)
        return {"cleared": count}

    def _cycle(self, asked: dict[str, Any], session: _Session) -> dict[str, Any]:
        allowed = self._judge(asked, session, "reset", b"\x11\x01")
        self._gateway.controls.restart_cycle()
        self._note(allowed)
        return {"number": self._gateway.memory.cycle_number()}

    def _settings(self, asked: dict[str, Any], session: _Session) -> dict[str, Any]:
        told = {name: asked[name] for name in ("dtcs", "receive", "send") if name in asked}
        for name, value in told.items():
            if not isinstance(value, bool):
                raise InputError("true or false", key=name, value=value)
        controls, holder = self._gateway.controls, session.holder
        changes: list[tuple[str, bytes, bool]] = []
        if "dtcs" in told:
            changes.append(("dtc_setting", bytes([0x85, 0x01 if told["dtcs"] else 0x02]), told["dtcs"]))
        receive, send = told.get("receive", holder.receive), told.get("send", holder.send)
        if "receive" in told or "send" in told:
            number = (0x00 if send else 0x01) if receive else (0x02 if send else 0x03)
            changes.append(("communication", bytes([0x28, number, 0x01]), receive and send))
        allowed = [
            _Asked(session, action, request, Refusal.NONE, False, "")
            if undoes
            else self._judge(asked, session, action, request)
            for action, request, undoes in changes
        ]
        for each in allowed:
            if each.action == "dtc_setting":
                holder.set_dtcs(told["dtcs"], forced=each.force)
            else:
                holder.set_communication(receive=receive, send=send, forced=each.force)
            self._note(each)
        return {"receive": controls.receive, "send": controls.send}

    def _present(self, _asked: dict[str, Any], _session: _Session) -> dict[str, Any]:
        return {}

    def _values(self, asked: dict[str, Any], _session: _Session) -> dict[str, Any]:
        names = asked.get("signals")
        if not isinstance(names, list) or len(names) > MOST_SIGNALS or not all(isinstance(n, str) for n in names):
            raise InputError(f"a list of at most {MOST_SIGNALS} names", key="signals")
        known = self._gateway.signal_slots
        for name in names:
            if name not in known:
                raise InputError(f"no such signal is decoded{nearest(name, known)}", key="signals", value=name)
        return {"values": {name: self._gateway.engine.value(known[name]) for name in names}}

    def _post(self, asked: dict[str, Any], _session: _Session) -> dict[str, Any]:
        events = asked.get("events")
        if self._gateway.config.fleet is None:
            raise InputError("the gateway's configuration has no table [fleet]", key="events")
        if not isinstance(events, list):
            raise InputError("a list of events", key="events")
        for event in events:
            if reason := wrong(event) or ("" if event["event"] in POSTED else "the gateway tells these itself"):
                raise InputError(reason, key="events")
        for event in events:
            self._gateway.memory.fleet.post(event, detail=reported_to_fleet(event) == DETAIL)
        return {}

    def _arrived(self, asked: dict[str, Any], _session: _Session) -> dict[str, Any]:
        numbers = asked.get("numbers")
        if not isinstance(numbers, list) or len(numbers) > MOST_NUMBERS or not all(type(n) is int for n in numbers):
            raise InputError(f"a list of at most {MOST_NUMBERS} numbers", key="numbers")
        self._gateway.memory.fleet.arrived(numbers)
        return {}


class RefusedError(GatewayError):
    """The rules of access do not allow it, or not now."""

    def __init__(self, action: str, refusal: Refusal) -> None:
        self.refusal = refusal
        super().__init__(f"refused (0x{refusal:02X}), {action}: {refusal.words}; force overrides it, which is noted")


def _loaded(text: bytes) -> dict[str, Any]:
    try:
        asked = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("a command is one line of JSON") from error
    if not isinstance(asked, dict):
        raise InputError(_WANTED)
    return asked


def _refuse_unless_command(asked: dict[str, Any]) -> None:
    if not isinstance(asked.get("do"), str) or asked["do"] not in _KEYS:
        raise InputError(_WANTED)
    unknown: Sequence[str] = sorted(set(asked) - _KEYS[asked["do"]] - {"id", "do"})
    if unknown:
        raise InputError(f"{asked['do']} has no such key", key=unknown[0])
