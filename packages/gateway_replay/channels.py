"""Which channel of a log is which bus."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.config.model import Config
from gateway_fdi.errors import InputError, nearest


def channels_of(config: Config, maps: Sequence[str] = ()) -> dict[str, int] | None:
    """Return which names in a log stand for which bus; None: there is one bus, and all is on it.

    Args:
        config: the configuration.
        maps: further names, ``"channel=bus"`` each. With one bus, only these and its own names are on it then.

    Raises:
        InputError: a map that is none, to a bus that is not there, or of a channel that has another.
    """
    if len(config.bus) == 1 and not maps:
        return None
    names = {}
    if len(config.bus) > 1:
        names = {f"can{k}": k for k in range(len(config.bus))}  # as our logs call buses without a name
        names |= {str(k): k for k in range(len(config.bus))}
    for k, bus in enumerate(config.bus):
        names |= {bus.name: k, bus.channel: k}
    known = [bus.name for bus in config.bus]
    joined: dict[str, int] = {}
    for text in maps:
        channel, equals, name = text.rpartition("=")
        if not equals or not channel:
            raise InputError("channel=bus, e.g. vcan7=chassis", key="--map", value=text)
        if name not in known:
            hint = nearest(name, known)
            raise InputError(f"the buses are {', '.join(known)}{hint}", key="--map", value=text)
        index = known.index(name)
        if joined.setdefault(channel, index) != index:
            raise InputError("this channel is joined to another bus", key="--map", value=text)
    return names | joined
