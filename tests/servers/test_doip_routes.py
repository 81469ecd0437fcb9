"""Routes by DoIP to ECUs on CAN: what passes, whose answer it is, and what an ECU's own polling has of it."""

import os
import random
import struct
from itertools import pairwise

import pytest
from amount import amount
from asking_rig import Car, Ecu, settled
from doip_rig import FUNCTIONAL, TESTER, Peer, message
from rig import Rig, dtc_text, write_config
from test_access import SECRET

from gateway.runtime.app import Gateway
from gateway.servers.uds.security import hmac_sha256
from gateway.servers.uds.services.x19_read_dtc_information import REPORTS
from gateway_commands.check import check
from gateway_fdi.errors import InputError, InputErrors
from gateway_testers.doip.server import DoipServer

ROUTES = """
[[ecu]]
name = "brakes"
request = 0x7E1
response = 0x7E9
{read}
[[ecu]]
name = "body"
request = 0x7E2
response = 0x7EA
[[ecu]]
name = "doors"
address = 0x40
[output.uds]
security = [{{ level = 1, secret = "00112233" }}]
[output.doip]
[[output.doip.route]]
ecu = "brakes"
address = 0x1001
requests_per_s = 1000
[[output.doip.route]]
ecu = "body"
address = 0x1002
requests_per_s = 1000
[[output.doip.route]]
ecu = "doors"
address = 0x1003
requests_per_s = 1000
"""
READ = "read = [{ did = 0x2000, every_ms = 100 }]"
BRAKES, BODY, DOORS = 0x1001, 0x1002, 0x1003


def echo(request):
    """An ECU that answers any request at once, with all of it."""
    if len(request) > 1 and request[0] in (0x10, 0x3E) and request[1] & 0x80:
        return []
    return [(1, bytes([request[0] + 0x40]) + request[1:])]


class Net(Car):
    """A gateway with three routed ECUs, and what a tester without sockets needs of it."""

    def __init__(self, folder, *, read="", more="", answers=(echo, echo, echo), text=ROUTES):
        config = write_config(folder, extra=text.format(read=read) + more)
        brakes, body = (Ecu(0x7E1 + k, 0x7E9 + k, answers[k]) for k in range(2))
        doors = Ecu(0x18DA40F1, 0x18DAF140, answers[2])
        super().__init__(config, [brakes, body, doors])
        self.server = next(each for each in self.gateway.servers.all if isinstance(each, DoipServer))
        self.rig = self
        self.run(200)

    def tester(self, source=TESTER):
        made = Peer(self)
        assert made.activate(source) == 0x10
        return made

    def ask(self, one, target, request, ms=60):
        """Return what comes: acknowledges as their code, answers as (source address, hex digits)."""
        one.take()
        one.send(message(0x8001, struct.pack(">HH", one.source, target) + bytes.fromhex(request.replace(" ", ""))))
        self.run(ms)
        return [
            (int.from_bytes(body[:2], "big"), body[4:].hex()) if kind == 0x8001 else body[4]
            for kind, body in one.take()
        ]


@pytest.fixture
def net(tmp_path):
    made = Net(tmp_path)
    yield made
    made.close()


@pytest.mark.evidence("ISO 13400-2: 8001")
def test_requests_go_to_their_ecu_and_answers_come_from_its_address(net):
    one = net.tester()
    for target in (BRAKES, BODY, DOORS):
        assert net.ask(one, target, "22f190") == [0, (target, "62f190")]
        assert net.ask(one, target, "1001") == [0, (target, "5001")]
        assert net.ask(one, target, "3e80") == [0]
    assert [ecu.heard for ecu in net.ecus] == [[b"\x22\xf1\x90", b"\x10\x01", b"\x3e\x80"]] * 3
    assert net.state()["passed_in_vain"] == 0
    assert net.server.identity.answer(message(0x4001), 0)[8] == 0, "a gateway, not a node"


def test_the_times_of_a_session_have_the_routes_part(net):
    """50 ms and 5 s, behind a request that is waited for 200 ms at most, and 1 ms between two."""
    net.ecus[0].answer = lambda request: [(1, bytes.fromhex("5001003201f4"))]
    assert net.ask(net.tester(), BRAKES, "1001") == [0, (BRAKES, f"5001{251:04x}{521:04x}")]


