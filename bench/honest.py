"""Honest clients of a gateway that is attacked (bench/attack.py): each asks again and again, and wants its answer."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from attackers import message

from gateway.bus.frames import empty, payload, put
from gateway.bus.uri import open_bus

#: An answer later than this is none [s].
PATIENCE_S = 5.0


class Honest(threading.Thread):
    """One honest client: it asks again and again, and each request is to be answered.

    Args:
        name: for people.
        connect: returns what asks once, and whatever closes the connection.
        every_s: time between two requests.
        stop: ends it.
        timed: whether its times are those of a tester on a bus.
    """

    def __init__(self, name: str, connect: Callable[[], Any], every_s: float, *, timed: bool = False) -> None:
        super().__init__(name=name, daemon=True)
        self._connect, self._every_s, self.timed = connect, every_s, timed
        self.stop, self.times_s, self.failures = threading.Event(), [], []
        self.rests = threading.Event()

    def run(self) -> None:
        """Ask until told to stop; a connection that failed is made again, and the failure is noted."""
        while not self.stop.is_set():
            try:
                with contextlib.closing(self._connect()) as asking:
                    for _ in asking:
                        if self.stop.is_set() or self.rests.is_set():
                            return
                        begun = time.perf_counter()
                        next(asking)
                        self.times_s.append(time.perf_counter() - begun)
                        self.stop.wait(self._every_s)
            except Exception as error:  # the failure is the result
                if not self.stop.is_set():
                    self.failures.append(f"{time.strftime('%X')} {error!r}")
                    self.stop.wait(0.5)


def received(made: socket.socket, source: int, answer: bytes) -> None:
    """Read messages of DoIP until an answer; alive checks are answered."""
    data = b""
    while True:
        while len(data) >= 8 and len(data) >= 8 + struct.unpack(">I", data[4:8])[0]:
            size = 8 + struct.unpack(">I", data[4:8])[0]
            kind, body, data = data[2:4], data[8:size], data[size:]
            if kind == b"\x00\x07":
                made.sendall(message(8, source.to_bytes(2, "big")))
            elif body.endswith(answer) and kind in (b"\x80\x01", b"\x00\x06"):
                return
        more = made.recv(1 << 16)
        if not more:
            raise ConnectionError("closed")
        data += more


def tester(port: int, source: int, context: ssl.SSLContext | None) -> Iterator[None]:
    """A tester by DoIP: each second step asks and is answered."""
    # From an address of its own, as on any network: an address that floods the door displaces its own connections.
    with socket.create_connection(("127.0.0.1", port), PATIENCE_S, ("127.0.0.2", 0)) as plain:
        plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        made = plain if context is None else context.wrap_socket(plain)
        made.sendall(message(5, struct.pack(">HBI", source, 0, 0)))
        received(made, source, b"\x10" + bytes(4))
        while True:
            yield
            made.sendall(message(0x8001, struct.pack(">HH", source, 0x1000) + b"\x3e\x00"))
            received(made, source, b"\x7e\x00")
            yield


def on_the_bus(uri: str) -> Iterator[None]:
    """A tester on the bus, at an address of its own."""
    with open_bus(uri) as bus:
        batch, asked = empty(256), empty(1)
        put(asked, 0, 0, 0x7E2, b"\x02\x3e\x00".ljust(8, b"\xcc"))
        while True:
            yield
            bus.send(asked)
            limit = time.monotonic() + PATIENCE_S
            while True:
                count = bus.receive(batch)
                if any(int(f["can_id"]) == 0x7EA and payload(f)[:3] == b"\x02\x7e\x00" for f in batch[:count]):
                    break
                if time.monotonic() > limit:
                    raise TimeoutError("no answer on the bus")
                if not count:
                    time.sleep(0.0005)
            yield


def reader(path: str, seen: dict[str, Any]) -> Iterator[None]:
    """A reader of the status socket; ``seen`` gets what the gateway counts."""
    with socket.socket(socket.AF_UNIX) as made:
        made.settimeout(PATIENCE_S)
        made.connect(path)
        stream, number = made.makefile("rb"), 0
        while True:
            yield
            number += 1
            made.sendall(json.dumps({"id": number, "do": "present"}).encode() + b"\n")
            while True:
                told = json.loads(stream.readline() or "null")
                if told is None:
                    raise ConnectionError("sent away")
                stream.read(told.get("size", 0))
                if told["kind"] == "buses":
                    seen["exceptions"], seen["counters"] = told["exceptions"], told["counters"]
                if told["kind"] == "answer" and told["id"] == number:
                    break
            yield


def reporter(path: str) -> Iterator[None]:
    """A process that reports."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as made:
        made.settimeout(PATIENCE_S)
        made.connect(path)
        while True:
            yield
            made.send(b'{"fault": "mine.honest", "result": "passed"}')
            told = json.loads(made.recv(4096))
            if not told["ok"] and told["refused"] not in ("rate", "monitoring_off", "not_enabled"):
                raise AssertionError(told)
            yield


def browser(port: int, paths: list[str]) -> Iterator[None]:
    """A client of the page or of SOVD."""
    while True:
        for path in paths:
            yield
            made = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
            made.request("GET", path)
            answer = made.getresponse()
            answer.read()
            made.close()
            if answer.status != 200:
                raise AssertionError(f"{path}: {answer.status}")
            yield
