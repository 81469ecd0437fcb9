"""A message's protection in a database, by names and attributes: ``protection = "auto"``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from gateway.signals.protection.e2e import PROFILES
from gateway.signals.protection.params import ProtectionParams
from gateway_fdi.common.tomlfile import input_errors
from gateway_fdi.errors import InputErrors

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Begin of a database's file name -> the rule of its signals CHECKSUM, and COUNTER (opendbc's convention).
_BY_FILE = (
    (("honda_", "acura_"), "honda"),
    (("toyota_", "lexus_"), "toyota"),
    (("hyundai_canfd",), "hyundai_canfd"),
    (("vw_mqb", "vw_meb"), "volkswagen_mqb"),
    (("vw_mlb",), "volkswagen_mlb"),
    (("vw_pq",), "volkswagen_pq"),
    (("subaru_global",), "subaru"),
    (("chrysler_",), "chrysler"),
    (("fca_giorgio",), "fca_giorgio"),
    (("comma_body",), "body"),
    (("tesla_",), "tesla"),
    (("psa_",), "psa"),
)
_MODES = {"BOTH": "both", "ALT": "alternating", "LOW": "low", "NIBBLE": "nibble"}


def automatic(message: Message, file: Path) -> tuple[ProtectionParams, str]:
    """Return what is to be checked of a message, and why, in one line.

    Raises:
        InputErrors: attributes that make no profile.
    """
    if message.autosar is not None and message.autosar.secoc is not None:
        return ProtectionParams(), 'nothing: SecOC wants a key, secoc = { profile = "database", key = ... }'
    for found in (_of_arxml(message), _of_attributes(message)):
        if found is not None:
            keys, why = found
            try:
                return ProtectionParams(e2e=keys), f"e2e = {_toml(keys)}, {why}"
            except ValidationError as error:
                raise InputErrors(input_errors(error, file).errors) from error
    return _of_names(message, file)


def _toml(keys: Mapping[str, Any]) -> str:
    shown = (f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in keys.items())
    return f"{{ {', '.join(shown)} }}"


def _profile(text: object) -> str | None:
    """Return a profile by what databases call it: PROFILE_01, P01, 1, E2E_P01, 01A, ..."""
    number = re.search(r"(\d+)", re.sub(r"(?i)e2e", "", str(text)))
    name = f"P{int(number[1]):02d}" if number else ""
    return name if name in PROFILES else None


def _ids(ids: list[int]) -> dict[str, Any]:
    if len(ids) == 16:
        return {"data_ids": ids}
    return {"data_id": ids[0]} if ids else {}


def _of_arxml(message: Message) -> tuple[dict[str, Any], str] | None:
    e2e = message.autosar.e2e if message.autosar is not None else None
    profile = None if e2e is None else _profile(e2e.category)
    if e2e is None or profile is None:
        return None
    # cantools reads no more of it than category, data ids and length.
    lacking = (
        'data_id_mode and offset are not read of it: "both" and 0'
        if PROFILES[profile].modes
        else ("offset is not read of it: 0")
    )
    return {"profile": profile, **_ids(list(e2e.data_ids or []))}, f"as the ARXML file says: {e2e.category}; {lacking}"


def _of_attributes(message: Message) -> tuple[dict[str, Any], str] | None:
    """Read E2EProfile, E2EDataId, E2EDataIdList, E2EDataIdMode, E2EOffset of a DBC file, however they are spelt."""
    attributes = {} if message.dbc is None else message.dbc.attributes
    known = {re.sub(r"[^A-Z0-9]", "", name.upper()): attribute.value for name, attribute in attributes.items()}
    known = {name.removeprefix("GEN").removeprefix("MSG"): value for name, value in known.items()}
    profile = _profile(known.get("E2EPROFILE", ""))
    if profile is None:
        return None
    ids = [int(part, 0) for part in re.findall(r"0[xX][0-9A-Fa-f]+|\d+", str(known.get("E2EDATAIDLIST", "")))]
    keys: dict[str, Any] = {"profile": profile, **_ids(ids or [int(known.get("E2EDATAID", 0))])}
    mode = str(known.get("E2EDATAIDMODE", "")).upper()
    for text, name in _MODES.items():
        if text in mode:
            keys["data_id_mode"] = name
    if int(known.get("E2EOFFSET", 0)):
        keys["offset"] = int(known["E2EOFFSET"])
    return keys, "as attributes of the database say"


def _of_names(message: Message, file: Path) -> tuple[ProtectionParams, str]:
    names = [signal.name for signal in message.signals]
    rule = next((rule for begins, rule in _BY_FILE if file.name.startswith(begins)), None)
    ends = ("Checksum", "Counter") if rule == "tesla" else ("CHECKSUM", "COUNTER")
    checksum = next((n for n in names if n == ends[0] or (rule == "tesla" and n.endswith(ends[0]))), None)
    counter = next((n for n in names if n == ends[1] or (rule == "tesla" and n.endswith(ends[1]))), None)
    keys: dict[str, Any] = {}
    said = []
    if rule is not None and checksum is not None:
        keys["checksum"] = {"rule": rule, "signal": checksum}
        said.append(f'checksum = {{ rule = "{rule}", signal = "{checksum}" }}, by the name of {file.name}')
    if counter is not None:
        keys["counter"] = {"signal": counter}
        said.append(f'counter = {{ signal = "{counter}" }}, by its name')
    return ProtectionParams(**keys), "; ".join(said) or "nothing: neither names nor attributes say anything"
