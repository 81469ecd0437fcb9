"""What comes from outside ends its own connection at most: walls around each door, and what once ended the daemon."""

import json
import socket
import ssl
import struct
from contextlib import suppress

import pytest
from outside import ACTIVATE, Bench, answers, uds

from gateway.live import listeners as doors_module
from gateway.live.loop import MOST_FAILURES
from gateway.servers.uds.server import UdsServer
from gateway_fdi.errors import GatewayError

COMMANDS = {
    "clear": ("dtc", "by", "why", "force"),
    "cycle": ("by", "why", "force"),
    "settings": ("dtcs", "receive", "send", "by", "why", "force"),
    "present": (),
    "values": ("signals",),
    "request": ("tester", "ecu", "uds"),
}
#: A value of each type of JSON, and some that are hard to keep or to compare.
VALUES = [
    None, True, False, 0, -1, 1e308, float("nan"), 10**400, "", "x", "\ud800", "\x00", "P0336-39", "self", [], [[]],
    [None], [{}], {}, {"do": {}}, [[[[[]]]]] * 3, "x" * 1000,
]  # fmt: skip


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.daemon.close()


# What ended the daemon once


@pytest.mark.parametrize("required", [True, False])
def test_a_byte_to_the_tls_port_while_it_lingers_ends_nothing(tmp_path, required):
    """A silent connection is ended after 2 s; what it sends then is thrown away."""
    bench = Bench(tmp_path, required=required)

    def script():
        yield from bench.wait()
        one = bench.connect(bench.tls)
        yield from bench.wait(2.2)
        for _ in range(5):
            one.send(b"x")
            yield from bench.wait(0.02)
        assert one.recv(10) == b""
        yield from bench.wait(2)
        assert bench.doip._peers == bench.doip._lingering == []

    bench.play(script())
    bench.daemon.close()


@pytest.mark.long
def test_every_field_of_every_command_may_be_of_any_type(bench):
    lines = [{"do": value} for value in VALUES]
    lines += [{"do": do, key: value} for do, keys in COMMANDS.items() for key in (*keys, "other") for value in VALUES]
    lines += [{"do": do, "id": value} for do in COMMANDS for value in VALUES]
    lines += [{"do": do, "id": {"a": []}, "do ": value} for do in COMMANDS for value in VALUES]
    lines += VALUES

    def script():
        yield from bench.wait()
        one = bench.client()
        yield from bench.wait()
        answers(one)
        for line in lines:
            one.send(json.dumps(line).encode() + b"\n")
            yield from bench.wait(0.01)
            (told,) = answers(one)
            if not (isinstance(line, dict) and line.get("do") in [*COMMANDS]):
                assert told["ok"] is False
            assert told["ok"] or "internal" not in told["error"]
            if isinstance(line, dict) and "id" in line:
                assert json.dumps(told["id"]) == json.dumps(line["id"]).replace("NaN", "null")

    bench.play(script())


# Planted exceptions: in each door, deep inside


def broken(*_arguments, **_more):
    raise RuntimeError("planted")


def by_doip(bench):
    """A session, and its end by a wrong header."""
    one = bench.connect()
    for data in (ACTIVATE, uds("3e00"), bytes(8)):
        with suppress(OSError):
            yield from bench.exchange(one, data)
    one.close()


def by_tls(bench):
    one = yield from bench.shaken()
    one.write(ACTIVATE + uds("3e00"))
    assert not (yield from one.read(bench, bool))


def at_tls(bench):
    one = bench.connect(bench.tls)
    one.send(b"\x16\x03\x01\x00\x05hello")
    yield from bench.wait(0.05)


def at_udp(bench):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.sendto(struct.pack(">BBHI", 2, 0xFD, 1, 0), ("127.0.0.1", bench.port))
        yield from bench.wait()


def at_status(bench):
    one = bench.client()
    for line in (b'{"id": 5, "do": "cycle"}\n', b'{"id": 6, "do": "request", "tester": "a", "uds": "3e00"}\n'):
        with suppress(OSError):  # sent away
            one.send(line)
        yield from bench.wait()
    bench.told = answers(one)


def at_report(bench):
    one = bench.reporter()
    yield from bench.wait()
    bench.told = None
    with suppress(OSError):
        one.send(b'{"fault": "battery.hot", "result": "failed"}')
    yield from bench.wait()
    with suppress(OSError):
        bench.told = one.recv(4096)


def on_the_bus(bench):
    for data in (b"\x02\x3e\x00", b"\x10\x0a\x22\xf1\x90\xf1\x90\xf1", b"\x21\x90"):
        bench.world.put(0x7E0, data.ljust(8, b"\0"), uri="virtual:rig")
        yield from bench.wait()


