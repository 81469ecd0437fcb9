"""Seeded attackers of all sockets of a gateway: bytes, states and times by chance. bench/attack.py starts them.

    python bench/attackers.py PLACES.json SEED SECONDS

Each kind has a thread and a generator of its own. It prints how many acts of each kind there were, as JSON. All traffic
is on loopback addresses and unix sockets.
"""

from __future__ import annotations

import json
import random
import socket
import ssl
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from gateway.bus.socketcand import extended_frame

#: Longest wait for an answer [s]; connections that one attacker keeps half done.
PATIENCE_S, HELD = 0.2, 24
RESET = struct.pack("ii", 1, 0)
#: Source addresses that they activate; an honest tester has another one.
SOURCES = range(0x0E00, 0x0E08)
ALERTS = [bytes([0x15, 3, 3, 0, 2, level, code]) for level in (1, 2) for code in (0, 10, 40, 80, 90, 100, 255)]
REQUESTS = [
    bytes.fromhex(text)
    for text in (
        "1001", "1003", "1101", "14ffffff", "1901ff", "1902ff", "1904100011ff", "1906100011ff", "190a", "190b", "1914",
        "1915", "194233ffe0", "220124", "22f186", "22f190", "2701", "270200000000", "280001", "280101", "2e01240304",
        "2f", "31010201", "3101ff00", "3e00", "3e80", "8501", "8502", "86010208190208", "29", "0100", "010c", "03",
        "04", "07", "0900", "0902", "0a", "ffff", "00",
    )
]  # fmt: skip
HTTP = [
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /api/history?faults=0&from=0&to=9e99 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /api/recording/P0336-39/1 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /sovd/v1/components HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"GET /sovd/v1/components/gateway/faults?status[key]=x&scope=y HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    b"POST /api/clear HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n{}",
    b'PUT /sovd/v1/components/gateway/modes/session HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{"a":[]}\n',
]
WORDS = [
    "do", "id", "clear", "cycle", "settings", "present", "values", "request", "dtc", "dtcs", "send", "receive", "by",
    "why", "signals", "tester", "ecu", "uds", "self", "P0336-39", "3e00", "22f186", "\ud800", "", "x" * 200,
]  # fmt: skip

Places = dict[str, Any]
#: Mistakes of the attackers themselves.
FAILED: list[str] = []


def message(kind: int, body: bytes = b"", length: int | None = None) -> bytes:
    """Return a DoIP message."""
    return struct.pack(">BBHI", 3, 0xFC, kind, len(body) if length is None else length) + body


def bent(rng: random.Random, data: bytes) -> bytes:
    """Return bytes with some changed, cut off, doubled, put in."""
    made = bytearray(data)
    for _ in range(rng.randrange(4)):
        what, at = rng.randrange(5), rng.randrange(len(made) + 1)
        if what == 0 and made:
            made[at % len(made)] = rng.randrange(256)
        elif what == 1 and made:
            made[at % len(made)] ^= 1 << rng.randrange(8)
        elif what == 2:
            del made[at:]
        elif what == 3:
            made[at:at] = rng.randbytes(rng.randrange(1, 9))
        else:
            made += made[at:]
    return bytes(made[: 1 << 16])


def value(rng: random.Random, depth: int = 0) -> Any:
    """Return any value of JSON."""
    kind = rng.randrange(8 if depth < 3 else 6)
    if kind < 3:
        return rng.choice(WORDS)
    if kind < 6:
        return rng.choice([None, True, False, 0, -1, 1e308, float("nan"), 10**40, 7])
    if kind == 6:
        return [value(rng, depth + 1) for _ in range(rng.randrange(4))]
    return {rng.choice(WORDS): value(rng, depth + 1) for _ in range(rng.randrange(4))}


class Held:
    """Connections that are left as they are for a while: half a message, nothing read, a byte now and then."""

    def __init__(self, rng: random.Random) -> None:
        self._rng, self._held = rng, []

    def leave(self, made: socket.socket) -> None:
        """Keep one, and end or touch another."""
        self._held.append(made)
        if len(self._held) > HELD:
            end(self._rng, self._held.pop(self._rng.randrange(len(self._held))))
        with suppress(OSError):
            self._rng.choice(self._held).send(self._rng.randbytes(self._rng.randrange(1, 30)))


