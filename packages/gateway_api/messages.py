"""Messages of python-can, or frames of ours, as a batch of frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, TypeAlias, Union

import numpy as np

from gateway.bus.frames import FRAME, Frames, empty, put_message
from gateway_fdi.errors import InputError, named

if TYPE_CHECKING:
    import can

#: A message, several, or a batch of frames.
Messages: TypeAlias = Union["can.Message", "Iterable[can.Message]", Frames]


def batch_of(messages: Messages, channels: Mapping[str, int] | None, bus: str | None, buses: list[str]) -> Frames:
    """Return messages as a batch.

    Args:
        messages: to be fed, in order of time.
        channels: channel of a message -> index of its bus; None: there is one bus, and all is on it.
        bus: name of the bus that all messages are on; None: by their channels.
        buses: names of the buses.

    Raises:
        InputError: these are no messages, or of a channel that is no bus.
    """
    index = None
    if bus is not None:
        if bus not in buses:
            raise InputError(named("the buses are", bus, buses), key="bus", value=bus)
        index = buses.index(bus)
    elif channels is None:
        index = 0
    if isinstance(messages, np.ndarray):
        if messages.dtype != FRAME or messages.ndim != 1:
            text = f"frames are an array of shape (n,) of gateway's FRAME, not {messages.dtype} of {messages.shape}"
            raise InputError(text, key="messages")
        if len(messages) and int(messages["bus"].max()) >= len(buses):
            text = f"frames of bus {int(messages['bus'].max())}; the buses are 0 to {len(buses) - 1}"
            raise InputError(text, key="messages")
        return messages.view(FRAME)
    if hasattr(messages, "recv"):
        raise InputError("a bus has no end: feed its messages one by one, for message in bus", key="messages")
    listed = list(messages) if isinstance(messages, Iterable) else [messages]
    frames = empty(len(listed))
    for k, message in enumerate(listed):
        if not hasattr(message, "arbitration_id"):
            text = f"a message of python-can, or frames; this is {type(message).__name__}"
            raise InputError(text, key=f"messages[{k}]", value=message)
        place = index
        if place is None and channels is not None:
            place = channels.get(str(message.channel))
        if place is None:
            text = f"no bus has this channel; the buses are {', '.join(buses)}: say bus=..."
            raise InputError(text, key=f"messages[{k}].channel", value=message.channel)
        put_message(frames, k, message, bus=place)
    return frames