DOOR, SERVER = "gateway_testers.doip.door.DoipDoor", "gateway_testers.doip.server.DoipServer"
PLACES = {
    "accept": (DOOR + "._take", by_doip, "doip"),
    "listening": ("gateway.live.listening_sockets.ListeningSockets.accept", by_doip, "doip"),
    "connect": (SERVER + ".connect", by_doip, "doip"),
    "receive": (SERVER + ".receive", by_doip, "doip"),
    "splitter": ("gateway_testers.doip.codec.Splitter.take", by_doip, "doip"),
    "session": ("gateway.servers.uds.server.UdsServer.pass_time", by_doip, "doip"),
    "leave": ("gateway.servers.uds.server.UdsServer.leave", by_doip, "doip"),
    "disconnect": (SERVER + ".disconnect", by_doip, "doip"),
    "flush": ("gateway_testers.doip.peer.Peer.send", by_doip, "doip"),
    "linger": ("gateway_testers.doip.peer.Peer.linger", by_doip, "doip"),
    "watch": (DOOR + "._watch", by_doip, "doip"),
    "time": (SERVER + "._due_ns", by_doip, "doip"),
    "handshake": ("gateway_testers.doip.tls_stream.TlsStream.shake", at_tls, "doip"),
    "wrap": ("gateway_testers.doip.tls_stream.TlsStream.__init__", at_tls, "doip"),
    "decrypt": ("gateway_testers.doip.tls_stream.TlsStream.decrypted", by_tls, "doip"),
    "encrypt": ("gateway_testers.doip.tls_stream.TlsStream.encrypt", by_tls, "doip"),
    "identity": ("gateway_testers.doip.identity.Identity.answer", at_udp, "doip"),
    "reader": ("gateway_serve.status_socket.credentials_of", at_status, "status"),
    "greeting": ("gateway_serve.status_socket.StatusSocket._greeting", at_status, "status"),
    "line": ("gateway_serve.status_commands._loaded", at_status, "status"),
    "command": ("gateway_serve.status_commands.Commands._cycle", at_status, "status"),
    "request": ("gateway.servers.local.LocalServer.ask", at_status, "status"),
    "answer": ("gateway.servers.local.LocalServer._answer", at_status, "status"),
    "sessions": ("gateway_serve.status_commands.Commands.pass_time", at_status, "status"),
    "tick": ("gateway_serve.status_socket.StatusSocket._tick", at_status, "status"),
    "show": ("gateway_serve.status_socket.StatusSocket._send", at_status, "status"),
    "say": ("gateway_serve.status_socket.StatusSocket._flush", at_status, "status"),
    "gone": ("gateway_serve.status_commands.Commands.leave", at_status, "status"),
    "reporter": ("gateway_serve.report_socket.credentials_of", at_report, "report"),
    "enter": ("gateway_serve.external_reports.ExternalReports.enter", at_report, "report"),
    "report": ("gateway_serve.external_reports._parsed", at_report, "report"),
    "apply": ("gateway_serve.external_reports.ExternalReports._apply", at_report, "report"),
    "overdue": ("gateway_serve.external_reports.ExternalReports.pass_time", at_report, "report"),
    "send": ("gateway_serve.report_socket.ReportSocket._send", at_report, "report"),
    "lost": ("gateway_serve.external_reports.ExternalReports.leave", at_report, "report"),
    "frame": ("gateway.isotp.endpoint.IsoTpEndpoint.receive", on_the_bus, "uds"),
    "service": ("gateway.servers.uds.server.UdsServer._serve", on_the_bus, "uds"),
    "hold": ("gateway.servers.uds.server.UdsServer.hold", on_the_bus, "uds"),
    "due": ("gateway.isotp.endpoint.IsoTpEndpoint.next_ns", on_the_bus, "uds"),
}


