"""Requests by the names of people: what to ask for "coolant" or "VIN", by UDS and classic OBD, and answers in words."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from gateway_ask.answers.decode import AnswerDecoder
from gateway_ask.answers.j1979 import j1979
from gateway_ask.answers.model import AnswerLayout
from gateway_ask.answers.monitor_tests import results
from gateway_ask.answers.obd_on_uds import as_classic, classic, on_uds

if TYPE_CHECKING:
    from cantools.database.can.signal import Signal

#: Words -> signal of SAE J1979, or infotype; signals go by their own names, too.
_SIGNALS = {
    "coolant": "ECT", "engine speed": "RPM", "speed": "VSS", "load": "LOAD_PCT", "intake air": "IAT", "air flow": "MAF",
    "throttle": "TP", "fuel level": "FLI", "ambient air": "AAT", "oil": "EOT", "voltage": "VPWR", "odometer": "ODO",
}  # fmt: skip
_TEXTS = {"vin": 0x02, "calibration": 0x04, "verification number": 0x06, "ecu name": 0x0A}
#: VIN of UDS (ISO 14229-1, C.1), where OBD has none.
_VIN = b"\x22\xf1\x90"
#: Clears the DTCs of the emission system (ISO 14229-1, D.1); mode 04 of classic OBD. A route has to allow it.
_CLEAR, _CLEARS = "clear dtcs", (b"\x14\xff\xff\x33", b"\x04")
_MONITOR = re.compile(r"monitor ([0-9a-f]{1,2})")
_HEX = re.compile(r"([0-9A-Fa-f]{2}\s*)+")


def forms_of(asked: str) -> list[bytes]:
    """Return the requests for what is asked, the next one where one is refused; none: it is no name.

    Args:
        asked: a name; hexadecimal digits are the request itself.
    """
    if _HEX.fullmatch(asked.strip()):
        return [bytes.fromhex(asked)]
    if _name(asked) == _CLEAR:
        return list(_CLEARS)
    key = _key(asked)
    if key is None:
        return []
    service, identifier = on_uds(*key)
    return [bytes([service]) + identifier.to_bytes(2, "big"), bytes(key), *([_VIN] if key == (0x09, 0x02) else [])]


def known() -> str:
    """Return the names that there are, for people."""
    return ", ".join([*_TEXTS, *_SIGNALS, "monitor 01 (its number)", _CLEAR])


def _name(asked: str) -> str:
    return " ".join(asked.lower().split())


def _key(asked: str) -> tuple[int, int] | None:
    name = _name(asked)
    if name in _TEXTS:
        return 0x09, _TEXTS[name]
    if monitor := _MONITOR.fullmatch(name):
        return 0x06, int(monitor[1], 16)
    layout = _layout(_SIGNALS.get(name, asked).upper())
    return None if layout is None else (layout.service, layout.identifier)


def _layout(signal: str) -> AnswerLayout | None:
    return next((each for each in j1979() if any(one.name == signal for one in each.message.signals)), None)


def words_of(asked: str, answer: bytes) -> str:
    """Return what a positive answer says of what was asked by name; "": nothing that is known."""
    if _name(asked) == _CLEAR:
        return "cleared" if answer in (b"\x54", b"\x44") else ""
    key = _key(asked)
    if key is None:
        return ""
    if answer[:1] == b"\x62" and classic(0x22, int.from_bytes(answer[1:3], "big")) == key:
        data = as_classic(*key, answer[3:])
    elif answer[:2] == bytes([key[0] + 0x40, key[1]]):
        data = answer[2:]
    elif key == (0x09, 0x02) and answer[:3] == b"\x62" + _VIN[1:]:
        data = b"\x01" + answer[3:]
    else:
        return ""
    if key[0] == 0x06:
        return "; ".join(map(str, results(data)))
    if key[0] == 0x09:
        text = data[1:].strip(b"\0 ")
        return text.decode() if text.isascii() and text.decode().isprintable() else text.hex().upper()
    return values_in_words(next(each for each in j1979() if (each.service, each.identifier) == key), data)


def values_in_words(layout: AnswerLayout, data: bytes) -> str:
    """Return the values of an answer, its data behind service and identifier, for people."""
    found = AnswerDecoder(layout).decode([data])
    signals = {signal.name: signal for signal in layout.message.signals}
    rows = zip(found.names, found.values[:, 0], found.there[:, 0], strict=True)
    return ", ".join(f"{name} {_said(signals[name], value)}" for name, value, there in rows if there)


def _said(signal: Signal, value: float) -> str:
    """Return a value for people: its text, or the number with its unit."""
    text = None if signal.choices is None else signal.choices.get(int(value))
    return str(text) if text is not None else f"{value:g} {signal.unit or ''}".rstrip()
