"""Databases as layouts: a message a request (DBC, KCD, SYM, ARXML), or the identifiers of a CDD."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gateway.config.ecu import TWO_BYTES
from gateway.signals.database import load_database
from gateway_ask.answers.model import LONGEST_SIGNAL, AnswerLayout, Layouts, LeftOut, message_of, signal_of
from gateway_fdi.errors import InputError

#: Encoding of data in a CDD -> why it has no layout.
_WHY = {"?": "the name has several encodings in the file", "asc": "a text", "utf": "a text", "bcd": "digits (BCD)"}


def read(path: Path, _year: int | None) -> Layouts:
    """Read a database whose identifiers are ``service << 16 | identifier``, extended.

    Raises:
        InputError: it cannot be read, or no message has such an identifier.
    """
    found, left = [], []
    for message in load_database([path]):
        service, identifier = message.frame_id >> 16, message.frame_id & 0xFFFF
        if not message.is_extended_frame or not 0 < service < 0x40:
            left.append(LeftOut(message.name, f"0x{message.frame_id:X} is no extended service << 16 | identifier"))
        elif service not in TWO_BYTES and identifier > 0xFF:
            left.append(LeftOut(message.name, f"service 0x{service:02X} has identifiers up to 0xFF"))
        else:
            found.append(AnswerLayout(service, identifier, message))
    if not found:
        raise InputError("no message has an extended identifier service << 16 | identifier, as 0x22F190", file=path)
    return Layouts(tuple(found), tuple(left))


def read_cdd(path: Path, _year: int | None) -> Layouts:
    """Read a CDD: its data identifiers (0x22).

    Raises:
        InputError: it cannot be read, or has none.
    """
    import cantools  # noqa: PLC0415 - its parsers take a while to load

    try:
        with warnings.catch_warnings():  # it calls its reader of CDDs deprecated, and has no other
            warnings.simplefilter("ignore")
            loaded: Any = cantools.database.load_file(path, database_format="cdd", strict=False)
        signs = _signs(path)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except Exception as error:  # the parser lets any exception of its own through
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"not a good .cdd file: {text}", file=path) from error
    layouts, left = [], []
    for did in loaded.dids:
        where = f"22{did.identifier:04X} {did.name}"
        signals = []
        for data in did.datas:
            why = _WHY.get(signs.get(data.name, ""))
            if data.length > LONGEST_SIGNAL:
                why = f"{data.length} bits: at most {LONGEST_SIGNAL} are decoded"
            if why:
                left.append(LeftOut(f"{where}.{data.name}", why))
            else:
                signals.append(_signal(data, signs))
        if signals:
            message = message_of(0x22, did.identifier, signals, name=did.name)
            layouts.append(AnswerLayout(0x22, did.identifier, message))
        elif not did.datas:
            left.append(LeftOut(where, "no data"))
    if not layouts:
        raise InputError("the file has no data identifiers with data", file=path)
    return Layouts(tuple(layouts), tuple(left))


def _signs(path: Path) -> dict[str, str]:
    """Return the encodings of data by their names, which cantools leaves out; "?" where one name has several."""
    from xml.etree import ElementTree  # noqa: PLC0415 - beside its parser

    document = ElementTree.parse(path).getroot()  # noqa: S314 - cantools has read it in the same way
    kinds = {each.get("id"): each.find("CVALUETYPE") for each in document.iterfind(".//DATATYPES/*")}
    found: dict[str, str] = {}
    for each in document.iter("DATAOBJ"):
        kind, name = kinds.get(each.get("dtref")), each.findtext("QUAL")
        encoding = "" if kind is None else kind.get("enc", "")
        if name and found.setdefault(name, encoding) != encoding:
            found[name] = "?"
    return found


def _signal(data: Any, signs: Mapping[str, str]) -> Any:
    conversion = data.conversion
    return signal_of(
        data.name,
        data.start,
        data.length,
        big=data.byte_order == "big_endian",
        signed=signs.get(data.name) == "sgn",
        real=signs.get(data.name) in ("flt", "dbl"),
        scale=conversion.scale,
        offset=conversion.offset,
        texts={number: str(text) for number, text in (conversion.choices or {}).items()},
        unit=data.unit,
    )
