"""Requests by the status socket: the same server, sessions, rules, trace and routes as by a bus."""

import os
import random

import pytest
from asking_rig import Car, Ecu
from doors import Doors, Reader
from rig import Tester, write_config
from test_access import LEVEL, SECRET

from gateway.runtime.app import Gateway
from gateway.servers.local import MOST_TESTERS
from gateway.servers.uds.security import hmac_sha256
from gateway_serve.status_socket import StatusSocket


@pytest.fixture
def doors(tmp_path):
    with Doors(tmp_path, uds=LEVEL) as made:
        made.drive(0.0)
        yield made


def asks(reader, tester="one", ecu="self"):
    """Return a function from a request to its answers."""
    return lambda uds: reader.ask("request", tester=tester, ecu=ecu, uds=uds)["uds"]


def unlock(ask):
    seed = bytes.fromhex(ask("2701")[0][4:])
    return ask("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex())


def test_answers_are_those_of_a_tester_on_the_bus(doors):
    """Reports of DTCs, identifiers, refusals, and nonsense of a seed."""
    seed = int(os.environ.get("GATEWAY_SEED", "52"))
    print(f"seed {seed}")
    draw = random.Random(seed)
    doors.rig.fail(0)
    ask, bus = asks(doors.reader()), Tester(doors.rig)
    requests = ["1902ff", "190a", "1906" + "ffffff" + "ff", "22f186", "3e00", "14ffffff", "8502", "ba"]
    requests += [draw.randbytes(draw.randint(1, 6)).hex() for _ in range(100)]
    # Modes of OBD go to another server on this address; what changes the tester's own state is tried below.
    for request in [each for each in requests if bytes.fromhex(each)[0] not in (*range(0x0B), 0x10, 0x11, 0x27, 0x86)]:
        assert ask(request) == [each.hex() for each in bus.exchange(bytes.fromhex(request))], request


def test_each_name_has_a_session_and_a_key_of_its_own(doors):
    reader, other = doors.reader(), doors.reader()
    one, two, same = asks(reader), asks(reader, "two"), asks(other)
    assert one("1003")[0].startswith("5003")
    assert unlock(one) == ["6702"]
    assert [each("22f186") for each in (one, two, same)] == [["62f18603"], ["62f18601"], ["62f18601"]]
    assert two("1003")[0].startswith("5003")
    assert two("8502") == ["7f8533"]
    assert one("8502") == ["c502"]
    assert not doors.gateway.controls.results
    assert [each.bus for each in doors.gateway.memory.interventions()[-2:]] == [
        f"local two (reader 1, uid {os.getuid()})", f"local one (reader 1, uid {os.getuid()})",
    ]  # fmt: skip
    reader.leave()
    assert doors.gateway.controls.results, "what it had switched off is on when it leaves"
    assert same("22f186") == ["62f18601"]


def test_a_session_ends_with_s3_and_an_answer_that_takes_time_comes_once(doors):
    one = asks(doors.reader())
    one("1003")
    unlock(one)
    assert one("31010202") == ["7101020200"], "after 0x78, which is not told"
    doors.turn(6.0)
    assert one("22f186") == ["62f18601"]
    assert one("3e80") == []


def test_what_is_no_request_is_refused(doors):
    reader = doors.reader()
    for wrong, key in (
        ({"uds": "1"}, "uds"), ({"uds": ""}, "uds"), ({"uds": 5}, "uds"), ({"uds": "22" * 5000}, "uds"),
        ({"ecu": "brakes"}, "ecu"), ({"ecu": 1}, "ecu"), ({"tester": ""}, "tester"), ({"tester": "a b"}, "tester"),
        ({"tester": "x" * 41}, "tester"), ({"force": True}, "force"),
    ):  # fmt: skip
        answer = reader.ask("request", **({"tester": "t", "uds": "3e00"} | wrong))
        assert not answer["ok"]
        assert key in answer["error"]


def test_testers_of_a_reader_are_bounded_and_one_without_a_session_gives_way(doors):
    reader = doors.reader()
    assert asks(reader, "kept")("1003")[0].startswith("5003")
    for k in range(2 * MOST_TESTERS):
        assert asks(reader, f"t{k}")("3e00") == ["7e00"]
    assert asks(reader, "kept")("22f186") == ["62f18603"]


def test_responses_on_events_are_pushed(doors):
    reader = doors.reader()
    one = asks(reader)
    assert one("86010208190208")[0].startswith("c6")
    assert one("860502")[0].startswith("c6")
    doors.rig.fail(1)
    doors.turn()
    doors.turn()
    pushed = [message for message in reader.read() if message["kind"] == "response"]
    assert [(each["tester"], each["uds"][:4]) for each in pushed] == [("one", "5902")]


def test_a_reload_has_requests_asked_again_and_ends_sessions(doors):
    reader, old = doors.reader(), doors.gateway
    one = asks(reader)
    one("1003")
    unlock(one)
    assert one("8502") == ["c502"]
    reader.socket.send(b'{"id": 77, "do": "request", "tester": "one", "uds": "22f186"}\n')
    doors.status.turn(doors.now_s)
    new = Gateway(old.config, store=old.store)
    new.succeed(old)
    doors.rig.gateway = new
    doors.status.replace(new)
    doors.turn()
    assert [each["uds"] for each in reader.read() if each.get("id") == 77] == [["7f2221"]]
    assert new.controls.results
    assert one("22f186") == ["62f18601"]
    assert new.servers.counters()["local_requests"] > 4


ROUTED = """
[[ecu]]
name = "brakes"
request = 0x7E1
response = 0x7E9
[output.uds]
security = [{ level = 1, secret = "00112233" }]
"""


class Behind(Car):
    """A gateway with one ECU behind it, and its status socket."""

    def __init__(self, folder, answer, more=""):
        config = write_config(folder, extra=ROUTED + more)
        super().__init__(config, [Ecu(0x7E1, 0x7E9, answer)])
        self.path, self.now_s = folder / "s", 1.0
        self.status = StatusSocket(self.path, self.gateway)
        self.run(200)

    def turn(self):
        self.run(60)
        self.now_s += 0.06
        self.status.turn(self.now_s)

    def close(self):
        self.status.close()
        super().close()


def slow(request):
    """An ECU that has everybody wait, and echoes."""
    if request[1:2] == b"\x80":
        return []
    return [(1, bytes([0x7F, request[0], 0x78])), (5, bytes([request[0] + 0x40]) + request[1:])]


@pytest.mark.parametrize("rule", ["", '[access]\nroute = { sessions = ["extended"] }\n'])
def test_an_ecu_is_reached_by_the_rules_of_routes(tmp_path, rule):
    car = Behind(tmp_path, slow, rule)
    reader = Reader(car)
    ask, own = asks(reader, ecu="brakes"), asks(reader)
    assert ask("22f190") == ["62f190"]
    assert ask("3e80") == []
    assert ask("0105") == ["4105"], "OBD reads, too"
    assert own("1003")[0].startswith("5003")
    assert ask("2e0102") == ["6e0102" if rule else "7f2e33"]
    assert own("1001")[0].startswith("5001")
    assert ask("2e0102") == ["7f2e7f" if rule else "7f2e33"]
    sent = [request.hex() for request in car.ecus[0].heard]
    assert sent == ["22f190", "3e80", "0105"] + (["2e0102"] if rule else [])
    noted = [(each.outcome, each.bus) for each in car.gateway.memory.interventions() if each.action == "route"]
    by = f"local one (reader 1, uid {os.getuid()}) to brakes"
    assert noted == [(0, by), (0x7F, by)] if rule else [(0x33, by)] * 2
    car.ecus[0].answer = lambda request: []
    assert ask("22f190") == ["7f2225"], "it does not answer"
    car.close()
