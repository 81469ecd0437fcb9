"""Databases as layouts: a message a request (DBC, KCD, SYM, ARXML), or the identifiers of a CDD."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gateway.answers.model import TWO_BYTES, AnswerLayout, Layouts, LeftOut, message_of, signal_of
from gateway.signals.database import load_database
from gateway_fdi.errors import InputError


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
        loaded: Any = cantools.database.load_file(path, database_format="cdd", strict=False)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except Exception as error:  # the parser lets any exception of its own through
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"not a good .cdd file: {text}", file=path) from error
    layouts, left = [], []
    for did in loaded.dids:
        where = f"{did.identifier:04X} {did.name}"
        left += [
            LeftOut(f"{where}.{data.name}", f"{data.length} bits: at most 64 are decoded")
            for data in did.datas
            if data.length > 64
        ]
        signals = [_signal(data) for data in did.datas if 0 < data.length <= 64]
        if signals:
            layouts.append(AnswerLayout(0x22, did.identifier, message_of(0x22, did.identifier, signals, name=did.name)))
        else:
            left.append(LeftOut(where, "no data of at most 64 bits"))
    if not layouts:
        raise InputError("the file has no data identifiers with data", file=path)
    return Layouts(tuple(layouts), tuple(left))


def _signal(data: Any) -> Any:
    conversion = data.conversion
    return signal_of(
        data.name,
        data.start,
        data.length,
        big=data.byte_order == "big_endian",
        real=conversion.is_float,
        scale=conversion.scale,
        offset=conversion.offset,
        texts={number: str(text) for number, text in (conversion.choices or {}).items()},
        unit=data.unit,
    )
