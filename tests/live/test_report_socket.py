"""The report socket of a daemon: packets, answers, connections that end, and that the loop never waits."""

import json
import os
import socket
import stat

import pytest
from daemon_rig import World
from reporting import write_config

from gateway.common.fence import Fence
from gateway.host.sockets import groups_of, listen_at
from gateway_fdi.errors import InputError
from gateway_serve import report_socket as module
from gateway_serve.metrics import Metrics

HOT, SLOW, BLIND = "battery.hot", "battery.slow", "camera.blind"


class Client:
    """A process that reports, without waiting."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.connect(str(path))
        self.socket.setblocking(False)

    def send(self, fault=HOT, result="passed", **more):
        self.socket.send(json.dumps({"fault": fault, "result": result, **more}).encode())

    def answers(self):
        told = []
        while True:
            try:
                packet = self.socket.recv(4096)
            except BlockingIOError:
                return told
            except ConnectionResetError:
                continue
            if not packet:
                return [*told, "ended"]
            told.append(json.loads(packet))


class Bench:
    """A daemon with a report socket, in this process."""

    def __init__(self, folder, **config):
        self.folder, self.world = folder, World()
        self.path = folder / "report.sock"
        extra = f'\n[status]\nsocket = "{folder / "status.sock"}"\n'
        self.config = write_config(folder, extra=config.pop("extra", extra), **config)
        self.daemon = self.world.daemon(self.config, folder / "faults.sqlite")

    def play(self, script):
        self.world.play(self.daemon, script)

    def wait(self, seconds=0.1):
        return self.world.wait(seconds)

    @property
    def counters(self):
        return self.daemon.gateway.reports.counters()

    def failing(self, fault):
        return bool(self.daemon.gateway.memory.status(fault) & 1)


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.daemon.close()


def test_reports_become_dtcs_and_each_is_answered_with_its_id(bench):
    assert stat.S_IMODE(bench.path.stat().st_mode) == 0o600
    one = Client(bench.path)

    def script():
        yield from bench.wait()
        one.send(HOT, "failed", data={"temperature": 90}, id=1)
        one.send(HOT, "broken", id=2)
        one.send(BLIND, "passed", id="three")
        yield from bench.wait()
        told = one.answers()
        assert [(a["ok"], a.get("id"), a.get("refused")) for a in told] == [
            (True, 1, None),
            (False, None, "malformed"),
            (True, "three", None),
        ]
        assert ("P0A7E-98", 1) in bench.world.dtcs()

    bench.play(script())
    (event,) = [e for e in bench.world.told("dtc") if e["dtc"] == "P0A7E-98"]
    assert event["t_ns"] > 1_700_000_000 * 10**9, "the wall clock's time"
    assert event["evidence"]["temperature [degC]"] == 90.0
    assert not bench.path.with_name("report.sock-journal").exists()


def test_all_that_a_killed_process_sent_is_counted_and_its_end_is_told(bench):
    """Its answers are unread: the kernel says "connection reset" before it gives what is left."""
    one = Client(bench.path)
    sent = []

    def script():
        yield from bench.wait()
        one.send()
        yield from bench.wait(0.01)
        for _ in range(7):
            one.send(SLOW, "passed")
            sent.append(1)
        one.socket.close()
        yield from bench.wait()

    bench.play(script())
    assert bench.counters == {"reports_accepted": 8, "reports_refused": 0, "reporters_lost": 1}
    (lost,) = bench.world.told("reporter")
    assert lost["faults"] == [HOT, SLOW]
    assert bench.failing("gateway.reporter_lost")


def test_a_process_that_sends_too_much_is_slowed_down_and_everything_is_answered(tmp_path):
    bench = Bench(tmp_path, battery="events_per_s = 20", camera="events_per_s = 1000")
    one, other = Client(bench.path), Client(bench.path)
    sent, told, turns = [], [], []

    def script():
        yield from bench.wait()
        for _ in range(200):
            try:
                while len(sent) < 2000:
                    one.send(HOT, "passed", id=len(sent))
                    sent.append(1)
            except BlockingIOError:
                pass
            before = sum(bench.counters.values())
            other.send(BLIND, "passed")
            yield from bench.wait(0.005)
            turns.append(sum(bench.counters.values()) - before)
            told.extend(one.answers())
        assert bench.daemon.gateway.reports.counters()["reports_refused"] <= 1.1 / module.PAUSE_S, "in a second"
        for _ in range(400):
            yield from bench.wait(0.02)
            told.extend(one.answers())

    bench.play(script())
    assert len(sent) > 100
    assert [answer["id"] for answer in told] == list(range(len(sent)))
    counts = {state["reporter"]: state["counts"] for state in bench.daemon.gateway.reports.states()}
    assert counts["battery"]["accepted"] + counts["battery"]["rate"] == len(sent)
    assert counts["battery"]["accepted"] < 400
    assert counts["camera"] == {"accepted": 200}
    assert max(turns) <= module.MOST_IN_A_TURN + 1
    assert len(bench.world.told("reporter")) == 1, "refused, told once"
    bench.daemon.close()


def test_who_does_not_read_its_answers_waits_and_the_loop_does_not(tmp_path):
    bench = Bench(tmp_path, battery="events_per_s = 1000")
    one, other = Client(bench.path), Client(bench.path)
    sent = []

    def script():
        yield from bench.wait()
        for _ in range(1500):
            try:
                one.send(HOT, "passed", id=len(sent))
                sent.append(1)
            except BlockingIOError:
                pass
            yield from bench.wait(0.015)
        other.send(BLIND, "passed")
        yield from bench.wait(0.01)
        assert other.answers() == [{"ok": True}]
        told = []
        for _ in range(len(sent)):
            told += one.answers()
            yield from bench.wait(0.005)
        assert [answer["id"] for answer in told] == list(range(len(sent)))

    bench.play(script())
    assert len(sent) < 1500, "its sender was made to wait"
    assert bench.counters["reports_accepted"] == len(sent) + 1
    bench.daemon.close()


def test_who_may_not_report_is_told_so_and_sent_away(bench, monkeypatch):
    monkeypatch.setattr(module, "credentials_of", lambda connection: (1, 54321, 54321))
    monkeypatch.setattr(module, "groups_of", lambda connection: {5})
    one = Client(bench.path)

    def script():
        yield from bench.wait()

    bench.play(script())
    told, end = one.answers()
    assert (told["ok"], told["refused"], end) == (False, "not_allowed", "ended")


def test_the_kernel_says_which_groups_a_process_is_in(tmp_path):
    with listen_at(tmp_path / "s", kind=socket.SOCK_SEQPACKET) as listener:
        one = Client(tmp_path / "s")
        made, _ = listener.accept()
        assert module.credentials_of(made) == (os.getpid(), os.geteuid(), os.getegid())
        assert groups_of(made) == set(os.getgroups())
        made.close()
        one.socket.close()


def test_connections_beyond_the_most_are_refused_and_counted(tmp_path):
    bench = Bench(tmp_path, table="connections = 2")
    clients = [Client(bench.path) for _ in range(4)]

    def script():
        yield from bench.wait()

    bench.play(script())
    assert [client.answers() for client in clients] == [[], [], ["ended"], ["ended"]]
    assert bench.daemon._asked["report"].refused == 2
    bench.daemon.close()


def test_a_reload_keeps_the_connections_moves_the_socket_and_takes_the_table_away(bench):
    one = Client(bench.path)
    moved = bench.folder / "moved.sock"

    def reload():
        bench.daemon.reloader.request()
        before = len(bench.world.told("config"))
        while len(bench.world.told("config")) == before:
            yield from bench.wait(0.005)
        assert bench.world.told("config")[-1]["state"] == "reloaded"

    def script():
        yield from bench.wait()
        one.send(HOT, "failed")
        yield from bench.wait(0.02)
        text = bench.config.read_text()
        bench.config.write_text(text.replace("[report]", "[report]\nmode = 0o660"))
        yield from reload()
        assert stat.S_IMODE(bench.path.stat().st_mode) == 0o660
        one.send(HOT, "passed")
        yield from bench.wait(0.02)
        assert one.answers() == [{"ok": True}] * 2
        bench.config.write_text(text.replace("report.sock", "moved.sock"))
        yield from reload()
        assert one.answers() == ["ended"]
        assert not bench.path.exists()
        two = Client(moved)
        two.send(BLIND, "failed")
        yield from bench.wait(0.02)
        assert two.answers() == [{"ok": True}]
        begin, end = text.index("[report]"), text.index("[status]")
        bench.config.write_text(text[:begin] + text[end:])
        yield from reload()
        assert two.answers() == ["ended"]
        assert not moved.exists()
        yield from bench.wait()

    bench.play(script())
    assert not bench.world.told("reporter"), "the gateway ended these connections itself"


def test_another_gateways_socket_is_not_taken(bench, tmp_path):
    with pytest.raises(InputError, match="another gateway listens at this report socket"):
        listen_at(bench.path, "report socket", kind=socket.SOCK_SEQPACKET)


class Told:
    """As much of the page's hub as metrics ask for."""

    connected, monitoring = True, {"on": True}
    hello, worst, buses, counters, missed, refused, security = {"faults": []}, {}, [], {}, 0, 0, {}
    exceptions, fence = {}, Fence()

    def __init__(self, reporters):
        self.reporters, self.ecus = reporters, []
        self.memory = {
            "entries": [],
            "cases": [],
            "status": {},
            "stored": True,
            "ecu_dtcs": [],
            "restarts": {"count": 2},
        }


def test_the_status_socket_and_the_metrics_count_them(bench):
    one, watcher = Client(bench.path), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    watcher.connect(str(bench.folder / "status.sock"))
    heard = bytearray()

    def script():
        yield from bench.wait()
        one.send(HOT, "failed")
        one.send(HOT, "broken")
        yield from bench.wait(0.02)
        one.socket.close()
        for _ in range(20):
            yield from bench.wait(0.05)
            heard.extend(watcher.recv(1 << 20))

    bench.play(script())
    last = heard[heard.rindex(b'{"kind": "buses"') :]
    reporters = json.loads(last[: last.index(b"\n")])["reporters"]
    assert {each["reporter"]: each["lost"] for each in reporters} == {"battery": [HOT], "camera": [], "": []}
    text = Metrics(Told(reporters)).text().decode()
    for line in (
        'gateway_reports_total{outcome="accepted",reporter="battery"} 1.0',
        'gateway_reports_total{outcome="malformed",reporter=""} 1.0',
        'gateway_reporter_losses_total{reporter="battery"} 1.0',
        'gateway_reporter_lost{reporter="battery"} 1.0',
        'gateway_reporter_lost{reporter="camera"} 0.0',
    ):
        assert line in text
    watcher.close()
