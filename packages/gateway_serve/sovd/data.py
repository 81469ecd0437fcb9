"""Data: data identifiers and signals of the gateway, data identifiers of ECUs."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from gateway.servers.identifiers import CODES
from gateway.servers.uds.nrc import Nrc
from gateway_serve.sovd.components import OWN, Component, slug
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Described, Describing, Model, ReadValue, Value
from gateway_serve.sovd.table import Call, Endpoint

#: Ids of data that UDS reads.
_DID = re.compile(r"did-([0-9A-F]{4})")
_Category = Literal["currentData", "identData"]


class DataItem(Model):
    """Data that can be read."""

    id: str
    name: str
    category: _Category
    unit: str | None = None


class DataList(Described):
    """All that can be read."""

    items: list[DataItem]


class DataFilter(Describing):
    """Which data are listed."""

    category: _Category | None = Field(None, alias="categories")


def identifiers(call: Call) -> dict[str, Mapping[str, Any]]:
    """Return the gateway's data identifiers by their ids here."""
    return {f"did-{each['id'][2:]}": each for each in call.state.hub.hello["identifiers"]}


def _items(call: Call, one: Component) -> list[DataItem]:
    if one.id == OWN:
        found = [
            DataItem(id=key, name=each["name"], category="currentData" if each["signal"] else "identData")
            for key, each in identifiers(call).items()
        ]
        unit = call.state.hub.unit
        return found + [
            DataItem(id=slug(name), name=name, category="currentData", unit=unit(name))
            for name in call.state.hub.hello["signals"]
        ]
    dids: list[int] = next((each["dids"] for each in call.state.hub.hello["ecus"] if each["name"] == one.ecu), [])
    return [DataItem(id=f"did-{did:04X}", name=f"22{did:04X}", category="currentData") for did in dids]


async def _list(call: Call) -> DataList:
    items = _items(call, call.state.component(call.path))
    return DataList(items=[each for each in items if call.query.category in (None, each.category)])


async def read_did(call: Call, one: Component, key: str) -> Value:
    """Return the value of a data identifier, by its id here.

    Raises:
        SovdError: there is none.
    """
    match = _DID.fullmatch(key)
    if match is None or not one.ecu:
        raise SovdError(404, "there is no such data")
    try:
        answer = await call.state.ask(call.who, one.ecu, b"\x22" + bytes.fromhex(match[1]))
    except SovdError as error:
        if (error.parameters or {}).get("nrc") == Nrc.REQUEST_OUT_OF_RANGE:
            raise SovdError(404, error.message, "error-response", error.parameters) from error
        raise
    raw = answer[3:]
    found: float | str | None = _decoded(identifiers(call).get(key, {}), raw) if one.id == OWN else None
    if found is None and raw.isascii() and raw.decode().isprintable():
        found = raw.decode()
    return Value(value=found, raw=raw.hex())


def _decoded(did: Mapping[str, Any], raw: bytes) -> float | None:
    """Return the number of an identifier that stands for a signal."""
    code = CODES.get(did.get("type", ""))
    if code is None or len(raw) != struct.calcsize(code):
        return None
    if code not in "fd" and raw == b"\xff" * len(raw):
        return None  # not known
    value = float(struct.unpack(">" + code, raw)[0]) * did["scale"] + did["offset"]
    return value if math.isfinite(value) else None


async def _read(call: Call) -> ReadValue:
    one, key = call.state.component(call.path), call.path["data_id"]
    return ReadValue(id=key, data=await read(call, one, key))


async def read(call: Call, one: Component, key: str) -> Value:
    """Return a value by its id.

    Raises:
        SovdError: there is none.
    """
    signals = {slug(name): name for name in call.state.hub.hello["signals"]} if one.id == OWN else {}
    if key not in signals:
        return await read_did(call, one, key)
    name = signals[key]
    answer = await call.state.hub.link.ask("values", signals=[name])
    return Value(value=answer["values"][name], unit=call.state.hub.unit(name))


_DATA = "/components/{component_id}/data"
ENDPOINTS = (
    Endpoint("GET", _DATA, "Data of a component", _list, DataList, query=DataFilter),
    Endpoint("GET", _DATA + "/{data_id}", "A value", _read, ReadValue, query=Describing),
)
