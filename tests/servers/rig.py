"""A gateway with many faults, a clock of its own, and ways to make each fault come and go."""

from pathlib import Path

import isotp

from gateway.bus.frames import EXTENDED, FD, empty, joined, payload, put
from gateway.config.load import load_config
from gateway.runtime.app import Gateway

MS = 1_000_000
REQUEST, FUNCTIONAL, RESPONSE = 0x7E0, 0x7DF, 0x7E8

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
"""

CONFIG = """
[clock]
watched = false
[[bus]]
name = "b"
uri = "virtual:rig"
database = ["rig.dbc"]
health = { watched = false }
"""


def dtc_text(k):
    """DTC of the length fault of message k: letters P, C, B, U in turn."""
    return f"{'PCBU'[k % 4]}1{k:03X}-11"


def write_config(folder: Path, messages=3, *, extra="", faults=None, head=""):
    """Write a database of so many messages, and a configuration with a length check of each.

    Args:
        folder: for both files.
        messages: how many.
        extra: further TOML.
        faults: message -> TOML lines of its fault.
        head: TOML before any table.
    """
    dbc, toml = DBC, head + CONFIG
    for k in range(messages):
        dbc += f'BO_ {256 + k} M{k}: 8 A\n SG_ Value : 0|16@1+ (0.5,0) [0|32767] "V" B\n'
        toml += f'[[bus.check]]\nmessage = "M{k}"\n'
    for k in range(messages):
        toml += f'[fault."b.M{k}.length"]\ndtc = "{dtc_text(k)}"\n' + (faults or {}).get(k, "")
    (folder / "rig.dbc").write_text(dbc)
    (folder / "rig.toml").write_text(toml + extra)
    return folder / "rig.toml"


class Rig:
    """A gateway and its bus, at a time that only passes when told."""

    def __init__(self, config: Path, memory: Path | None = None, *, start=True, watched=False, heard=True):
        loaded = load_config(config)
        if not watched:  # the faults of the memory itself, and of switched-off monitoring
            kept = loaded.memory.model_copy(update={"watched": False})
            access = loaded.access.model_copy(update={"watched": False})
            loaded = loaded.model_copy(update={"memory": kept, "access": access})
        self.gateway = Gateway(loaded, memory, file=config)
        self.now = 0
        self.sent = []
        self.events = []
        if heard:  # else nothing grows with the length of a run
            self.gateway.listen(self.events.append)
        if start:
            self.gateway.start(0)

    def close(self):
        self.gateway.close()

    def feed(self, *rows, flags=0):
        """Feed (can_id, payload) one millisecond apart; returns and keeps what was sent."""
        made = []
        for can_id, data in rows:
            self.now += MS
            frames = empty(1)
            put(frames, 0, self.now, can_id, data, flags=flags)
            made.append(self.gateway.feed(frames))
        return self._keep(made)

    def wait(self, milliseconds, step=10):
        """Let time pass; returns and keeps what was sent."""
        made = []
        end = self.now + round(milliseconds * MS)
        while self.now < end:
            self.now = min(self.now + step * MS, end)
            made.append(self.gateway.advance(self.now))
            made.append(self.gateway.poll(self.now))
        return self._keep(made)

    def _keep(self, made):
        frames = joined(made)
        found = [(int(f["can_id"]), payload(f)) for f in frames]
        self.sent += found
        return found

    def value(self, k, volts):
        """Send message k with a value, good."""
        return self.feed((256 + k, round(volts * 2).to_bytes(2, "little") + bytes(6)))

    def fail(self, k):
        """Make the length fault of message k fail (two short frames)."""
        return self.feed((256 + k, b"\x01"), (256 + k, b"\x01"))

    def heal(self, k):
        """Make the length fault of message k pass (good frames until its counter is at the end)."""
        return self.feed(*[(256 + k, bytes(8))] * 53)

    def cycle(self, *failing, passing=()):
        """One operation cycle in which some faults fail and some pass."""
        self.gateway.stop(self.now)
        self.gateway.start(self.now)
        for k in failing:
            self.fail(k)
        for k in passing:
            self.heal(k)

    def fault(self, k):
        return f"b.M{k}.length"

    def status(self, k):
        return int(self.gateway.memory.status(self.fault(k)))


class Tester:
    """A tester's ISO-TP, by can-isotp itself, on the rig's bus and clock."""

    __test__ = False

    def __init__(self, rig, request=REQUEST, response=RESPONSE, **params):
        self.rig = rig
        self.inbox = []
        self.outbox = []
        self.flags = FD if params.get("can_fd") else 0
        self.request_id, self.response_id = request, response
        mode = isotp.AddressingMode.Normal_11bits
        if request > 0x7FF:
            mode = isotp.AddressingMode.Normal_29bits
        self.layer = isotp.TransportLayerLogic(
            rxfn=lambda timeout: self.inbox.pop(0) if self.inbox else None,
            txfn=self.outbox.append,
            address=isotp.Address(mode, txid=request, rxid=response),
            params={"tx_padding": 0x55, "blocksize": 0, "stmin": 0, **params},
        )

    def hear(self, frames):
        """Take frames that the gateway sent, as seen on the bus."""
        for can_id, data in frames:
            if can_id & 0x1FFFFFFF == self.response_id:
                self.inbox.append(isotp.CanMessage(self.response_id, len(data), data, can_id > 0x7FF))

    def listen(self, patience=20):
        """Return what comes by itself."""
        return self._collect(patience)

    def exchange(self, request, *, functional=None, patience=40):
        """Send a request; returns all responses that come within some steps of a millisecond."""
        extended = EXTENDED if self.request_id > 0x7FF else 0
        if functional is not None:
            frame = bytes([len(request)]) + request
            self.hear(self.rig.feed((functional | extended, frame.ljust(8, b"\x55"))))
        else:
            self.layer.send(bytes(request))
        return self._collect(patience)

    def _collect(self, patience):
        answers = []
        extended = EXTENDED if self.request_id > 0x7FF else 0
        for _ in range(patience):
            self.layer.process()
            busy = bool(self.outbox or self.inbox)
            while self.outbox:
                message = self.outbox.pop(0)
                frame = (message.arbitration_id | extended, bytes(message.data))
                self.hear(self.rig.feed(frame, flags=self.flags))
            while self.layer.available():
                answers.append(bytes(self.layer.recv()))
            if not busy:
                self.hear(self.rig.wait(1, step=1))
        return answers

    def ask(self, request, **options):
        """Send a request; returns the one response."""
        (answer,) = self.exchange(bytes.fromhex(request) if isinstance(request, str) else request, **options)
        return answer
