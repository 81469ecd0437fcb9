"""Servers that the conformance suite tries in its own process, on the rig's clock: ours, and ours with defects."""

import tempfile
from pathlib import Path

from rig import FUNCTIONAL, REQUEST, RESPONSE, Rig, write_config
from uds_tester import ANYBODY, DIDS

from gateway.bus.frames import EXTENDED, payload
from gateway.servers.diagnostic_server import DiagnosticServer
from gateway_conformance.wires import Heard

MS = 1_000_000
SERVERS = """
[output.uds]
security = [{ level = 1, secret = "00112233" }]
[output.obd]
vin = "1HGCM82633A004352"
pid = [{ id = 0x0C, signal = "M0.Value" }, { id = 0x0D, signal = "M1.Value" }]
[output.j1939]
address = 0x10
software = ["one version", "another version"]
"""
FAULTS = {
    k: f'spn = {100 + k}\nfmi = 3\nseverity = "immediately"\nfreeze_frame = ["volts", "M1.Value"]\n'
    "indicator = true\nemission_related = true\n"
    for k in range(4)
}


def gateway_rig(folder):
    """Return our gateway with four faults: two have failed, one of them is confirmed and heals."""
    rig = Rig(write_config(folder, 4, extra=SERVERS + ANYBODY + "dtc_setting = {}\n" + DIDS, faults=FAULTS))
    rig.wait(500)
    rig.value(0, 12.5)
    rig.cycle(0, 1)
    rig.cycle(0)
    rig.heal(0)
    rig.fail(0)
    rig.sent.clear()
    return rig


class Right:
    """The wire to our gateway."""

    def __init__(self):
        self._folder = tempfile.TemporaryDirectory()
        self.rig = gateway_rig(Path(self._folder.name))
        self._heard = []

    def now_ns(self):
        return self.rig.now

    def _hear(self, frames):
        self._heard += [Heard(self.rig.now, can_id, data) for can_id, data in frames]

    def send(self, can_id, data):
        self._hear(self.rig.feed((can_id, data)))

    def wait(self, ns):
        until = self.rig.now + ns
        while not self._heard and self.rig.now < until:
            self.rig.now = min(self.rig.now + 2 * MS, until)
            for made in (self.rig.gateway.advance(self.rig.now), self.rig.gateway.poll(self.rig.now)):
                self._hear([(int(one["can_id"]), payload(one)) for one in made])
        found, self._heard = self._heard, []
        return found

    def close(self):
        self.rig.close()
        self._folder.cleanup()


def edited(answers, start, change):
    return [change(bytearray(answer)) if answer.startswith(start) else answer for answer in answers]


def at(place, change):
    def work(answer):
        answer[place] = change(answer[place]) & 0xFF
        return bytes(answer)

    return work


#: Defects of a server -> (request, functional, answer(request), answers) -> answers.
SAID = {
    "suppress": lambda r, f, ask, a: [b"\x7e\x00"] if r == b"\x3e\x80" else a,
    "functional": lambda r, f, ask, a: a or ([b"\x7f" + r[:1] + b"\x11"] if f and r[0] == 0x8A else a),
    "length": lambda r, f, ask, a: [b"\x7e\x00"] if r == b"\x3e\x00\x00" else a,
    "count": lambda r, f, ask, a: edited(a, b"\x59\x01", at(5, lambda n: n + 1)),
    "available": lambda r, f, ask, a: edited(a, b"\x59\x02", at(2, lambda n: n & ~0x08)),
    "mask": lambda r, f, ask, a: ask(b"\x19\x02\xff") if r == b"\x19\x02\x08" else a,
    "snapshot": lambda r, f, ask, a: edited(a, b"\x59\x03", at(5, lambda n: n + 1)),
    "unknown_dtc": lambda r, f, ask, a: [b"\x59" + r[1:5] + b"\0"] if a == [b"\x7f\x19\x31"] else a,
    "dids": lambda r, f, ask, a: edited(a, b"\x62\xf1\x90", lambda b: bytes(b[:20])),
    "record": lambda r, f, ask, a: edited(a, b"\x59\x06", lambda b: bytes(b[:-1]) if r[-1] == 0xFF else bytes(b)),
    "pids": lambda r, f, ask, a: edited(a, b"\x41\x00", at(3, lambda n: n | 0x80)),
    "page": lambda r, f, ask, a: edited(a, b"\x62\xf4\x00", at(4, lambda n: n | 0x80)),
    "group": lambda r, f, ask, a: edited(a, b"\x59\x42", at(-1, lambda n: n ^ 0x10)),
    "permanent": lambda r, f, ask, a: edited(a, b"\x59\x55", at(6, lambda n: n ^ 1)),
    "vin": lambda r, f, ask, a: edited(a, b"\x62\xf8\x02", at(5, lambda n: n + 1)),
    "dtcs": lambda r, f, ask, a: edited(a, b"\x43", at(1, lambda n: n + 1)),
}
#: Defects of the transport: frames of the tester (physical, or of J1939) as the server takes them.
TAKEN = {
    "block_size": lambda d: d[:1] + b"\0" + d[2:] if d[:1] == b"\x30" else d,
    "separation": lambda d: d[:2] + b"\0" + d[3:] if d[:1] == b"\x30" else d,
    "wait": lambda d: b"\x30" + d[1:] if d[:1] == b"\x31" else d,
    "sequence": lambda d: b"\x21" + d[1:] if d[:1] == b"\x22" and len(d) == 6 else d,
    "reserved": lambda d: b"\x02" + d[1:] if d[:1] == b"\x08" else d,
}


class Wrong(Right):
    """The wire to a gateway with defects, their names joined by +."""

    def __init__(self, defects):
        super().__init__()
        names = defects.split("+")
        self._taken = [TAKEN[name] for name in names if name in TAKEN]
        self._refuses_all = "refuses_all" in names
        (server,) = [each for each in self.rig.gateway.servers.all if isinstance(each, DiagnosticServer)]
        right, said = server._answer, [SAID[name] for name in names if name in SAID]

        def answer(request, functional, t_ns):
            answers = right(request, functional, t_ns)
            for defect in said:
                answers = defect(request, functional, lambda other: right(other, functional, t_ns), answers)
            return answers

        server._answer = answer

    def send(self, can_id, data):
        for defect in self._taken if can_id == REQUEST else ():
            data = defect(data)
        if self._refuses_all and can_id & 0x00FFFF00 == 0x00EAFF00:
            can_id = can_id & ~0xFF00 | 0x1000
        super().send(can_id, data)


assert (REQUEST, FUNCTIONAL, RESPONSE, EXTENDED) == (0x7E0, 0x7DF, 0x7E8, 1 << 31)  # the suite's defaults