@pytest.mark.long
@pytest.mark.parametrize("door", ["doip", "status", "report", "uds"])
def test_an_exception_deep_inside_a_door_ends_its_peer_and_stays_at_the_first_wall(bench, monkeypatch, caught, door):
    """One place after the other; after each all doors are served, and nothing is left of it."""

    def script():
        yield from bench.wait()
        for what, (place, attack, of) in PLACES.items():
            if of != door:
                continue
            known = len(caught)
            with monkeypatch.context() as patch:
                patch.setattr(place, property(broken) if what == "due" else broken)
                yield from attack(bench)
                yield from bench.wait(0.2)
            assert len(caught) > known, what
            assert {second for *_, second in caught} == {False}, what
            assert {str(error) for _, error, *_ in caught} == {"planted"}, what
            yield from bench.wait(1.2)  # doors that rest listen again
            known = len(caught)
            yield from bench.ask_all()
            assert len(caught) == known, what

    bench.play(script())
    assert bench.fence.first[door]
    assert not bench.fence.second
    told = [event for event in bench.world.told("security") if event["kind"] == "exception"]
    assert {event["sensor"] for event in told} == set(bench.fence.first)
    assert sum(event["count"] for event in told) == sum(bench.fence.first.values()), "each is told"
    passed_s = (bench.world.now_ns - bench.world.start_ns) / 1e9
    assert len(told) <= (passed_s + 2) * len(bench.fence.first), "at a bounded rate"
    assert {event["context"]["exception"] for event in told} == {"RuntimeError"}
    assert told[0]["context"]["place"].startswith("test_outside.py:")


def test_an_internal_error_is_an_answer_where_the_protocol_has_one(bench, monkeypatch, caught):
    monkeypatch.setattr(UdsServer, "_serve", broken)
    monkeypatch.setattr("gateway_serve.status_commands.Commands._cycle", broken)
    monkeypatch.setattr("gateway_serve.external_reports.ExternalReports._apply", broken)

    def script():
        yield from bench.wait()
        one = bench.connect()
        yield from bench.exchange(one, ACTIVATE)
        assert (yield from bench.exchange(one, uds("22f186")))[-1][4:] == b"\x7f\x22\x10"
        yield from at_status(bench)
        cycle, request = bench.told
        assert (cycle["id"], cycle["ok"]) == (5, False)
        assert "internal error" in cycle["error"]
        assert (request["id"], request["uds"]) == (6, ["7f3e10"])
        yield from at_report(bench)
        assert json.loads(bench.told) == {"ok": False, "refused": "internal", "why": json.loads(bench.told)["why"]}
        yield from on_the_bus(bench)
        assert [data[:4].hex() for _, _, can_id, data in bench.world.sent if can_id == 0x7E8][:1] == ["037f3e10"]

    bench.play(script())
    assert set(bench.fence.first) == {"doip", "status", "report", "uds"}
    assert not bench.fence.second


def test_what_repeats_is_a_dtc_of_the_gateway_itself_that_heals(bench, monkeypatch, caught):
    monkeypatch.setattr("gateway.runtime.exception_events.WINDOW_NS", 3 * 10**9)

    def script():
        yield from bench.wait(0.5)
        with monkeypatch.context() as patch:
            patch.setattr("gateway_testers.doip.identity.Identity.answer", broken)
            for _ in range(2):
                yield from at_udp(bench)
            yield from bench.wait(0.2)
            assert not bench.world.dtcs(), "twice is no fault"
            yield from at_udp(bench)
            yield from bench.wait(0.2)
        assert bench.world.dtcs() == [("U3000-81", 1)]
        yield from bench.wait(3.2)
        assert bench.world.dtcs()[1:] == [("U3000-81", 0)]
        bench.daemon.gateway.controls.clear(0xFFFFFF)
        yield from bench.wait(1)
        assert len(bench.world.dtcs()) <= 3, "nothing comes back"

    bench.play(script())
    (entry, *_) = [event for event in bench.world.told("dtc") if event["dtc"] == "U3000-81"]
    assert entry["fault"] == "gateway.exceptions"
    assert bench.daemon.gateway.summary(1.0)["counters"]["exceptions_doip"] == 3


# The second wall


def test_a_door_that_fails_as_a_whole_rests_and_is_opened_again(bench, monkeypatch, caught):
    """What no wall of a door thought of: all others are served meanwhile, and it comes back."""

    def script():
        yield from bench.wait()
        one = bench.connect()
        assert (yield from bench.exchange(one, ACTIVATE))
        with monkeypatch.context() as patch:
            patch.setattr("gateway_testers.doip.door.DoipDoor.turn", broken)
            yield from bench.wait(2)
            reader = bench.client()
            reader.send(b'{"id": "honest", "do": "present"}\n')
            yield from bench.wait()
            assert answers(reader)[0]["ok"]
            reader.close()
            turns = bench.fence.second["doip"]
            assert 3 <= turns <= doors_module.MOST_FAILURES, "it does not keep the loop busy"
            yield from bench.wait(10)
        assert (yield from bench.exchange(one, b"")) == [None], "it was closed"
        yield from bench.wait(11)
        yield from bench.ask_all()

    bench.play(script())
    assert not bench.fence.first
    told = [event for event in bench.world.told("security") if event["kind"] == "second_wall"]
    assert {event["sensor"] for event in told} == {"doip"}


