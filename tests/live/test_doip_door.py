"""DoIP in the daemon: beside the buses, over a reload, with another port, and gone with its table."""

import socket
import struct

import pytest
from daemon_rig import World
from doip_rig import GATEWAY, TESTER, cut, message
from doip_wire import free_port
from rig import write_config

DOIP = '[output.uds]\n[output.doip]\nport = {port}\nbind = ["127.0.0.1"]\n{more}'
ACTIVATE = message(5, struct.pack(">HBI", TESTER, 0, 0))


def uds(request):
    return message(0x8001, struct.pack(">HH", TESTER, GATEWAY) + bytes.fromhex(request))


class Bench:
    """A daemon, and a tester."""

    def __init__(self, folder):
        self.folder, self.world, self.port = folder, World(), free_port()
        self.write()
        self.daemon = self.world.daemon(self.config, folder / "faults.sqlite")

    def write(self, more="", text=None):
        text = DOIP.format(port=self.port, more=more) if text is None else text
        self.config = write_config(self.folder, extra=text)

    def connect(self):
        made = socket.create_connection(("127.0.0.1", self.port))
        made.setblocking(False)
        return made

    def ask(self, made, data):
        """Send; returns what comes, as the last bytes of each message. None: the end."""
        made.sendall(data)
        self.got = b""
        for _ in range(4):
            yield from self.world.wait(0.005)
        try:
            self.got = made.recv(1 << 20)
        except BlockingIOError:
            return []
        return [body[4:].hex() for _, _, body in cut(self.got)] or [None]

    def reload(self, **more):
        self.write(**more)
        self.daemon.reloader.request()
        known = len(self.world.told("config"))
        while len(self.world.told("config")) == known:
            yield from self.world.wait(0.01)
            thread = self.daemon.reloader._thread
            if thread is not None:
                thread.join()
        yield from self.world.wait(0.01)


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.daemon.close()


def test_a_tester_keeps_its_connection_over_a_reload_and_finds_the_default_session(bench):
    def script():
        yield from bench.world.wait(0.05)
        one = bench.connect()
        assert (yield from bench.ask(one, ACTIVATE))
        assert (yield from bench.ask(one, uds("1003")))[1].startswith("5003")
        assert (yield from bench.ask(one, uds("8502")))[1] == "c502"
        yield from bench.reload()
        assert [event["state"] for event in bench.world.told("config")] == ["reloaded"]
        assert (yield from bench.ask(one, uds("22f186")))[1] == "62f18601"
        assert bench.daemon.gateway.controls.monitoring
        found = [each.action for each in bench.daemon.gateway.memory.interventions()]
        assert found == ["dtc_setting", "dtc_setting_ended"]

    bench.world.play(bench.daemon, script())


def test_other_settings_end_the_connections_and_another_port_is_listened_at(bench):
    def script():
        yield from bench.world.wait(0.05)
        one = bench.connect()
        yield from bench.ask(one, ACTIVATE)
        yield from bench.reload(more="functional = 0xE401\n")
        assert (yield from bench.ask(one, b"")) == [None]
        two = bench.connect()
        assert (yield from bench.ask(two, ACTIVATE))
        old, bench.port = bench.port, free_port()
        yield from bench.reload()
        assert (yield from bench.ask(two, b"")) == [None]
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", old))
        three = bench.connect()
        assert (yield from bench.ask(three, ACTIVATE))
        yield from bench.reload(text="[output.uds]\n")
        assert (yield from bench.ask(three, b"")) == [None]
        yield from bench.reload()
        four = bench.connect()
        assert (yield from bench.ask(four, ACTIVATE))
        assert [event["state"] for event in bench.world.told("config")] == ["reloaded"] * 4

    bench.world.play(bench.daemon, script())


def test_a_port_that_is_taken_leaves_the_old_configuration(bench):
    def script():
        yield from bench.world.wait(0.05)
        one = bench.connect()
        yield from bench.ask(one, ACTIVATE)
        with socket.create_server(("127.0.0.1", 0)) as taken:
            before, bench.port = bench.port, taken.getsockname()[1]
            yield from bench.reload()
        (told,) = bench.world.told("config")
        assert told["state"] == "refused"
        assert "output.doip.port" in told["reason"]
        bench.port = before
        assert (yield from bench.ask(one, uds("3e00")))[1] == "7e00"

    bench.world.play(bench.daemon, script())


def test_frames_and_testers_are_served_beside_each_other(bench):
    """A session of 400 requests while a message comes at 200 Hz: none is lost, each is answered."""

    def script():
        yield from bench.world.wait(0.05)
        one, answers = bench.connect(), []
        yield from bench.ask(one, ACTIVATE)
        frames = bench.daemon.gateway.engine.counters()["frames"]
        for _ in range(100):
            bench.world.put(256, bytes(8), uri="virtual:rig")
            answers += yield from bench.ask(one, uds("22f186") * 4)
        assert answers == ["00", "62f18601"] * 400
        assert bench.daemon.gateway.engine.counters()["frames"] == frames + 100

    bench.world.play(bench.daemon, script())
