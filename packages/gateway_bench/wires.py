"""Python-can's virtual buses between virtual ECUs and a tester, and a gateway, all in one thread.

A frame on a virtual bus has arrived when it is sent. So there is no waiting, and no thread that reads: a second
one for each end would hand over to this one twice for each frame.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator

import can
import numpy as np

from gateway.bus.frames import Frames, empty, put_message, to_message
from gateway.runtime.app import Gateway
from gateway.servers.dtc_frame import DtcReport, read_dtc_frame
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import BusError

_names = itertools.count()


class _End:
    """One end of a virtual bus.

    Args:
        channel: the bus.
        index: of the bus, stamped into every frame.
    """

    def __init__(self, channel: str, index: int) -> None:
        self._channel, self._index = channel, index
        self._bus = can.Bus(channel, interface="virtual", preserve_timestamps=True)

    def send(self, frames: Frames) -> None:
        """Send frames, in order."""
        for frame in frames:
            self._bus.send(to_message(frame))

    def receive(self, count: int) -> Frames:
        """Return exactly this number of frames that have arrived.

        Raises:
            BusError: there are fewer.
        """
        frames = empty(count)
        for k in range(count):
            message = self._bus.recv(0)
            if message is None:
                raise BusError(f"{self._channel}: {count - k} of {count} frames did not arrive")
            put_message(frames, k, message, bus=self._index)
        return frames

    def passed(self, can_id: int) -> Frames:
        """Return the frames of one identifier that have arrived; the others are nothing to this end."""
        found = []
        while (message := self._bus.recv(0)) is not None:
            if message.arbitration_id == can_id and not message.is_extended_id:
                frame = empty(1)
                put_message(frame, 0, message, bus=self._index)
                found.append(frame)
        return np.concatenate(found) if found else empty(0)

    def close(self) -> None:
        """Close it."""
        self._bus.shutdown()


class Wires:
    """The virtual buses of a configuration, with two ends each: the gateway's, and that of the ECUs and a tester.

    Args:
        gateway: whose configuration it is.
    """

    def __init__(self, gateway: Gateway) -> None:
        channels = [f"{bus.name}-{os.getpid()}-{next(_names)}" for bus in gateway.config.bus]
        self._dtc_frame_id = gateway.dtc_frame_id
        self._database = shipped("dbc/gateway.dbc")
        self._others, self._ours = ([_End(channel, index) for index, channel in enumerate(channels)] for _ in range(2))

    def carry(self, frames: Frames) -> Frames:
        """Send frames from the ECUs; returns them as the gateway got them, in order of time."""
        if not len(frames):
            return frames
        arrived = []
        for index, (others, ours) in enumerate(zip(self._others, self._ours, strict=True)):
            mine = frames[frames["bus"] == index]
            others.send(mine)
            arrived.append(ours.receive(len(mine)))
        batch = np.concatenate(arrived)
        return batch[np.argsort(batch["t_ns"], kind="stable")]

    def reports(self, frames: Frames) -> Iterator[DtcReport]:
        """Send frames from the gateway, bus by bus; yields the DTC frames among them as a tester decodes them."""
        if not len(frames):
            return
        for index, (others, ours) in enumerate(zip(self._others, self._ours, strict=True)):
            ours.send(frames[frames["bus"] == index])
            # The tester's; virtual ECUs hear what the gateway sends from their player.
            for frame in others.passed(self._dtc_frame_id):
                report = read_dtc_frame(frame, self._database)
                if report is not None:
                    yield report

    def close(self) -> None:
        """Close all ends."""
        for end in (*self._others, *self._ours):
            end.close()
