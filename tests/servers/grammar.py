"""Requests of a grammar: right and nearly right, of UDS and OBD; and frames that only look like a transport's.

They know the shape of each service, so that most get behind the first checks.
"""

import time

import numpy as np
from rig import FUNCTIONAL, MS, REQUEST, RESPONSE, dtc_text

from gateway.bus.frames import EXTENDED, empty, put
from gateway.faults.dtc import Dtc

MESSAGES = 6
CONFIG = """
[output.uds]
security = [{ level = 1, secret = "00", attempts = 2, delay_s = 0.1 }]
further = [{ request = 0x7E4, response = 0x7EC }]
[output.obd]
vin = "1HGCM82633A004352"
pid = [{ id = 0x0C, signal = "M0.Value" }]
[output.j1939]
address = 0x80
[access]
unprotected = ["M5.Value"]
when = [{ signal = "M5.Value", max = 10.0 }]
[[did]]
id = 0x0124
name = "setting"
hex = "0102"
writable = true
"""
#: Frames of the monitored messages in a millisecond, and between two requests at least; what idle time is made up for.
EACH_MS, BETWEEN, MOST_MS = 4, 8, 50

DTCS = [bytes(Dtc.parse(dtc_text(k))) for k in range(MESSAGES)] + [b"\xff\xff\xff", b"\xff\xff\x33", b"\x40\0\0"]


class Grammar:
    """Draws requests."""

    def __init__(self, rng):
        self.rng = rng

    def byte(self, *likely):
        return bytes([self.rng.choice(likely) if likely and self.rng.random() < 0.8 else self.rng.randrange(256)])

    def dtc(self):
        return self.rng.choice(DTCS) if self.rng.random() < 0.8 else self.rng.randbytes(3)

    def did(self):
        known = (0x0124, 0xF186, 0xFD10, 0xF40C, 0xF6E1, 0xF802, 0x4000)
        return self.rng.choice(known).to_bytes(2, "big") if self.rng.random() < 0.8 else self.rng.randbytes(2)

    def x19(self):
        kind = self.rng.choice([*range(0x01, 0x0F), *range(0x14, 0x1B), 0x42, 0x55, 0x56])
        tail = {
            0x01: self.byte(), 0x02: self.byte(0x08, 0xFF), 0x04: self.dtc() + self.byte(1, 0xFF), 0x05: self.byte(1),
            0x06: self.dtc() + self.byte(1, 0x20, 0xFF), 0x07: self.byte() + self.byte(), 0x09: self.dtc(),
            0x08: self.byte() + self.byte(), 0x16: self.byte(1, 0x10), 0x17: self.byte(0xFF) + self.byte(1),
            0x18: b"\xdf\x14\x68" + self.byte(1, 0xFF) + self.byte(1), 0x1A: self.byte(1),
            0x19: b"\xdf\x14\x68" + self.byte(1, 0xFF) + self.byte(1), 0x42: b"\x33" + self.byte() + self.byte(),
            0x55: self.byte(0x33), 0x56: self.byte(0x33) + self.byte(3),
        }  # fmt: skip
        return bytes([0x19, kind]) + tail.get(kind, b"")

    def request(self):
        rng = self.rng
        kinds = [
            lambda: b"\x10" + self.byte(1, 3, 3, 0x83),
            lambda: b"\x11" + self.byte(1, 2, 3),
            lambda: b"\x14" + self.dtc(),
            self.x19, self.x19, self.x19,
            lambda: b"\x22" + b"".join(self.did() for _ in range(rng.randrange(1, 9))),
            lambda: b"\x27" + self.byte(1),
            lambda: b"\x27\x02" + rng.randbytes(8),
            lambda: b"\x28" + self.byte(0, 1, 2, 3) + self.byte(1, 3),
            lambda: b"\x2e" + self.did() + rng.randbytes(rng.randrange(4)),
            lambda: b"\x31" + self.byte(1, 3) + b"\x02" + self.byte(1, 2),
            lambda: b"\x3e" + self.byte(0, 0x80),
            lambda: b"\x85" + self.byte(1, 2),
            lambda: b"\x86" + self.byte(1) + self.byte(2) + self.byte(8) + self.x19(),
            lambda: b"\x86" + self.byte(0, 4, 5, 6) + self.byte(2),
            lambda: b"\x01" + self.byte(0, 1, 0x0C) * rng.randrange(1, 8),
            lambda: b"\x02" + self.byte(2, 0x0C) + self.byte(0),
            lambda: self.byte(3, 4, 7, 0x0A),
            lambda: b"\x06" + self.byte(0, 0xE0, 0xE1),
            lambda: b"\x09" + self.byte(0, 2, 4) * rng.randrange(1, 7),
        ]  # fmt: skip
        made = rng.choice(kinds)()
        flaw = rng.random()
        if flaw < 0.05:
            made = made[: rng.randrange(1, len(made) + 1)]
        elif flaw < 0.1:
            made += rng.randbytes(rng.randrange(1, 4))
        return made

    def noise(self):
        """Return frames that only look like a transport's: identifier and bytes."""
        rng = self.rng
        if rng.random() < 0.5:
            data = self.byte(0x10, 0x21, 0x30, 0x31, 0x3F) + rng.randbytes(rng.randrange(8))
            return rng.choice((REQUEST, FUNCTIONAL, 0x7E4)), data
        group = rng.choice((0xEA, 0xEB, 0xEC, 0xEE, 0xE8)) << 16 | rng.choice((0xFF, 0x80)) << 8 | rng.randrange(254)
        body = rng.choice((0xFECA, 0xFED3, 0xFED8, 0xEE00, 0x9E00)).to_bytes(3, "little")
        data = rng.choice(
            (body, bytes([16, 20, 0, 3, 0xFF]) + body, bytes([32, 9, 0, 2, 0xFF]) + body, rng.randbytes(8))
        )
        return 0x98000000 | group | EXTENDED, data