def end(rng: random.Random, made: socket.socket) -> None:
    """End a connection by a close, half a close, or a reset."""
    with suppress(OSError):
        how = rng.randrange(3)
        if how == 0:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        elif how == 1:
            made.shutdown(socket.SHUT_WR)
            made.recv(1 << 16)
    made.close()


def connected(port: int) -> socket.socket:
    """Return a connection to a port of this machine."""
    made = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return made


def at_unix(path: str, kind: int = socket.SOCK_STREAM) -> socket.socket:
    """Return a connection to a unix socket."""
    made = socket.socket(socket.AF_UNIX, kind)
    made.settimeout(PATIENCE_S)
    made.connect(path)
    return made


def talk(rng: random.Random) -> bytes:
    """Return some messages of a tester by DoIP, most of them bent."""
    source = rng.choice(SOURCES)
    made = [message(5, struct.pack(">HBI", source, 0, 0))] if rng.random() < 0.7 else []
    for _ in range(rng.randrange(6)):
        target = rng.choice([0x1000, 0xE400, 0x2000])
        made.append(message(0x8001, struct.pack(">HH", source, target) + bent(rng, rng.choice(REQUESTS))))
    if rng.random() < 0.2:
        made.append(message(rng.choice([0x8001, 5, 7, 8, 0x4001]), b"", rng.choice([0, 1, 65535, 1 << 31, 0xFFFFFFFF])))
    data = b"".join(made)
    return data if rng.random() < 0.3 else bent(rng, data)


def doip(rng: random.Random, places: Places, held: Held) -> None:
    """One connection by TCP."""
    made = connected(places["doip"])
    for _ in range(rng.randrange(1, 4)):
        made.sendall(talk(rng))
        if rng.random() < 0.3:
            time.sleep(rng.random() * 0.02)
        if rng.random() < 0.5:
            with suppress(TimeoutError):
                made.recv(1 << 16)
    held.leave(made) if rng.random() < 0.4 else end(rng, made)


def tls(rng: random.Random, places: Places, held: Held) -> None:
    """One connection by TLS, which goes wrong in one of its states."""
    made = connected(places["tls"])
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if rng.random() < 0.3:
        context.maximum_version = ssl.TLSVersion.TLSv1_2
    incoming, out = ssl.MemoryBIO(), ssl.MemoryBIO()
    stream = context.wrap_bio(incoming, out)
    steps, wrong = rng.randrange(6), [*ALERTS, HTTP[0], b"\x17\x03\x03\x00\x05hello", rng.randbytes(40)]
    over = False
    for _ in range(steps):
        try:
            stream.do_handshake()
            over = True
        except ssl.SSLWantReadError:
            pass
        data = out.read()
        made.sendall(bent(rng, data) if rng.random() < 0.1 else data)
        if over:
            break
        incoming.write(made.recv(1 << 16))
    if over and rng.random() < 0.8:
        stream.write(talk(rng) or b"x")
        data = out.read()
        made.sendall(bent(rng, data) if rng.random() < 0.3 else data)
        if rng.random() < 0.3:
            with suppress(ssl.SSLError):
                stream.unwrap()
            made.sendall(out.read())
    if rng.random() < 0.5:
        made.sendall(rng.choice(wrong))
    held.leave(made) if rng.random() < 0.5 else end(rng, made)


def udp(rng: random.Random, places: Places, _: Held) -> None:
    """Some datagrams."""
    kinds = [0, 1, 2, 3, 4, 5, 7, 0x4001, 0x4003, 0x8001]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        for _ in range(rng.randrange(1, 30)):
            body = rng.randbytes(rng.choice([0, 1, 6, 17, 33]))
            made.sendto(bent(rng, message(rng.choice(kinds), body))[:2000], ("127.0.0.1", places["doip"]))


def status(rng: random.Random, places: Places, held: Held) -> None:
    """One reader of the status socket, which asks for nonsense."""
    made = at_unix(places["status"])
    for _ in range(rng.randrange(1, 12)):
        if rng.random() < 0.8:
            do = rng.choice(["clear", "settings", "present", "values", "request", "cycle", value(rng)])
            asked = {"id": value(rng), "do": do} | {rng.choice(WORDS): value(rng) for _ in range(rng.randrange(4))}
            data = json.dumps(asked).encode()
        else:
            data = rng.choice([b"[" * 5000, b"{", b"", b"null", rng.randbytes(60), b'{"do":"present"}'])
        made.sendall((data if rng.random() < 0.8 else bent(rng, data)) + b"\n")
        time.sleep(rng.random() * 0.01)
    held.leave(made) if rng.random() < 0.3 else end(rng, made)


