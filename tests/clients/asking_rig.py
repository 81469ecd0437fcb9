"""A gateway that asks, and ECUs that answer, on one bus, at a time that only passes when told."""

from collections import deque

import numpy as np

from gateway.bus.frames import OWN, empty, joined, payload, put
from gateway.config.load import load_config
from gateway.isotp.endpoint import IsoTpEndpoint
from gateway.isotp.params import IsoTpParams
from gateway.runtime.app import Gateway

MS = 1_000_000
#: A layout longer than a page: a signal across the edge of the first two, one in the last bytes.
DBC = """VERSION ""
BU_: A
BO_ 2149720321 Cells: 150 A
 SG_ First : 7|16@0+ (0.001,0) [0|65] "V" A
 SG_ Edge : 440|64@1+ (1,0) [0|0] "" A
 SG_ Last : 1191|16@0+ (0.001,0) [0|65] "V" A
BO_ 2149716113 Speed: 2 A
 SG_ Speed : 7|16@0+ (0.01,0) [0|655] "km/h" A
"""
BUS = '[[bus]]\nname = "obd"\nuri = "virtual:ask"\n'


def write(folder, toml, dbc=DBC):
    (folder / "cells.dbc").write_text(dbc)
    (folder / "ask.toml").write_text(toml)
    return folder / "ask.toml"


class Ecu:
    """An ECU: an address, and a function from a request to answers, each so many milliseconds later."""

    def __init__(self, request, response, answer, bus=0, extended=False):
        to_all = 0x18DB33F1 if extended else 0x7DF
        more = {"extended": True} if extended else {}
        params = IsoTpParams(request=request, response=response, functional=to_all, **more)
        self.transport = IsoTpEndpoint(params, bus)
        self.answer, self.due, self.heard = answer, deque(), []

    def take(self, frames):
        for frame in frames[self.transport.wanted(frames)]:
            found = self.transport.receive(frame, int(frame["t_ns"]))
            if found is not None:
                self.heard.append(found.data)
                self.due += [(found.t_ns + round(ms * MS), data) for ms, data in self.answer(found.data)]
        return self.transport.take_frames()

    @property
    def next_ns(self):
        return min(self.transport.next_ns, self.due[0][0] if self.due and not self.transport.sending else 1 << 63)

    def step(self, t_ns):
        self.transport.advance(t_ns)
        ready = []
        while self.due and self.due[0][0] <= t_ns and not self.transport.sending:
            ready.append(self.due.popleft()[1])
        self.transport.send(ready)
        return self.transport.take_frames()


class Server:
    """A gateway of ours as an ECU."""

    def __init__(self, rig):
        self.rig = rig

    @property
    def next_ns(self):
        return self.rig.gateway.next_ns

    def take(self, frames):
        self.rig.now = int(frames["t_ns"][-1])
        return self.rig.gateway.feed(frames)

    def step(self, t_ns):
        self.rig.now = t_ns
        return self.rig.gateway.poll(t_ns)


class Car:
    """The gateway, the ECUs, and a log of their bus."""

    def __init__(self, config, ecus=(), memory=None):
        self.gateway, self.ecus = Gateway(load_config(config), memory, file=config), list(ecus)
        self.now, self.log, self.sent, self.events = 0, [], [], []
        self.gateway.listen(self.events.append)
        self.gateway.start(0)

    def close(self):
        self.gateway.close()

    def say(self, can_id, data):
        """Put a frame of another node on the bus."""
        frame = empty(1)
        put(frame, 0, self.now, can_id, bytes(data))
        self._feed(frame)

    def run(self, milliseconds, *others):
        """Let time pass; the frames of others come among it, (millisecond, identifier, data) each."""
        waiting, begun = sorted(others), self.now
        for _ in range(round(milliseconds)):
            self.now += MS
            while waiting and begun + waiting[0][0] * MS <= self.now:
                self.say(*waiting.pop(0)[1:])
            self._feed(joined([ecu.step(self.now) for ecu in self.ecus if ecu.next_ns <= self.now]))
            if not self.now % (10 * MS):
                self._send(self.gateway.advance(self.now - 20 * MS))
            if self.gateway.next_ns <= self.now:
                self._send(self.gateway.poll(self.now))
        return self

    def _feed(self, frames):
        if len(frames):
            frames["t_ns"], frames["rank"] = self.now, 0
            self.log.append(frames.copy())
            self._send(self.gateway.feed(frames))

    def _send(self, frames):
        if len(frames):
            mine = frames.copy()
            mine["t_ns"], mine["flags"] = self.now, mine["flags"] | OWN
            self.log.append(mine)
            self.sent += [(self.now // MS, int(f["can_id"]), payload(f)) for f in mine]
            self._feed(joined([ecu.take(mine) for ecu in self.ecus]))

    @property
    def requests(self):
        """Requests that left the gateway: (millisecond, identifier, bytes)."""
        return [(t, can_id, data[1 : 1 + data[0]]) for t, can_id, data in self.sent if data[0] < 8]

    def recording(self):
        return joined(self.log)

    def state(self, k=0):
        return self.gateway.asking.states()[k]

    def value(self, name):
        slot = self.gateway.signal_slots[name]
        return self.gateway.engine.value(slot)


def settled(state):
    """Return whether each request is accounted for, but one that is under way."""
    ends = sum(state[name] for name in ("answers", "refused", "absent", "yielded"))
    return 0 <= state["requests"] - ends <= 1


def changed(rng, data):
    """Return a payload with a bit turned, cut, made longer, or another one."""
    data = bytearray(data)
    kind = rng.integers(4)
    if kind == 0 and data:
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    elif kind == 1:
        del data[rng.integers(len(data) + 1) :]
    elif kind == 2:
        data += rng.bytes(int(rng.integers(1, 9)))
    else:
        data = bytearray(rng.bytes(int(rng.integers(0, 9))))
    return bytes(data[:8])


def raised(frames):
    return frames[np.argsort(frames["t_ns"], kind="stable")]