@pytest.mark.evidence("ISO 13400-2: functional")
def test_a_functional_request_goes_to_all_and_is_acknowledged_once(net):
    one = net.tester()
    told = net.ask(one, FUNCTIONAL, "3e00")
    assert told[0] == 0
    assert sorted(told[1:]) == [(0x1000, "7e00"), (BRAKES, "7e00"), (BODY, "7e00"), (DOORS, "7e00")]


def test_who_is_not_meant_is_silent_when_all_are_asked(tmp_path):
    made = Net(tmp_path, answers=(lambda request: [(1, bytes([0x7F, request[0], 0x31]))], echo, lambda request: []))
    told = made.ask(made.tester(), FUNCTIONAL, "22f190", ms=400)
    assert sorted(told[1:]) == [(BODY, "62f190")], "our own identifier is not there, either"
    assert made.server.counters()["routes_without_answer"] == 1
    assert made.ask(made.tester(TESTER + 1), BRAKES, "22f190") == [0, (BRAKES, "7f2231")]
    made.close()


def test_requests_and_answers_of_many_frames(tmp_path):
    made = Net(tmp_path, answers=(lambda request: [(3, b"\x62" + request[1:] * 500)], echo, echo))
    one = made.tester()
    request = "22" + "".join(f"{0x2000 + k:04x}" for k in range(4))
    assert made.ask(one, BRAKES, request, ms=900) == [0, (BRAKES, "62" + request[2:] * 500)]
    assert made.ask(one, DOORS, "22" + "2001" * 2000, ms=900) == [0, (DOORS, "62" + "2001" * 2000)]
    assert made.ask(one, BODY, "22" + "2001" * 2048) == [4]
    assert made.ask(one, BODY, "22f190") == [0, (BODY, "62f190")]
    made.close()


def test_0x78_is_passed_on_and_one_for_ever_ends(tmp_path):
    slow = lambda request: [(20, b"\x7f\x22\x78"), (3000, b"\x7f\x22\x78"), (3000, b"\x62" + request[1:])]  # noqa: E731
    ever = lambda request: [(40 * k, b"\x7f\x22\x78") for k in range(1, 100)]  # noqa: E731
    made = Net(tmp_path, answers=(slow, ever, echo))
    one = made.tester()
    told = made.ask(one, BRAKES, "22f190", ms=6200)
    assert told == [0, (BRAKES, "7f2278"), (BRAKES, "7f2278"), (BRAKES, "62f190")]
    assert len(made.ask(one, BODY, "22f190", ms=6000)) <= 62
    assert not made.gateway.asking.ecus[1].client.busy
    made.close()


def test_what_is_answered_to_others_is_not_passed_on(net):
    one = net.tester()
    net.ecus[0].answer = lambda request: [(1, b"\x62\xf1\x91x"), (2, b"\x7f\x19\x31"), (3, b"\x62\xf1\x90y")]
    assert net.ask(one, BRAKES, "22f190") == [0, (BRAKES, "62f19079")]
    net.say(0x7E9, b"\x04\x62\xf1\x90\x01\x00\x00\x00")
    net.run(10)
    assert one.take() == [], "nobody asked"
    net.ecus[0].answer = lambda request: [(30, b"\x62\xf1\x90z")]
    one.send(message(0x8001, struct.pack(">HH", TESTER, BRAKES) + b"\x22\xf1\x90"))
    net.run(5)
    net.say(0x7E1, b"\x03\x22\xf1\x90\x00\x00\x00\x00")  # another tester on the bus asks the same ECU
    net.run(100)
    assert [body[4:].hex() for _, body in one.take()][1:] == ["7f2221"], "whose answer comes now is not known"


def test_two_testers_get_each_their_own_answers(net):
    one, two = net.tester(), net.tester(TESTER + 1)
    for k in range(6):
        for at, each in enumerate((one, two)):
            each.send(message(0x8001, struct.pack(">HHBH", each.source, BRAKES, 0x22, 0x100 * at + k)))
    net.run(200)
    for at, each in enumerate((one, two)):
        answers = [body[4:].hex() for kind, body in each.take() if kind == 0x8001]
        assert answers == [f"62{0x100 * at + k:04x}" for k in range(6)]