def test_a_door_that_cannot_be_opened_again_is_tried_again(bench, monkeypatch, caught):
    def script():
        yield from bench.wait()
        for place in (DOOR, "gateway_serve.status_socket.StatusSocket", "gateway_serve.report_socket.ReportSocket"):
            with monkeypatch.context() as patch:
                patch.setattr(f"{place}.turn", broken)
                yield from bench.wait(4)
            with monkeypatch.context() as patch:
                patch.setattr("gateway.live.listening_sockets.ListeningSockets.add", broken)
                yield from bench.wait(12)
            yield from bench.wait(11)
            yield from bench.ask_all()

    bench.play(script())
    assert set(bench.fence.second) == {"doip", "status", "report"}
    assert min(bench.fence.second.values()) > doors_module.MOST_FAILURES
    assert not bench.fence.first


@pytest.mark.parametrize("error", [RuntimeError("planted"), MemoryError()])
def test_an_exception_in_the_loop_costs_a_turn(bench, monkeypatch, caught, error):
    poll, count = bench.daemon.gateway.poll, 0

    def raises(t_ns):
        nonlocal count
        count += 1
        if count % 3 == 0 and count < 40:
            raise error
        return poll(t_ns)

    def script():
        monkeypatch.setattr(bench.daemon.gateway, "poll", raises)
        yield from bench.wait(1)
        yield from bench.ask_all()

    bench.play(script())
    assert bench.fence.second["loop"] == len(caught) == 13


def test_a_loop_in_which_every_turn_fails_ends_and_orderly_ends_pass(bench, monkeypatch, caught):
    for error, turns in ((RuntimeError("planted"), MOST_FAILURES), (GatewayError("ours"), 1), (KeyboardInterrupt(), 1)):

        def raises(t_ns, error=error):
            raise error

        monkeypatch.setattr(bench.daemon.gateway, "poll", raises)
        bench.daemon._live._failures, left = 0, iter(range(2 * MOST_FAILURES))
        with pytest.raises(type(error)):
            bench.daemon._live.run(lambda left=left: next(left, None) is None)
        assert 2 * MOST_FAILURES - len([*left]) == turns


def test_a_driver_that_raises_anything_is_a_bus_that_is_lost_and_comes_back(bench, monkeypatch, caught):
    def script():
        yield from bench.wait()
        for work in ("receive", "send", "set_filters"):
            wire = bench.world.wires["virtual:rig"]
            setattr(wire, work, broken)
            if work == "set_filters":
                bench.daemon._live.links[0].listen_to([1], echo=False)
            bench.world.put(0x7E0, b"\x02\x3e\x00".ljust(8, b"\0"), uri="virtual:rig")
            yield from bench.wait(0.5)
            assert bench.world.wires["virtual:rig"] is not wire, work
        yield from bench.ask_all()

    bench.play(script())
    assert bench.fence.first["bus"] >= 3
    assert not bench.fence.second
    assert [event["state"] for event in bench.world.told("bus")].count("lost") == 3


# TLS: records in every state


def ended(made):
    """Return whether the other end has ended a connection."""
    try:
        while made.recv(1 << 16):
            pass
    except BlockingIOError:
        return False
    except ConnectionResetError:
        pass
    return True


def hello(bench, version=None):
    """Return the client's first record of a handshake."""
    return bench.context(version).wrap_bio(ssl.MemoryBIO(), out := ssl.MemoryBIO()), out


def first_record(bench, version=None):
    tls, out = hello(bench, version)
    with pytest.raises(ssl.SSLWantReadError):
        tls.do_handshake()
    return out.read()


ALERTS = [bytes([0x15, 3, 3, 0, 2, level, code]) for level in (1, 2) for code in (0, 10, 40, 80, 90, 100, 255)]
RESET = struct.pack("ii", 1, 0)


