"""What readers of the status socket may ask: a line of JSON each, ``{"id": ..., "do": ..., ...}``.

| ``do`` | more keys | what it does |
|---|---|---|
| ``clear`` | ``dtc``: "P0336-39", or none for all | clears, durable when it is answered |
| ``cycle`` | | ends the operation cycle and begins the next one |
| ``settings`` | ``dtcs``, ``receive``, ``send``: true or false | as services 0x85 and 0x28, until it is set back or the reader leaves |
| ``values`` | ``signals``: full names | latest values |

Each is answered by ``{"kind": "answer", "id": ..., "ok": true, ...}``, or ``"ok": false`` with ``error``. What changes
something is noted as an intervention of the protocol ``local``.
"""  # noqa: E501 - a row of a table is a line

from __future__ import annotations

import json
from typing import Any

from gateway.errors import GatewayError, InputError, nearest
from gateway.faults.dtc import ALL_DTCS, Dtc
from gateway.faults.interventions import Intervention
from gateway.runtime.app import Gateway

_KEYS = {
    "clear": {"dtc"},
    "cycle": set(),
    "settings": {"dtcs", "receive", "send"},
    "values": {"signals"},
}
#: Signals that one command may ask for.
MOST_SIGNALS = 256


class Commands:
    """Does what readers ask.

    Args:
        gateway: of whom.
    """

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._off: set[int] = set()  # readers that have switched something off

    def answer(self, text: bytes, reader: int) -> dict[str, Any]:
        """Do one command; returns what is answered.

        Args:
            text: the line.
            reader: a number for who asks.
        """
        ticket: Any = None
        try:
            asked = _parsed(text)
            ticket = asked.get("id")
            result = getattr(self, f"_{asked['do']}")(asked, reader)
        except GatewayError as error:
            return {"id": ticket, "ok": False, "error": str(error)}
        return {"id": ticket, "ok": True, **result}

    def leave(self, reader: int) -> None:
        """Switch on again what a reader has switched off."""
        if reader in self._off:
            self._off.discard(reader)
            controls = self._gateway.controls
            controls.set_dtcs(True, _name(reader))
            controls.set_communication(receive=True, send=True, by=_name(reader))

    def _note(self, action: str, request: bytes = b"") -> None:
        self._gateway.controls.note(Intervention(0, "local", "", 0, action, request))

    def _clear(self, asked: dict[str, Any], _reader: int) -> dict[str, Any]:
        dtc = asked.get("dtc")
        group = ALL_DTCS if dtc is None else Dtc.parse(str(dtc)).value
        if dtc is not None and group == ALL_DTCS:
            raise InputError("this is the group of all DTCs; name none to clear all", value=dtc)
        entries = self._gateway.memory.entries()
        count = sum(group in (ALL_DTCS, entry.dtc.value) for entry in entries)
        if not self._gateway.controls.clear(group):
            raise InputError("there is no such DTC here", value=dtc)
        self._note("clear", group.to_bytes(3, "big"))
        return {"cleared": count}

    def _cycle(self, _asked: dict[str, Any], _reader: int) -> dict[str, Any]:
        self._gateway.controls.restart_cycle()
        self._note("cycle")
        return {"number": self._gateway.memory.cycle_number()}

    def _settings(self, asked: dict[str, Any], reader: int) -> dict[str, Any]:
        told = {name: asked[name] for name in ("dtcs", "receive", "send") if name in asked}
        for name, value in told.items():
            if not isinstance(value, bool):
                raise InputError("true or false", key=name, value=value)
        controls = self._gateway.controls
        if "dtcs" in told:
            controls.set_dtcs(told["dtcs"], _name(reader))
        if "receive" in told or "send" in told:
            controls.set_communication(
                receive=told.get("receive", controls.receive), send=told.get("send", controls.send), by=_name(reader)
            )
        self._off.add(reader)
        self._note("settings", json.dumps(told, sort_keys=True).encode())
        return {"receive": controls.receive, "send": controls.send}

    def _values(self, asked: dict[str, Any], _reader: int) -> dict[str, Any]:
        names = asked.get("signals")
        if not isinstance(names, list) or len(names) > MOST_SIGNALS or not all(isinstance(n, str) for n in names):
            raise InputError(f"a list of at most {MOST_SIGNALS} names", key="signals")
        known = self._gateway.signal_slots
        for name in names:
            if name not in known:
                raise InputError(f"no such signal is decoded{nearest(name, known)}", key="signals", value=name)
        return {"values": {name: self._gateway.engine.value(known[name]) for name in names}}


def _name(reader: int) -> str:
    return f"status-{reader}"


def _parsed(text: bytes) -> dict[str, Any]:
    try:
        asked = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError("a command is one line of JSON") from error
    if not isinstance(asked, dict) or asked.get("do") not in _KEYS:
        raise InputError(f'a command is {{"do": ...}}, one of {", ".join(_KEYS)}')
    unknown = set(asked) - _KEYS[asked["do"]] - {"id", "do"}
    if unknown:
        raise InputError(f"{asked['do']} has no such key", key=sorted(unknown)[0])
    return asked
