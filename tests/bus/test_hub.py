"""The bus between processes: python-can's own socketcand client is the oracle."""

import multiprocessing
import random
import resource
import select
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path

import can
import numpy as np
import pytest

from gateway.bus.frames import BRS, ERROR, EXTENDED, FD, REMOTE, empty, payload, put
from gateway.bus.loopback import LoopbackBus
from gateway.bus.uri import open_bus
from gateway_bench.hub import QUEUE, Hub
from gateway_fdi.errors import BusError


@pytest.fixture
def hub():
    made = Hub("127.0.0.1", 0)
    stop = threading.Event()
    thread = threading.Thread(target=made.serve_forever, args=(stop.is_set,))
    thread.start()
    yield made
    stop.set()
    thread.join()
    made.close()


def join(hub, index=0, name="can0"):
    return LoopbackBus("loopback:test", index, hub.address, name)


def python_can(hub, name="can0"):
    host, port = hub.address
    return can.Bus(interface="socketcand", host=host, port=port, channel=name)


def take(bus, count, timeout=120.0):
    out = empty(count)
    got = 0
    limit = time.monotonic() + timeout
    while got < count and time.monotonic() < limit:
        if select.select([bus.fileno()], [], [], 0.2)[0] or got:
            got += bus.receive(out[got:])
    return out[:got]


def frames_of(*rows):
    frames = empty(len(rows))
    for k, (can_id, body, flags) in enumerate(rows):
        put(frames, k, 0, can_id, body, flags=flags)
    return frames


def test_python_can_sends_and_receives(hub):
    with python_can(hub) as theirs, join(hub, index=3) as ours:
        theirs.send(can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False))
        theirs.send(can.Message(arbitration_id=0x18FECA00, data=bytes(8), is_extended_id=True))
        got = take(ours, 2)
        assert got["can_id"].tolist() == [0x123, 0x18FECA00 | EXTENDED]
        assert got["bus"].tolist() == [3, 3]
        assert payload(got[0]) == b"\x01\x02"
        assert abs(int(got[0]["t_ns"]) - time.time_ns()) < 10 * 10**9
        ours.send(frames_of((0x7E8, b"\x03\x59", 0), (0x1ABCDEF | EXTENDED, b"", 0)))
        first, second = theirs.recv(5), theirs.recv(5)
        assert (first.arbitration_id, bytes(first.data), first.is_extended_id) == (
            0x7E8,
            b"\x03\x59",
            False,
        )
        assert (second.arbitration_id, second.is_extended_id) == (0x1ABCDEF, True)
        assert abs(first.timestamp - time.time()) < 10


def test_frames_go_to_all_others_on_the_same_bus_and_not_back(hub):
    with join(hub) as a, join(hub) as b, join(hub) as c, join(hub, name="other") as d:
        a.send(frames_of((1, b"x", 0)))
        assert len(take(b, 1)) == len(take(c, 1)) == 1
        assert len(take(a, 1, 0.2)) == len(take(d, 1, 0.2)) == 0


def test_fd_remote_and_error_frames_pass_between_our_clients_only(hub):
    sent = frames_of(
        (0x123, bytes(range(64)), FD | BRS),
        (0x12345678 | EXTENDED, b"\x11" * 48, FD),
        (0x321 | REMOTE, b"", 0),
        (0x40 | ERROR, bytes(8), 0),
        (0x100, b"plain", 0),
    )
    with join(hub) as a, join(hub) as b, python_can(hub) as theirs:
        a.send(sent)
        got = take(b, 5)
        for name in ("can_id", "flags", "length"):
            assert got[name].tolist() == sent[name].tolist()
        np.testing.assert_array_equal(got["data"], sent["data"])
        message = theirs.recv(5)
        assert (message.arbitration_id, bytes(message.data)) == (0x100, b"plain")
        assert theirs.recv(0.1) is None
    assert hub.statistics.inexpressible == 4


def test_the_hub_stamps_with_its_clock():
    hub = Hub("127.0.0.1", 0, clock_ns=lambda: 1_234_567_890_123_456_789)
    stop = threading.Event()
    thread = threading.Thread(target=hub.serve_forever, args=(stop.is_set,))
    thread.start()
    try:
        with join(hub) as a, join(hub) as b:
            a.send(frames_of((1, b"", 0)))
            assert take(b, 1)["t_ns"].tolist() == [1_234_567_890_123_456_789]
    finally:
        stop.set()
        thread.join()
        hub.close()


def _flood(address, count):
    with LoopbackBus("loopback:flood", 0, address) as bus:
        frames = empty(count)
        for k in range(count):
            put(frames, k, 0, k % 2048, k.to_bytes(4, "little"))
        for part in np.split(frames, 20):
            bus.send(part)


@pytest.mark.long
def test_many_frames_between_processes_keep_their_order(hub):
    count = 10_000
    with join(hub) as ours:
        process = multiprocessing.get_context("spawn").Process(target=_flood, args=(hub.address, count))
        process.start()
        got = take(ours, count, 60)
        process.join(20)
    assert len(got) == count
    numbers = np.ascontiguousarray(got["data"][:, :4]).view("<u4").ravel()
    assert numbers.tolist() == list(range(count))
    assert (np.diff(got["t_ns"]) >= 0).all()