def test_tls_records_in_every_state(bench):
    """Silent, half a hello, alerts, a close, noise, plain HTTP, resets: each ends itself; all are served after it."""

    def script():
        yield from bench.wait()
        record, wrong = first_record(bench), [*ALERTS, b"GET / HTTP/1.1\r\n\r\n", bytes(300), b"\x16\x03\x01\xff\xff"]
        wrong += [b"\x14\x03\x03\x00\x01\x01", b"\x17\x03\x03\x00\x05hello", ACTIVATE]
        for before in (b"", record[:3], record[: len(record) // 2], record):
            for each in wrong:
                for reset in (False, True):
                    one = bench.connect(bench.tls)
                    one.send(before)
                    yield from bench.wait(0.01)
                    with suppress(OSError):
                        one.send(each)
                    if reset:
                        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                    else:
                        yield from bench.wait(0.01)
                    one.close()
        yield from bench.wait(3.5)
        assert bench.doip._peers == bench.doip._lingering == []
        yield from bench.ask_all()

    bench.play(script())


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_tls_after_the_handshake(bench, version):
    """Garbage, a bent record, alerts, a close with more behind it, renegotiation, bytes while it lingers."""

    def script():
        yield from bench.wait()
        for k, each in enumerate([*ALERTS, bytes(100), ACTIVATE, first_record(bench, version)]):
            one = yield from bench.shaken(version)
            if k % 2:
                one.write(ACTIVATE)
                yield from one.read(bench, bool)
            one.socket.send(each)
            yield from bench.wait(0.02)
            with suppress(OSError):
                one.socket.send(each)
            one.socket.close()
        one = yield from bench.shaken(version)
        one.tls.write(ACTIVATE)
        sent = bytearray(one.out.read())
        sent[-1] ^= 1
        one.socket.send(sent)
        yield from bench.wait(0.03)
        assert ended(one.socket)
        one = yield from bench.shaken(version)
        one.tls.write(ACTIVATE + uds("3e00"))
        with pytest.raises(ssl.SSLWantReadError):
            one.tls.unwrap()
        one.socket.send(one.out.read() + b"more")
        yield from bench.wait(0.03)
        assert ended(one.socket), "it has said that it ends"
        one = yield from bench.shaken(version)
        one.write(ACTIVATE[:4] + bytes(20))  # a wrong header: it is answered, and lingers
        assert (yield from one.read(bench, bool))
        for _ in range(4):
            one.socket.send(bytes(50))
            yield from bench.wait(0.05)
        yield from bench.wait(2)
        assert bench.doip._peers == bench.doip._lingering == []
        yield from bench.ask_all()

    bench.play(script())


def test_300_half_handshakes_give_way_and_testers_are_served_beside_them(bench):
    def script():
        yield from bench.wait()
        tls = yield from bench.shaken()
        tls.write(ACTIVATE)
        assert (yield from tls.read(bench, bool))
        record, half = first_record(bench), []
        for k in range(300):
            one = bench.connect(bench.tls)
            one.send(record[: k % len(record)])
            half.append(one)
            if k % 7 == 0:
                yield from bench.wait(0.005)
            for each in half[::9]:
                with suppress(OSError):
                    each.send(b"\x16")
        yield from bench.wait(0.2)
        assert len(bench.doip._peers) <= 17
        assert len(bench.doip._lingering) <= 32
        tls.write(uds("22f186"))
        assert (yield from tls.read(bench, lambda got: got.endswith(b"\x62\xf1\x86\x01")))
        yield from bench.wait(4)
        assert bench.doip._lingering == []
        for each in half:
            each.close()
        tls.socket.close()
        yield from bench.ask_all()

    bench.play(script())


def test_a_tester_that_takes_nothing_cannot_have_the_gateway_keep_more_and_more(bench):
    """By TLS, too: it is not heard while its answers have no room."""

    def script():
        yield from bench.wait()
        one = yield from bench.shaken()
        one.write(ACTIVATE)
        one.tls.write(uds("22f186") * 2000)
        data, most = one.out.read(), 0
        for _ in range(200):
            with suppress(OSError):
                data = data[one.socket.send(data[: 1 << 16]) :] or data
            yield from bench.wait(0.005)
            kept = [len(each.connection.out) + len(each._tls.sent) for each in bench.doip._peers]
            most = max(most, *kept, 0)
        assert most < 2 << 20
        one.socket.close()
        yield from bench.wait(3)
        yield from bench.ask_all()

    bench.play(script())


def test_frames_pass_while_no_peer_is_there(bench, monkeypatch):
    """The walls cost nothing where nothing happens: no call of a wall a batch."""
    calls, keep = [], type(bench.doip._wall).keep

    def counted(self, work, *arguments, **more):
        calls.append(work)
        return keep(self, work, *arguments, **more)

    def script():
        yield from bench.wait(0.5)
        monkeypatch.setattr(type(bench.doip._wall), "keep", counted)
        yield from bench.world.wait(0.5, lambda _: bench.world.put(256, bytes(8), uri="virtual:rig"))
        monkeypatch.undo()

    bench.play(script())
    assert len([each for each in calls if each.__name__ != "pass_time"]) == 0
