"""Requests by the names of people: what to ask for "coolant" or "VIN", by UDS and classic OBD, and answers in words."""

from __future__ import annotations

import re

from gateway.answers.decode import AnswerDecoder
from gateway.answers.j1979 import j1979
from gateway.answers.model import AnswerLayout
from gateway.answers.obd_on_uds import as_classic, classic, on_uds

#: Words -> signal of SAE J1979, or infotype; signals go by their own names, too.
_SIGNALS = {
    "coolant": "ECT", "engine speed": "RPM", "speed": "VSS", "load": "LOAD_PCT", "intake air": "IAT", "air flow": "MAF",
    "throttle": "TP", "fuel level": "FLI", "ambient air": "AAT", "oil": "EOT", "voltage": "VPWR", "odometer": "ODO",
}  # fmt: skip
_TEXTS = {"vin": 0x02, "calibration": 0x04, "verification number": 0x06, "ecu name": 0x0A}
_HEX = re.compile(r"([0-9A-Fa-f]{2}\s*)+")


def forms_of(asked: str) -> list[bytes]:
    """Return the requests for what is asked, the next one where one is refused; none: it is no name.

    Args:
        asked: a name; hexadecimal digits are the request itself.
    """
    if _HEX.fullmatch(asked.strip()):
        return [bytes.fromhex(asked)]
    key = _key(asked)
    if key is None:
        return []
    service, identifier = on_uds(*key)
    return [bytes([service]) + identifier.to_bytes(2, "big"), bytes(key)]


def known() -> str:
    """Return the names that there are, for people."""
    return ", ".join([*_TEXTS, *_SIGNALS])


def _key(asked: str) -> tuple[int, int] | None:
    name = " ".join(asked.lower().split())
    if name in _TEXTS:
        return 0x09, _TEXTS[name]
    layout = _layout(_SIGNALS.get(name, asked).upper())
    return None if layout is None else (layout.service, layout.identifier)


def _layout(signal: str) -> AnswerLayout | None:
    return next((each for each in j1979() if any(one.name == signal for one in each.message.signals)), None)


def words_of(asked: str, answer: bytes) -> str:
    """Return what a positive answer says of what was asked by name; "": nothing that is known."""
    key = _key(asked)
    if key is None:
        return ""
    if answer[:1] == b"\x62" and classic(0x22, int.from_bytes(answer[1:3], "big")) == key:
        data = as_classic(*key, answer[3:])
    elif answer[:2] == bytes([key[0] + 0x40, key[1]]):
        data = answer[2:]
    else:
        return ""
    if key[0] == 0x09:
        text = data[1:].strip(b"\0 ")
        return text.decode() if text.isascii() and text.decode().isprintable() else text.hex().upper()
    layout = next(each for each in j1979() if (each.service, each.identifier) == key)
    found = AnswerDecoder(layout).decode([data])
    units = {signal.name: f" {signal.unit}" if signal.unit else "" for signal in layout.message.signals}
    rows = zip(found.names, found.values[:, 0], found.there[:, 0], strict=True)
    return ", ".join(f"{name} {value:g}{units[name]}" for name, value, there in rows if there)
