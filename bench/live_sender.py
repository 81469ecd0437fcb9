"""The sender of bench/live.py: frames at a rate, some with a wrong CRC, and the times to their DTC frames."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence

import crccheck

MESSAGES = 16
BASE = 0x300
DTC_ID = 0x6F0
EVERY_S = 0.02


def datagrams() -> list[bytes]:
    """Return 256 rounds of all messages, as ``struct can_frame``, and the same with a wrong CRC."""
    found = []
    for count in range(256):
        for k in range(MESSAGES):
            body = bytes([count]) + (1200 + count).to_bytes(2, "little") + bytes([k, 1, 2, 3])
            crc = crccheck.crc.Crc8SaeJ1850.calc(body + k.to_bytes(2, "little"))
            found.append((BASE + k).to_bytes(4, "little") + bytes([8, 0, 0, 0]) + bytes([crc]) + body)
    return found


def spoilt(datagram: bytes) -> bytes:
    """Return a frame with a wrong CRC."""
    return datagram[:8] + bytes([datagram[8] ^ 0xFF]) + datagram[9:]


def told_at(sock: socket.socket, message: int) -> float:
    """Read what has come; returns when a change of a message's DTC was among it, 0.0: it was not."""
    told = 0.0
    try:
        while True:
            got = sock.recv(72)
            # A change (index 0) of this message's DTC: bits 8 to 15 of the DTC are the message.
            if got[0] == DTC_ID & 0xFF and got[9] == message and got[13] == 0:
                told = time.perf_counter()
    except BlockingIOError:
        return told


def send_at(
    sock: socket.socket,
    rate: float,
    seconds: float,
    frames: list[bytes],
    more: Sequence[socket.socket] = (),
    every_s: float = EVERY_S,
    rest_s: float = 0.0,
) -> dict:
    """Send frames at a rate; returns how many, how many found the queue full, and the times to DTC frames [ms].

    The message k goes to the socket k of all, modulo their number; DTC frames come from the first. With ``rest_s`` it
    sleeps between two looks [s].
    """
    socks = [sock, *more]
    for each in socks:
        each.setblocking(False)
    begun = time.perf_counter()
    sent = full = 0
    next_wrong, asked, waiting = every_s, 0.0, -1  # message whose DTC is waited for
    times, spans = [], []

    def look() -> None:
        nonlocal waiting
        if (told := told_at(sock, waiting)) and waiting >= 0:
            times.append((told - asked) * 1e3)
            spans.append((asked, told))
            waiting = -1

    while (now := time.perf_counter() - begun) < seconds:
        if rest_s:
            time.sleep(rest_s)
        due = int(now * rate)
        while sent < due:
            datagram = frames[sent % len(frames)]
            wrong = now >= next_wrong and waiting < 0
            if wrong:
                datagram = spoilt(datagram)
                asked, waiting = time.perf_counter(), datagram[0] & 0x0F
                next_wrong = now + every_s
            try:
                socks[(datagram[0] & 0x0F) % len(socks)].send(datagram)
            except BlockingIOError:
                full += 1
            except OSError as error:
                if error.errno != 105:  # ENOBUFS
                    raise
                full += 1
            sent += 1
            if waiting >= 0:
                look()
        look()  # also where nothing is waited for: a queue that nobody reads gets full
        if waiting >= 0 and time.perf_counter() - asked > 1.0:
            times.append(1e3)
            waiting = -1
    return {"sent": sent, "full": full, "times": times, "spans": spans}