def test_back_pressure_is_a_testers_own(tmp_path):
    made = Net(tmp_path, answers=(lambda request: [(50, b"\x62" + request[1:])], echo, echo))
    one, two = made.tester(), made.tester(TESTER + 1)
    for _ in range(20):
        one.send(message(0x8001, struct.pack(">HH", TESTER, BRAKES) + b"\x22\xf1\x90"))
    codes = [body[4] for _, body in one.take()]
    assert (codes.count(0), codes.count(5)) == (8, 12)
    assert made.ask(two, BRAKES, "22f191", ms=600)[-1] == (BRAKES, "62f191")
    for _ in range(4):
        one.send(message(0x8001, struct.pack(">HH", TESTER, BRAKES) + b"\x22\xf1\x90"))
    made.run(10)
    assert len(made.gateway.asking.ecus[0].client.waiting.passed) == 3
    one.close()
    assert not made.gateway.asking.ecus[0].client.waiting.passed
    made.run(600)
    assert made.server.counters()["doip_routes_without_tester"] == 1
    made.close()


def test_the_queue_is_shared_with_polling_and_bounded_in_rate(tmp_path):
    made = Net(tmp_path, read=READ)
    one = made.tester()
    before, heard = made.state()["answers"], len(made.ecus[0].heard)
    for _ in range(100):
        one.take()
        one.send(message(0x8001, struct.pack(">HH", TESTER, BRAKES) + b"\x22\xf1\x90"))
        made.run(20)
    assert made.state()["answers"] - before >= 19, "2 s of polling at 10 Hz"
    assert settled(made.state())
    assert made.state()["passed"] == 100
    assert len(made.ecus[0].heard) - heard >= 119
    made.gateway.asking.ecus[1].client.waiting.apart_ns = 50_000_000
    for _ in range(8):
        one.send(message(0x8001, struct.pack(">HH", TESTER, BODY) + b"\x22\xf1\x90"))
    begin = made.now
    made.run(1000)
    times = [t for t, can_id, _ in made.requests if can_id == 0x7E2 and t * 1_000_000 >= begin]
    assert len(times) == 8
    assert min(b - a for a, b in pairwise(times)) >= 50
    made.close()


def test_an_ecu_that_is_silent_or_a_bus_that_is_dead(net):
    one = net.tester()
    net.ecus[1].answer = lambda request: []
    assert net.ask(one, BODY, "22f190", ms=400) == [0]
    assert net.state(1)["passed_in_vain"] == 1
    assert net.ask(one, BRAKES, "22f190") == [0, (BRAKES, "62f190")]
    net.gateway.controls.set_communication(receive=True, send=False, by="x")
    assert net.ask(one, BRAKES, "22f190") == [6], "nothing may be sent"


def test_a_reload_sends_requests_back_that_wait(net):
    one, two = net.tester(), net.tester(TESTER + 1)
    net.ecus[0].answer = lambda request: [(50, b"\x62" + request[1:])]
    for each in (one, two):
        each.send(message(0x8001, struct.pack(">HH", each.source, BRAKES) + b"\x22\xf1\x90"))
    net.run(10)
    old, before = net.gateway, net.server
    old.finish(net.now)
    net.gateway = Gateway(old.config, store=old.store)
    net.gateway.succeed(old)
    net.server = next(each for each in net.gateway.servers.all if isinstance(each, DoipServer))
    net.server.adopt(before)
    for each in (one, two):
        assert [body[4:].hex() for _, body in each.take()][1:] == ["7f2221"]
    net.run(100)
    assert net.ask(two, BRAKES, "22f190", ms=100) == [0, (BRAKES, "62f190")]


# Firewall


def unlock(net, one):
    assert net.ask(one, 0x1000, "1003")[1][1].startswith("5003")
    seed = bytes.fromhex(net.ask(one, 0x1000, "2701")[1][1][4:])
    key = hmac_sha256(seed, bytes.fromhex(SECRET), 1)
    assert net.ask(one, 0x1000, "2702" + key.hex())[1][1] == "6702"