@pytest.mark.evidence("Bounded: hub")
def test_a_client_that_does_not_read_loses_its_oldest_and_holds_up_nobody(hub):
    deaf = socket.create_connection(hub.address)
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    for said in (b"< open can0 >", b"< rawmode >"):
        deaf.recv(64)
        deaf.sendall(said)
    deaf.recv(64)
    total = QUEUE * 3
    with join(hub) as a, join(hub) as b:
        body = frames_of(*[(1, bytes(8), 0)] * 500)
        got = 0
        for _ in range(total // 500):
            a.send(body)
            got += len(take(b, 500, 20))
        assert got == total
    assert hub.statistics.dropped > 0
    deaf.close()


def test_malformed_input_is_answered_counted_and_harmless(hub):
    rng = random.Random(23)
    print("seed 23")
    bad = socket.create_connection(hub.address)
    bad.settimeout(120)
    good = [b"< open can0 >", b"< rawmode >", b"< send 123 2 11 22 >", b"< x 00000123 - 0 11 >"]
    with join(hub) as ours:
        for k in range(3000):
            line = bytearray(rng.choice(good))
            for _ in range(rng.randrange(4)):
                line[rng.randrange(len(line))] = rng.randrange(256)
            bad.sendall(bytes(line))
            if k % 50 == 0:
                bad.sendall(b"x" * 2000)
                bad.setblocking(False)
                try:
                    while bad.recv(65536):
                        pass
                except BlockingIOError:
                    pass
                bad.setblocking(True)
        # A close with answers unread is a reset, after which the hub never sees what it has not read yet.
        bad.shutdown(socket.SHUT_WR)
        while bad.recv(65536):
            pass
        bad.close()
        for line in (
            b"< send 123 9 0 0 0 0 0 0 0 0 0 >",
            b"< send 8FF 0 >",
            b"< send 123 2 1 >",
            b"< >",
            b"junk >",
        ):
            other = socket.create_connection(hub.address)
            other.settimeout(120)
            assert other.recv(64) == b"< hi >"
            other.sendall(b"< open can0 >")
            assert other.recv(64) == b"< ok >"
            other.sendall(line)
            assert other.recv(64).startswith(b"< error"), line
            other.sendall(b"< echo >")
            assert other.recv(64).startswith((b"< echo", b"< error"))
            other.close()
        with join(hub) as a:
            a.send(frames_of((0x7AB, b"ok", 0)))
            got = empty(0)
            limit = time.monotonic() + 120
            while not len(got) and time.monotonic() < limit:
                # Room for all that may be waiting: what is left inside no descriptor tells of.
                part = take(ours, 4096, 0.5)
                got = part[part["can_id"] == 0x7AB]
            assert len(got) == 1
    # How many there are depends on how the garbage is cut into readings.
    assert hub.statistics.rejected > 100


def test_the_end_of_the_hub_is_a_clear_error():
    hub = Hub("127.0.0.1", 0)
    stop = threading.Event()
    thread = threading.Thread(target=hub.serve_forever, args=(stop.is_set,))
    thread.start()
    bus = join(hub)
    stop.set()
    thread.join()
    hub.close()
    with pytest.raises(BusError, match="the bus is gone"):
        for _ in range(100):
            bus.receive(empty(1))
            time.sleep(0.01)
    bus.close()


def test_no_hub_is_a_clear_error():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(BusError, match="start one: gateway bus"):
        open_bus(f"loopback:127.0.0.1:{port}", patience_s=0.1)


def test_a_taken_address_is_a_clear_error(hub):
    with pytest.raises(BusError, match="in use"):
        Hub(*hub.address)


@pytest.fixture
def few_descriptors():
    """So few that a hub meets its limit with a handful of clients."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(list(Path("/proc/self/fd").iterdir()))
    yield lambda more: resource.setrlimit(resource.RLIMIT_NOFILE, (used + more, before[1]))
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_hub_without_descriptors_refuses_and_goes_on(few_descriptors):
    """Whoever comes too many is sent away; the others are served, and room that comes is used."""
    hub = Hub("127.0.0.1", 0)
    clients = [socket.socket() for _ in range(12)]  # before the limit: they are this process's, too
    few_descriptors(12 + 6)
    try:
        for client in clients:
            client.connect(hub.address)
        for _ in range(60):
            hub.serve_once(0.01)
        assert hub.statistics.refused > 0
        refused = hub.statistics.refused
        for _ in range(20):
            hub.serve_once(0.0)
        assert hub.statistics.refused == refused, "nobody waits, so that the loop is not kept busy"
        served = [client for client in clients if answered(client, hub)]
        assert 0 < len(served) == 12 - refused
        for client in served:
            client.close()
        for _ in range(20):
            hub.serve_once(0.01)
        clients.append(socket.create_connection(hub.address))
        assert answered(clients[-1], hub)
    finally:
        for client in clients:
            client.close()
        hub.close()


def answered(client, hub):
    """Whether a client gets the answer to an echo."""
    client.settimeout(0.5)
    try:
        client.sendall(b"< echo >")
        text = b""
        for _ in range(50):
            hub.serve_once(0.01)
            with suppress(TimeoutError):
                client.settimeout(0.01)
                got = client.recv(100)
                if not got:
                    return False
                text += got
            if b"echo" in text:
                return True
    except OSError:
        return False
    return False


def test_answers_that_nobody_reads_are_bounded():
    """A client that asks and never reads loses its oldest answers, and costs no more memory than frames do."""
    hub = Hub("127.0.0.1", 0)
    with socket.create_connection(hub.address) as client:
        client.setblocking(False)
        asked = 0
        while asked < 40 * QUEUE and hub.statistics.dropped < 1000:
            with suppress(BlockingIOError):
                asked += client.send(b"< echo >" * 5000) // 8
            hub.serve_once(0.0)
            assert all(len(one.waiting) <= QUEUE for one in hub._clients)
        assert hub.statistics.dropped >= 1000
    hub.close()