def is_single(request):
    return len(request) <= 7


class Traffic:
    """The monitored messages, and whoever asks, on the rig's bus."""

    def __init__(self, rig, rng, most=25_000):
        self.rig, self.rng = rig, rng
        self.cpu_s = np.zeros(most)  # not a list: what grows is looked at
        self.asked = 0
        self.fed = 0
        self._rounds = {}
        self._monitored_ns = rig.now
        self._seen = 0  # of what was sent

    def monitored(self, failing=()):
        """Feed the messages of 2 ms and of what has passed since the last call, good but for some: 4000 a second."""
        rig = self.rig
        passed = min((rig.now - self._monitored_ns) // MS, MOST_MS)
        key = BETWEEN + EACH_MS * passed, failing
        if key not in self._rounds:
            self._rounds[key] = self._round(*key)
        frames = self._rounds[key].copy()
        frames["t_ns"] += rig.now
        rig.now += BETWEEN // EACH_MS * MS
        self._monitored_ns = rig.now
        self.fed += len(frames)
        return rig._keep([rig.gateway.feed(frames)])

    def _round(self, count, failing):
        frames = empty(count)
        for k in range(count):
            message = k % MESSAGES
            at = (k + 1) * BETWEEN * MS // (EACH_MS * count)
            put(frames, k, at, 256 + message, b"\x01" if message in failing else bytes(8))
        return frames

    def ask(self, request, can_id=REQUEST):
        """Send a request as its frames; returns what was sent with the last one."""
        if is_single(request):
            parts = [bytes([len(request)]) + request]
        else:
            parts = [(0x1000 | len(request)).to_bytes(2, "big") + request[:6]]
            parts += [bytes([0x20 | n & 15]) + request[at : at + 7]
                      for n, at in enumerate(range(6, len(request), 7), start=1)]  # fmt: skip
        begun = time.process_time()
        for part in parts:
            made = self.rig.feed((can_id, part.ljust(8, b"\xcc")))
        self.cpu_s[self.asked] = time.process_time() - begun
        self.asked += 1
        return [data for found, data in made if found in (RESPONSE, 0x7EC)]

    def settle(self):
        """Take what is owed of segmented answers, and let transfers end."""
        for request, response in ((REQUEST, RESPONSE), (0x7E4, 0x7EC)):
            if any(found == response and data[0] >> 4 == 1 for found, data in self.rig.sent[self._seen :]):
                self.rig.feed((request, bytes.fromhex("300000")))
        self.rig.wait(1, step=1)
        self._seen = len(self.rig.sent)

    def forget(self):
        """Forget what was sent by now."""
        self.rig.sent.clear()
        self._seen = 0