RULE = '[access]\nunprotected = ["M1.Value"]\n'
RULE += 'route = {{ sessions = ["extended"], security = 1, when = [{{ signal = "M1.Value", max = 1.0 }}] }}\n'
WRITING = (
    "1002",
    "1003",
    "100100",
    "1101",
    "14ffffff",
    "2701",
    "280301",
    "2e012401",
    "31010201",
    "3400",
    "8502",
    "ba00",
)


def test_without_a_rule_only_reading_passes_and_nothing_else_is_seen_on_the_bus(net):
    one = net.tester()
    unlock(net, one)
    for request in WRITING:
        for target in (BRAKES, FUNCTIONAL):
            told = net.ask(one, target, request)
            assert (BRAKES, f"7f{request[:2]}33") in told, request
    assert net.ecus[0].heard == []
    noted = [each for each in net.gateway.memory.interventions() if each.action == "route"]
    assert {(each.bus, each.address, each.outcome) for each in noted} == {
        (f"doip 192.0.2.1 to {name}", TESTER, 0x33) for name in ("brakes", "body", "doors")
    }


def test_a_rule_opens_the_rest_to_who_meets_it_and_while_it_is_met(tmp_path):
    made = Net(tmp_path, more=RULE.format())
    one, clear = made.tester(), "14ffffff"
    speed = lambda value: made.say(257, round(value * 2).to_bytes(2, "little") + bytes(6))  # noqa: E731
    assert made.ask(one, BRAKES, clear) == [0, (BRAKES, "7f147f")]
    made.ask(one, 0x1000, "1003")
    assert made.ask(one, BRAKES, clear) == [0, (BRAKES, "7f1433")]
    unlock(made, one)
    assert made.ask(one, BRAKES, clear) == [0, (BRAKES, "7f1422")]
    speed(50.0)
    assert made.ask(one, BRAKES, clear) == [0, (BRAKES, "7f1422")]
    assert made.ecus[0].heard == []
    speed(0.0)
    assert made.ask(one, BRAKES, clear) == [0, (BRAKES, "54ffffff")]
    assert made.ecus[0].heard == [bytes.fromhex(clear)]
    assert made.ask(made.tester(TESTER + 1), BRAKES, clear) == [0, (BRAKES, "7f147f")], "another tester's key"
    noted = [each.outcome for each in made.gateway.memory.interventions() if each.action == "route"]
    assert noted == [0x7F, 0x33, 0x22, 0, 0x7F]
    made.close()


def test_random_requests_and_rules(tmp_path):
    """Only what a rule or reading lets pass is ever seen by the ECU, whatever is tried."""
    seed = int(os.environ.get("GATEWAY_SEED", "51"))
    print("seed", seed)
    draw = random.Random(seed)
    made = Net(tmp_path, more=RULE.format())
    one, open_, expected = made.tester(), False, []
    for _ in range(amount(3000, 150)):
        made.say(257, (0 if draw.random() < 0.5 else 100).to_bytes(2, "little") + bytes(6))
        if draw.random() < 0.1:
            open_ = draw.random() < 0.5
            made.ask(one, 0x1000, "1001", ms=5)
            if open_:
                unlock(made, one)
                made.ask(one, 0x1000, "3e00", ms=1)
        sid = draw.choice((0x10, 0x11, 0x14, 0x19, 0x22, 0x27, 0x2E, 0x31, 0x34, 0x3E, 0x85, draw.randrange(0x80)))
        request = bytes([sid]) + draw.randbytes(draw.randrange(5))
        if draw.random() < 0.3:
            request = bytes([0x10, draw.choice((1, 0x81, 2, 3))])
        stands = made.gateway.controls.meets(made.gateway.config.access.route.when)
        reads = (sid != 0x10 and request[0] in (0x19, 0x22, 0x3E)) or request in (b"\x10\x01", b"\x10\x81")
        if reads or (open_ and stands):
            expected.append(request)
        # Our own server takes a functional request, too, and may end the session.
        made.ask(one, BRAKES if open_ or draw.random() < 0.5 else FUNCTIONAL, request.hex(), ms=260)
        if open_:
            made.ask(one, 0x1000, "3e00", ms=1)
        assert made.ecus[0].heard == expected, request.hex()
    made.close()


