"""Every kind of bus is held to the same cases; a driver that misbehaves is no lost bus, unless it does nothing else."""

import threading
import time
import uuid

import pytest
from bus_cases import PATIENCE_S, BadDriver, BusCases, Wire, frame, raising, received

from gateway.bus import adapter
from gateway.bus.adapter import PythonCanBus
from gateway.bus.base import send_all
from gateway.bus.frames import FD
from gateway.bus.uri import open_bus
from gateway_bench.hub import Hub
from gateway_fdi.errors import BusError


class TestVirtual(BusCases):
    @pytest.fixture
    def ends(self):
        name = f"virtual:{uuid.uuid4().hex}"
        with open_bus(name, 3) as ours, open_bus(name, 4) as theirs:
            yield ours, theirs


class TestLoopback(BusCases):
    @pytest.fixture
    def ends(self):
        hub, stop = Hub("127.0.0.1", 0), threading.Event()
        thread = threading.Thread(target=hub.serve_forever, args=(stop.is_set,))
        thread.start()
        uri = f"loopback:127.0.0.1:{hub.address[1]}"
        with open_bus(uri, 3) as ours, open_bus(uri, 4) as theirs:
            yield ours, theirs
        stop.set()
        thread.join()
        hub.close()


def pair(**how):
    wire = Wire()
    ours = PythonCanBus("bad:x", 3, BadDriver(wire, **how))
    return ours, PythonCanBus("bad:y", 4, BadDriver(wire))


class TestRaising(BusCases):
    """Reading raises once in 7 calls, sending once in 3."""

    @pytest.fixture
    def ends(self):
        ours, theirs = pair(raises_every=7, full_every=3)
        with ours, theirs:
            yield ours, theirs


def test_exceptions_are_counted_and_no_frame_is_lost():
    ours, theirs = pair(raises_every=7, full_every=3)
    with ours, theirs:
        for k in range(100):
            send_all(theirs, frame(k), patience_s=PATIENCE_S)
        assert received(ours, 100)["can_id"].tolist() == list(range(100))
        send_all(ours, frame(0x77), patience_s=PATIENCE_S)
        assert ours.statistics.driver_errors > 10


def test_messages_that_are_no_frames_are_counted():
    ours, theirs = pair(garbles=True)
    with ours, theirs:
        send_all(theirs, frame(0x1), patience_s=PATIENCE_S)
        assert received(ours, 1)["can_id"].tolist() == [0x1]
        assert ours.statistics.rejected == 1
        assert ours.send(frame(0x2, bytes(12), FD)) == 1, "taken: this driver can never carry it"
        assert (ours.statistics.refused, ours.statistics.sent) == (1, 0)


def test_a_full_buffer_waits_and_a_bus_that_hears_is_not_lost(monkeypatch):
    monkeypatch.setattr(adapter, "GIVE_UP_S", 0.05)
    ours, theirs = pair(full_every=1)
    with ours, theirs:
        limit = time.monotonic() + 0.3
        while time.monotonic() < limit:
            send_all(theirs, frame(0x1), patience_s=PATIENCE_S)
            received(ours, 1)
            assert ours.send(frame(0x2)) == 0
        assert ours.statistics.sent == 0
        assert ours.statistics.driver_errors > 1


def test_a_driver_that_does_nothing_but_raise_is_a_lost_bus(monkeypatch):
    monkeypatch.setattr(adapter, "GIVE_UP_S", 0.05)
    ours, theirs = pair(raises_every=1)
    with ours, theirs:
        error = raising(ours)
        assert isinstance(error, BusError)
        assert "could not read an integer" in str(error)
        assert ours.statistics.driver_errors > 1, "it was tried again before"


def test_a_bus_that_takes_and_gives_nothing_is_lost(monkeypatch):
    monkeypatch.setattr(adapter, "GIVE_UP_S", 0.05)
    ours, theirs = pair(full_every=1)
    with ours, theirs, pytest.raises(BusError, match="sending failed"):
        send_all(ours, frame(0x1), patience_s=PATIENCE_S)


def test_an_echo_without_a_mark_comes_as_a_frame():
    ours, theirs = pair(echoes=True)
    with ours, theirs:
        send_all(ours, frame(0x5), patience_s=PATIENCE_S)
        assert received(ours, 1)["can_id"].tolist() == [0x5]
