"""A daemon in this process, on buses and clocks that a test makes: time passes and is set when the test says so."""

import os
from functools import partial

from gateway.bus.base import Bus
from gateway.bus.frames import put
from gateway.live.clock import Clock
from gateway.live.daemon import Daemon
from gateway.live.machine import Machine
from gateway_fdi.errors import BusError

MS = 1_000_000
#: Time between two turns of the loop [ns].
TURN_NS = 5 * MS


class Wire(Bus):
    """One bus of the world."""

    def __init__(self, world, uri, index):
        super().__init__(uri, index)
        if uri in world.cut:
            raise BusError(f"{uri}: cut")
        self.world = world
        self._event = os.eventfd(0)
        world.wires[uri] = self
        self.waiting = []
        self.own_clock = uri in world.own_clocks

    def fileno(self):
        return self._event

    def receive(self, out):
        if self.uri in self.world.cut and not self.waiting:
            raise BusError(f"{self.uri}: cut")
        part, self.waiting = self.waiting[: len(out)], self.waiting[len(out) :]
        for k, (stamp, can_id, data) in enumerate(part):
            put(out, k, stamp, can_id, data, bus=self.index)
        self.statistics.received += len(part)
        return len(part)

    def send(self, frames):
        if self.uri in self.world.cut:
            raise BusError(f"{self.uri}: cut")
        for frame in frames:
            data = bytes(frame["data"][: int(frame["length"])])
            self.world.sent.append((self.world.now_ns, self.uri, int(frame["can_id"]), data))
        return len(frames)

    def close(self):
        if self._event >= 0:
            os.close(self._event)
            self._event = -1
        if self.world.wires.get(self.uri) is self:
            del self.world.wires[self.uri]


class World:
    """Time, buses, and what is seen of the daemon.

    Attributes:
        now_ns: true time [ns]; ``ahead_ns`` is what the wall clock is ahead of it.
        sent: (true time, URI, identifier, data) of frames that the daemon sent.
        events: (true time, event).
        cut: URIs of buses that are gone.
        boot: names the machine's boot; waits: true times at which the daemon waits, and for how long [s].
        leaving: tells whether the daemon was asked to end.
        own_clocks: URI -> what the stamps of its adapter are ahead of true time [ns].
    """

    def __init__(self, *, own_clocks=()):
        self.now_ns, self.ahead_ns = 10**12, 1_700_000_000 * 10**9
        self.start_ns = self.now_ns
        self.wires, self.cut, self.own_clocks = {}, set(), dict(own_clocks)
        self.sent, self.events, self.waits = [], [], []
        self.boot, self.leaving = "one", lambda: False
        self.clock = Clock(lambda: self.now_ns + self.ahead_ns, lambda: self.now_ns)

    def sleep(self, seconds):
        self.waits.append((self.now_ns, seconds))
        self.now_ns += round(seconds * 1e9)

    def daemon(self, config, memory, *, begin_writer=None, patience_s=Machine.patience_s, **options):
        """Make the daemon; ``options`` are its own. A thread would write in real time: there is none, unless given."""
        self.running = Daemon(
            config,
            memory=memory,
            asked=lambda: self.leaving(),  # noqa: PLW0108 - a test may set another one
            **options,
            report=lambda event: self.events.append((self.now_ns, event)),
            machine=Machine(
                clock=self.clock,
                monotonic=lambda: self.now_ns / 1e9,
                sleep=self.sleep,
                boot=lambda: self.boot,
                open_bus=partial(Wire, self),
                tick_s=0.0,
                settle=lambda again: None,  # it would look through all that the tests have loaded
                begin_writer=begin_writer,
                patience_s=patience_s,
            ),
        )
        return self.running

    def put(self, can_id, data, uri="virtual:a"):
        """A frame comes now, if the bus is there."""
        ahead = self.own_clocks.get(uri, self.ahead_ns)
        if uri in self.wires:
            self.wires[uri].waiting.append((self.now_ns + ahead, can_id, data))

    def set_clock(self, step_s):
        self.ahead_ns += round(step_s * 1e9)

    def play(self, daemon, script):
        """Run the daemon as long as a script yields, a turn each; then it ends as at SIGTERM."""
        steps = iter(script)
        end = object()
        daemon.run(lambda: next(steps, end) is end)

    def wait(self, seconds, each=None):
        """Let true time pass; ``each`` is called with the count of turns before every turn."""
        for turn in range(round(seconds * 1e9) // TURN_NS):
            self.now_ns += TURN_NS
            if each is not None:
                each(turn)
            yield

    def told(self, kind):
        return [event for _, event in self.events if event["event"] == kind]

    def dtcs(self):
        return [(e["dtc"], e["status"] & 1) for e in self.told("dtc")]
