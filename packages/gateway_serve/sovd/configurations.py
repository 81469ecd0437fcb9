"""Configurations: data identifiers of the gateway that may be written."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gateway_serve.sovd.components import OWN
from gateway_serve.sovd.data import identifiers, read_did
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Body, Model, ReadValue
from gateway_serve.sovd.table import Call, Endpoint


class ConfigurationItem(Model):
    """A configuration."""

    id: str
    name: str
    type: Literal["parameter"] = "parameter"


class ConfigurationList(Model):
    """All that may be written."""

    items: list[ConfigurationItem]


class NewText(Body):
    """A value as text, of the same length as the present one."""

    value: str = Field(pattern=r"^[\x20-\x7e]{1,4000}$")


class NewBytes(Body):
    """A value as hexadecimal digits, of the same length as the present one."""

    raw: str = Field(pattern=r"^([0-9A-Fa-f]{2}){1,4000}$")


class WriteValue(Body):
    """The new value."""

    data: NewText | NewBytes


def _writable(call: Call) -> dict[str, str]:
    own = call.state.component(call.path).id == OWN
    return {key: str(each["name"]) for key, each in identifiers(call).items() if each["writable"]} if own else {}


async def _list(call: Call) -> ConfigurationList:
    items = [ConfigurationItem(id=key, name=name) for key, name in _writable(call).items()]
    return ConfigurationList(items=items)


def _key(call: Call) -> str:
    key = call.path["configuration_id"]
    if key not in _writable(call):
        raise SovdError(404, "there is no such configuration")
    return key


async def _read(call: Call) -> ReadValue:
    key = _key(call)
    return ReadValue(id=key, data=await read_did(call, call.state.component(call.path), key))


async def _write(call: Call) -> None:
    key, new = _key(call), call.body.data
    data = bytes.fromhex(new.raw) if isinstance(new, NewBytes) else new.value.encode()
    request = b"\x2e" + bytes.fromhex(key.removeprefix("did-")) + data
    try:
        await call.state.locks.intervene(call.who, call.state.component(call.path), request)
    except SovdError as error:
        if error.status != 400:
            raise
        text = f"{error.message}; a value has the length of the present one"
        raise SovdError(409, text, error.code, error.parameters) from error


_PATH = "/components/{component_id}/configurations"
ENDPOINTS = (
    Endpoint("GET", _PATH, "Values that may be written", _list, ConfigurationList),
    Endpoint("GET", _PATH + "/{configuration_id}", "A value that may be written", _read, ReadValue),
    Endpoint("PUT", _PATH + "/{configuration_id}", "Write a value", _write, None, 204, WriteValue),
)
