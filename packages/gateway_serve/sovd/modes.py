"""Modes: the session (0x10), the security level (0x27) and the setting of DTCs (0x85) of the client's own tester."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from gateway.servers.access import SESSIONS
from gateway_serve.sovd.components import OWN, Component, place
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Body, Item, Items, Model
from gateway_serve.sovd.table import Call, Endpoint

_NAMES = {number: name for name, number in SESSIONS.items()}
_SEED = "_request_seed"


class Key(Body):
    """A key, as hexadecimal digits."""

    send_key: str = Field(alias="Send_Key", pattern=r"^(0x)?([0-9A-Fa-f]{2}){1,255}$")


class ModeRequest(Body):
    """A mode: of ``security`` "level_1_request_seed", and with the key "level_1"."""

    value: str = Field(max_length=40)
    key: Key | None = Field(None, alias="Key")


class Seed(Model):
    """A seed, as hexadecimal digits."""

    request_seed: str = Field(alias="Request_Seed")


class ModeSet(Model):
    """The mode that there is now, or the seed that was asked for."""

    id: str
    value: str
    seed: Seed | None = None


class ModeShown(Model):
    """A mode."""

    id: Literal["session", "security", "dtcsetting"]
    name: str
    value: str
    values: list[str]


def _levels(call: Call) -> list[int]:
    return list(call.state.hub.hello["levels"])


def _modes(call: Call, one: Component) -> dict[str, tuple[str, list[str]]]:
    """Return name and values of the modes of a component by id."""
    if not one.ecu:
        return {}
    found = {"session": ("Diagnostic session", sorted(SESSIONS)), "dtcsetting": ("Setting of DTCs", ["on", "off"])}
    levels = _levels(call) if one.id == OWN else []
    if levels:
        asked = [f"level_{n}{kind}" for n in levels for kind in ("", _SEED)]
        found["security"] = ("Security access", asked)
    return found


async def _list(call: Call) -> Items:
    one = call.state.component(call.path)
    modes = _modes(call, one)
    return Items(
        items=[Item(id=key, name=modes[key][0], href=place("components", one.id, "modes", key)) for key in modes]
    )


def _mode(call: Call) -> tuple[Component, str, str, Sequence[str]]:
    one, key = call.state.component(call.path), call.path["mode_id"]
    modes = _modes(call, one)
    if key not in modes:
        raise SovdError(404, "there is no such mode")
    return one, key, *modes[key]


async def _show(call: Call) -> ModeShown:
    one, key, name, values = _mode(call)
    lock = call.state.locks.of(one.id)
    lock = lock if lock is not None and lock.who == call.who else None
    if key == "session":
        number = (await call.state.ask(call.who, one.ecu, b"\x22\xf1\x86"))[3]
        value = _NAMES.get(number, f"0x{number:02X}")
    elif key == "security":
        value = f"level_{lock.level}" if lock is not None and lock.level else "locked"
    elif one.id == OWN:
        value = "on" if call.state.hub.monitoring["dtcs"] else "off"
    else:
        value = "unknown" if lock is None else ("on" if lock.dtcs else "off")
    return ModeShown(id=key, name=name, value=value, values=list(values))


async def _set(call: Call) -> ModeSet:
    one, key, _, values = _mode(call)
    lock, value = call.state.locks.own(call.who, one), call.body.value
    if value not in values:
        raise SovdError(409, f"value: one of {', '.join(values)}")
    if key == "security":
        return await _unlock(call, one, value)
    if key == "session":
        await call.state.ask(call.who, one.ecu, bytes([0x10, SESSIONS[value]]))
        lock.forget_session()
        lock.extended = value != "default"
        return ModeSet(id=key, value=value)
    await call.state.locks.intervene(call.who, one, bytes([0x85, 0x01 if value == "on" else 0x02]))
    lock.dtcs = value == "on"
    return ModeSet(id=key, value=value)


async def _unlock(call: Call, one: Component, value: str) -> ModeSet:
    level = int(value.removesuffix(_SEED).removeprefix("level_"))
    if value.endswith(_SEED):
        answer = await call.state.locks.intervene(call.who, one, bytes([0x27, 2 * level - 1]))
        return ModeSet(id="security", value=value, seed=Seed(request_seed=f"0x{answer[2:].hex()}"))
    if call.body.key is None:
        raise SovdError(409, f"Key: first ask for a seed ({value}{_SEED}), then send its key")
    key = bytes.fromhex(call.body.key.send_key.removeprefix("0x"))
    await call.state.locks.intervene(call.who, one, bytes([0x27, 2 * level]) + key)
    call.state.locks.own(call.who, one).level = level
    return ModeSet(id="security", value=value)


_PATH = "/components/{component_id}/modes"
ENDPOINTS = (
    Endpoint("GET", _PATH, "Modes of a component", _list, Items),
    Endpoint("GET", _PATH + "/{mode_id}", "A mode", _show, ModeShown),
    Endpoint("PUT", _PATH + "/{mode_id}", "Change a mode", _set, ModeSet, 200, ModeRequest),
)