class Can:
    """Another gateway's UDS server as an ECU."""

    def __init__(self, folder, request=0x7E1, response=0x7E9, bus=0):
        folder.mkdir()
        extra = f"[output.uds]\nrequest = {request}\nresponse = {response}\nfunctional = 0x7DF\n"
        self.rig, self.bus = Rig(write_config(folder, 60, extra=extra)), bus
        self.rig.wait(300)
        for k in range(60):
            self.rig.fail(k)

    @property
    def next_ns(self):
        return self.rig.gateway.next_ns

    def take(self, frames):
        self.rig.now = int(frames["t_ns"][-1])
        mine = frames[frames["bus"] == self.bus].copy()
        mine["bus"] = 0
        return self._placed(self.rig.gateway.feed(mine))

    def step(self, t_ns):
        self.rig.now = t_ns
        return self._placed(self.rig.gateway.poll(t_ns))

    def _placed(self, frames):
        frames["bus"] = self.bus
        return frames


def test_all_reports_of_60_dtcs_of_an_ecu_are_those_that_it_has(tmp_path):
    made, ecu = Net(tmp_path), Can(tmp_path / "ecu")
    made.now = max(made.now, ecu.rig.now)
    made.ecus[0] = ecu
    one = made.tester()
    own = next(server for server in ecu.rig.gateway.servers.all if hasattr(server, "uds")).uds
    dtc, seen = bytes.fromhex("100011"), 0
    assert dtc_text(0) == "P1000-11"
    for number, (length, _) in REPORTS.items():
        request = bytes([0x19, number]) + (dtc + b"\xff" if length >= 4 else b"\xff" * length)[:length].ljust(
            length, b"\xff"
        )
        (wanted,) = own.answer(request, False, ecu.rig.now)
        told = made.ask(one, BRAKES, request.hex(), ms=120 + len(wanted))
        assert told == [0, (BRAKES, wanted.hex())]
        seen += wanted[0] == 0x59
    assert seen > 15
    made.close()
    ecu.rig.close()


def test_the_check_prints_who_reaches_what_and_ways_around(tmp_path, capsys):
    """The table of gateway check, and its warnings where it is easier than it looks."""
    outside = RULE.format().replace("security = 1, ", "") + "[[output.doip.tester]]\naddress = 0x0E05\n"
    text = ROUTES.format(read="").replace("[output.doip]\n", '[output.doip]\nbind = ["0.0.0.0"]\n')
    check(write_config(tmp_path, extra=text + outside), schema_wanted=False, json=False)
    said = capsys.readouterr().out
    for line in (
        "  any network: 0.0.0.0, TCP 13400 (UDP 13400: identification, status)",
        "  testers 0x0E05 reach:",
        "    0x1001  brakes: 10 01, 19, 22, 3E, OBD but 04, 08; all else: in the extended session, M1.Value in ..1",
        "warning: output.doip.bind: all who reach 0.0.0.0 may come without TLS",
        "warning: access.route: every tester may write and clear by each route while its conditions",
    ):
        assert line in said, line
    check(write_config(tmp_path, extra=ROUTES.format(read="")), schema_wanted=False, json=False)
    said = capsys.readouterr().out
    assert "    0x1003  doors: 10 01, 19, 22, 3E, OBD but 04, 08; nothing else" in said
    assert "warning: output.doip" not in said


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ('[[output.doip.route]]\necu = "brake"\naddress = 0x1009', r"route\[3\].ecu"),
        ('[[output.doip.route]]\necu = "brakes"\naddress = 0x1001', r"route\[0\].address"),
        ('[[output.doip.route]]\necu = "brakes"\naddress = 0x0E00', "testers"),
        ("[access]\nroute = { security = 3 }", r"access.route.security"),
        ('[access]\nroute = { when = [{ signal = "M9.Value", min = 1.0 }] }', "M9"),
    ],
)
def test_wrong_routes_are_named(tmp_path, more, key):
    with pytest.raises((InputError, InputErrors), match=key):
        Car(write_config(tmp_path, extra=ROUTES.format(read="") + more))