def report(rng: random.Random, places: Places, held: Held) -> None:
    """One process that reports nonsense."""
    made = at_unix(places["report"], socket.SOCK_SEQPACKET)
    for _ in range(rng.randrange(1, 20)):
        asked = {
            "fault": rng.choice(["mine.hot", "mine.none", value(rng)]),
            "result": rng.choice(["passed", value(rng)]),
        }
        asked |= {rng.choice(["data", "id", "goodbye", "x"]): value(rng) for _ in range(rng.randrange(3))}
        data = json.dumps(asked).encode()
        made.send((data if rng.random() < 0.7 else bent(rng, data))[:5000] or b"x")
    held.leave(made) if rng.random() < 0.3 else end(rng, made)


def bus(rng: random.Random, places: Places, held: Held) -> None:
    """Frames of testers and of nobody, and nonsense for the hub."""
    made = connected(places["hub"])
    made.sendall(b"< open can0 >< xmode >< rawmode >")
    frames = []
    for _ in range(rng.randrange(1, 150)):
        can_id = rng.choice([0x7E0, 0x7DF, 0x100, 0x100, rng.randrange(0x600), 0x98EAFF00 | rng.randrange(256)])
        request = bent(rng, rng.choice(REQUESTS))
        first = rng.choice([bytes([len(request) & 7]), b"\x10\x14", b"\x21", b"\x30\x00", rng.randbytes(1), b""])
        frames.append(extended_frame((0, can_id, 0, (first + request)[:8]), stamped=False))
    data = b"".join(frames)
    made.sendall(data if rng.random() < 0.8 else bent(rng, data))
    held.leave(made) if rng.random() < 0.2 else end(rng, made)


def http(rng: random.Random, places: Places, held: Held) -> None:
    """Requests to the page and to SOVD."""
    made = connected(places["page"])
    for _ in range(rng.randrange(1, 4)):
        data = rng.choice(HTTP)
        if rng.random() < 0.3:
            path = rng.choice([b"/sovd/v1/", b"/api/", b"/"]) + json.dumps(value(rng)).encode()[:60]
            data = b"GET " + path.replace(b" ", b"%20") + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        if rng.random() < 0.2:
            body = json.dumps(value(rng)).encode()
            head = f"Authorization: Bearer {places['token']}\r\nContent-Length: {len(body)}\r\n"
            first = f"POST /api/{rng.choice(['clear', 'settings', 'present'])} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            data = f"{first}Content-Type: application/json\r\n{head}\r\n".encode() + body
        made.sendall(data if rng.random() < 0.6 else bent(rng, data))
        if rng.random() < 0.5:
            with suppress(TimeoutError):
                made.recv(1 << 16)
    held.leave(made) if rng.random() < 0.2 else end(rng, made)


#: Kinds, and acts a second of each.
KINDS: dict[str, tuple[Callable[[random.Random, Places, Held], None], float]] = {
    "doip": (doip, 30.0), "tls": (tls, 20.0), "udp": (udp, 20.0), "status": (status, 10.0), "report": (report, 10.0),
    "bus": (bus, 10.0), "http": (http, 8.0),
}  # fmt: skip


def work(kind: str, places: Places, seed: int, until: float, acts: dict[str, int]) -> None:
    """Attack until the time is over."""
    rng = random.Random(f"{seed} {kind}")
    held, (act, rate) = Held(rng), KINDS[kind]
    while time.monotonic() < until:
        try:
            act(rng, places, held)
        except OSError:
            pass  # ended by the gateway, as most are
        except Exception as error:
            FAILED.append(f"{kind}: {error!r}")
            raise
        acts[kind] += 1
        time.sleep(min(rng.expovariate(rate), 1.0))


def main() -> None:
    """Have all kinds attack."""
    places, seed, seconds = json.loads(Path(sys.argv[1]).read_text()), int(sys.argv[2]), float(sys.argv[3])
    acts = dict.fromkeys(KINDS, 0)
    until = time.monotonic() + seconds
    threads = [threading.Thread(target=work, args=(kind, places, seed, until, acts)) for kind in KINDS]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    print(json.dumps(acts))
    sys.exit(1 if FAILED else 0)


if __name__ == "__main__":
    main()
