"""Buses by URI."""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import parse_qsl

from gateway.bus.adapter import PythonCanBus
from gateway.bus.base import Bus
from gateway.bus.loopback import DEFAULT_ADDRESS, DEFAULT_BUS, LoopbackBus
from gateway.bus.socketcan import RCVBUF, SocketCanBus
from gateway_fdi.errors import BusError, InputError, UnsupportedError, nearest

_FORMS = (
    "socketcan:vcan0, loopback:127.0.0.1:29536, virtual:name, "
    "or a python-can interface as pcan:PCAN_USBBUS1?bitrate=500000"
)


def loopback_address(text: str) -> tuple[str, int]:
    """Read ``host:port`` of this machine's loopback; either may be left out.

    Raises:
        InputError: not an address, or one that other machines could reach.
    """
    host, port = DEFAULT_ADDRESS
    if text:
        given, colon, number = text.rpartition(":")
        if not colon:
            given, number = (text, "") if not text.isdigit() else ("", text)
        host = given.strip("[]") or host
        host = DEFAULT_ADDRESS[0] if host == "localhost" else host
        if number:
            if not number.isdigit() or not 0 <= int(number) <= 65535:
                raise InputError("a port is a number up to 65535", key="port", value=number)
            port = int(number)
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = False
    if not local:
        raise InputError("the bus between processes stays on this machine: 127.0.0.1 or ::1", value=host)
    return host, port


def _options(query: str) -> dict[str, object]:
    """Read ``a=1&b=true`` into numbers, truth values and texts."""
    found: dict[str, object] = {}
    for key, text in parse_qsl(query, keep_blank_values=True):
        if text.lower() in ("true", "false"):
            found[key] = text.lower() == "true"
        else:
            found[key] = text
            with suppress(ValueError):
                found[key] = int(text, 0)
    return found


def channel_of(uri: str) -> str:
    """Return the name of a bus in logs: that of its interface or channel, as can-utils writes it."""
    place = uri.partition(":")[2].partition("?")[0]
    return "".join(c if c.isalnum() or c in "_-." else "_" for c in place) or "can0"


@dataclass(frozen=True)
class BusUri:
    """A bus URI that is right as far as it can be told without opening it."""

    scheme: str
    place: str
    options: dict[str, object]


def parse_uri(uri: str) -> BusUri:
    """Read a bus URI.

    Raises:
        InputError: not a URI of a bus; says what would be one.
    """
    scheme, colon, rest = uri.partition(":")
    place, _, query = rest.partition("?")
    options = _options(query)
    if not colon or not scheme:
        raise InputError(f"a bus is named as {_FORMS}", key="uri", value=uri)
    if scheme == "loopback":
        loopback_address(place.partition("/")[0])
        return BusUri(scheme, place, options)
    if not place:
        raise InputError(f"the channel is missing: {_FORMS}", key="uri", value=uri)
    if scheme == "socketcan":
        unknown = set(options) - {"fd", "rcvbuf"}
        if unknown:
            raise InputError("socketcan takes fd=true and rcvbuf=bytes", key="uri", value=", ".join(unknown))
        rcvbuf = options.setdefault("rcvbuf", RCVBUF)
        if not isinstance(rcvbuf, int) or isinstance(rcvbuf, bool) or rcvbuf <= 0:
            raise InputError("rcvbuf is a number of bytes", key="uri", value=rcvbuf)
    elif scheme != "virtual":
        _of_python_can(scheme, uri)
    return BusUri(scheme, place, options)


def _of_python_can(scheme: str, uri: str) -> None:
    """Refuse a scheme that is no interface of python-can, which is loaded for these only."""
    import can  # noqa: PLC0415 - slow to load

    if scheme not in can.VALID_INTERFACES:
        hint = nearest(scheme, ("socketcan", "loopback", "virtual", *can.VALID_INTERFACES))
        raise InputError(f"no such kind of bus{hint}; there are {_FORMS}", key="uri", value=uri)


def open_bus(uri: str, index: int = 0, *, patience_s: float = 10.0) -> Bus:
    """Open a bus.

    Args:
        uri: what and where, see the errors for the forms.
        index: stamped into every frame.
        patience_s: how long a loopback bus may take to appear [s].

    Raises:
        InputError: not a URI of a bus, or not one that its interface can take.
        UnsupportedError: this system has no such kind of bus, or no library for it.
        BusError: the bus cannot be opened.
    """
    found = parse_uri(uri)
    place, options = found.place, found.options
    if found.scheme == "loopback":
        address, _, name = place.partition("/")
        host, port = loopback_address(address)
        return LoopbackBus(uri, index, (host, port), name or DEFAULT_BUS, patience_s=patience_s)
    if found.scheme == "socketcan":
        rcvbuf = options["rcvbuf"]
        assert isinstance(rcvbuf, int)
        return SocketCanBus(uri, index, place, fd=bool(options.get("fd", True)), rcvbuf=rcvbuf)
    return _python_can_bus(uri, index, found)


def _python_can_bus(uri: str, index: int, found: BusUri) -> Bus:
    """Open a bus of python-can."""
    import can  # noqa: PLC0415 - slow to load

    place, options = found.place, found.options
    if found.scheme == "virtual":
        options = {"preserve_timestamps": True, **options}
    try:
        opened = can.Bus(channel=place, interface=found.scheme, **options)  # type: ignore[arg-type]
    except (can.CanInterfaceNotImplementedError, ImportError) as error:
        raise UnsupportedError(f"{uri}: this machine has no library for {found.scheme}: {error}") from error
    except (TypeError, ValueError) as error:
        raise InputError(f"{found.scheme}: {error}", key="uri", value=uri) from error
    except Exception as error:  # each interface of python-can raises its own
        if isinstance(error, OSError) and error.errno is None:  # a driver's library, no device
            raise UnsupportedError(f"{uri}: {error}") from error
        raise BusError(f"{uri}: {error}") from error
    return PythonCanBus(uri, index, opened)
