"""A server of the workshop's bench: to a frame it answers with the number of DTCs that have failed, and their codes.

::

    [[server]]
    name = "bench"
    type = "workshop"
    request = 0x6A0
    response = 0x6A1
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gateway.bus.frames import Frames, empty, put
from gateway.servers.bus_server import BusServer
from gateway.servers.types import Place, ServerType
from gateway_fdi.common.tomlfile import StrictModel


class Params(StrictModel):
    """Keys of the table."""

    request: int = Field(ge=0, le=0x7FF, description="identifier of what asks")
    response: int = Field(ge=0, le=0x7FF, description="identifier of the answers")


class Bench(BusServer):
    """The server: the first byte is the number of DTCs, then come two codes at most."""

    door = "workshop"
    prompt = True  # its time is that of the bus

    def __init__(self, params: Params, place: Place) -> None:
        self._params, self._place, self._answers = params, place, 0

    def identifiers(self, bus: int) -> list[int]:
        """Return what it listens to on a bus."""
        return [self._params.request] if bus == self._place.bus else []

    def wanted(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames are for it."""
        return np.asarray((frames["bus"] == self._place.bus) & (frames["can_id"] == self._params.request))

    def on_frame(self, frame: np.void, t_ns: int) -> Frames:
        """Return the answer to a frame."""
        found = [bytes(entry.dtc) for entry in self._place.memory.entries()]
        made = empty(1)
        put(made, 0, t_ns, self._params.response, bytes([len(found)]) + b"".join(found[:2]), bus=self._place.bus)
        self._answers += 1
        return made

    def counters(self) -> dict[str, int]:
        """Return what it counted."""
        return {"bench_answers": self._answers}


SERVER = ServerType(params=Params, made=Bench, identifiers=lambda p: (p.request, p.response))
