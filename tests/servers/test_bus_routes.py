"""Routes from bus to bus: can-isotp and udsoncan on both ends, with the gateway between them, on a clock of its own."""

import os
import random
import struct

import isotp
import pytest
from amount import amount
from asking_rig import Car
from daemon_rig import World
from doip_rig import TESTER, Peer, message
from rig import write_config
from test_access import SECRET
from test_authentication import AUTH, certificates, log_in
from test_doip_routes import RULE, Can, echo
from udsoncan.client import Client
from udsoncan.connections import BaseConnection
from udsoncan.exceptions import NegativeResponseException

from gateway.bus.frames import EXTENDED, empty, payload, put
from gateway.runtime.app import Gateway
from gateway.servers.uds.security import hmac_sha256
from gateway.servers.uds.services.x19_read_dtc_information import REPORTS
from gateway_commands.check import check
from gateway_fdi.errors import InputError, InputErrors
from gateway_testers.doip.server import DoipServer

ROUTES = """
[[bus]]
name = "c"
uri = "virtual:far"
health = {{ watched = false }}
[[ecu]]
name = "brakes"
bus = "c"
request = 0x711
response = 0x719
{read}
[[ecu]]
name = "body"
bus = "c"
address = 0x40
[[ecu]]
name = "doors"
bus = "c"
request = 0x6F1
response = 0x640
target = 0x40
[output.uds]
bus = "b"
security = [{{ level = 1, secret = "00112233" }}]
{uds}
[[output.uds.route]]
ecu = "brakes"
request = 0x7E1
response = 0x7E9
requests_per_s = 1000
[[output.uds.route]]
ecu = "body"
request = 0x6F1
response = 0x612
target = 0x12
requests_per_s = 1000
[[output.uds.route]]
ecu = "doors"
address = 0x33
requests_per_s = 1000
[[output.uds.route]]
ecu = "doors"
request = 0x6F1
response = 0x613
target = 0x13
requests_per_s = 1000
[output.doip]
[[output.doip.route]]
ecu = "brakes"
address = 0x1001
requests_per_s = 1000
"""
READ = "read = [{ did = 0x2000, every_ms = 100 }]"
OWN, BRAKES, BODY, DOORS = (0x7E0, 0x7E8), (0x7E1, 0x7E9), (0x6F1, 0x612, 0x12, 0xF1), (0x18DA33F1, 0x18DAF133)


class Node:
    """One end of ISO-TP by can-isotp; its answers come from a function, if it has one."""

    next_ns = 0

    def __init__(self, bus, sends, hears, theirs=None, ours=None, answer=None):
        self.bus, self.answer, self.heard, self.inbox, self.outbox = bus, answer, [], [], []
        self.hears, self.flag = hears, EXTENDED if sends > 0x7FF else 0
        kind, bits = "Normal" if theirs is None else "Extended", 29 if self.flag else 11
        self.layer = isotp.TransportLayerLogic(
            rxfn=lambda timeout: self.inbox.pop(0) if self.inbox else None,
            txfn=self.outbox.append,
            address=isotp.Address(
                isotp.AddressingMode[f"{kind}_{bits}bits"],
                txid=sends,
                rxid=hears,
                target_address=theirs,
                source_address=ours,
            ),
            # can-isotp's timeouts are of the wall clock, and a machine may be slow.
            params={"tx_padding": 0x55, "blocksize": 0, "stmin": 0, "max_frame_size": 100_000}
            | dict.fromkeys(("rx_flowcontrol_timeout", "rx_consecutive_frame_timeout"), 1_000_000),
        )

    def take(self, frames):
        for frame in frames[(frames["bus"] == self.bus) & (frames["can_id"] == self.hears | self.flag)]:
            data = payload(frame)
            self.inbox.append(isotp.CanMessage(self.hears, len(data), data, bool(self.flag)))
        return self.step(0)

    def step(self, _):
        self.layer.process()
        while self.layer.available():
            self.heard.append(bytes(self.layer.recv()))
            for _, answer in () if self.answer is None else self.answer(self.heard[-1]):
                self.layer.send(answer)
        self.layer.process()
        made = empty(len(self.outbox))
        for k, one in enumerate(self.outbox):
            put(made, k, 0, one.arbitration_id | self.flag, bytes(one.data), bus=self.bus)
        self.outbox.clear()
        return made


class Net(Car):
    """A tester's bus and another one with three ECUs, one of each addressing; the gateway between them."""

    def __init__(self, folder, *, read="", uds="", more="", answers=(echo, echo, echo)):
        far = [
            Node(1, 0x719, 0x711, answer=answers[0]),
            Node(1, 0x18DAF140, 0x18DA40F1, answer=answers[1]),
            Node(1, 0x640, 0x6F1, 0xF1, 0x40, answer=answers[2]),
        ]
        super().__init__(write_config(folder, extra=ROUTES.format(read=read, uds=uds) + more), far)
        self.far = far
        self.near = {ids: self.tester(*ids) for ids in (OWN, BRAKES, BODY, DOORS)}
        self.server = next(each for each in self.gateway.servers.all if isinstance(each, DoipServer))
        self.rig = self
        self.run(200)

    def tester(self, request, response, theirs=None, ours=None):
        made = Node(0, request, response, theirs, ours)
        self.ecus.append(made)
        return made

    def ask(self, ids, request, ms=30):
        """Return the answers that come, as hex digits."""
        node = self.near[ids]
        node.heard.clear()
        node.layer.send(bytes.fromhex(request.replace(" ", "")))
        self.run(ms)
        return [each.hex() for each in node.heard]

    def ask_all(self, request, can_id=0x7DF, ms=30):
        """Ask all; returns the answers by the identifiers of their routes."""
        for node in self.near.values():
            node.heard.clear()
        data = bytes.fromhex(request)
        self.say(can_id, bytes([len(data)]) + data.ljust(7, b"\x55"))
        self.run(ms)
        return {ids: [each.hex() for each in node.heard] for ids, node in self.near.items() if node.heard}

    def by_doip(self, one, target, request, ms=30, sender=None):
        one.take()
        one.send(message(0x8001, struct.pack(">HH", one.source, target) + bytes.fromhex(request)))
        self.run(ms)
        return [
            body[4:].hex()
            for kind, body in one.take()
            if kind == 0x8001 and int.from_bytes(body[:2], "big") == (sender or target)
        ]

    def speed(self, value):
        self.say(257, round(value * 2).to_bytes(2, "little") + bytes(6))


@pytest.fixture
def net(tmp_path):
    made = Net(tmp_path)
    yield made
    made.close()


class Connection(BaseConnection):
    """udsoncan on a node of the net."""

    def __init__(self, net, ids):
        super().__init__("net")
        self.net, self.node = net, net.near[ids]

    def open(self):
        return self

    def close(self):
        self.empty_rxqueue()

    def is_open(self):
        return True

    def empty_rxqueue(self):
        self.node.heard.clear()

    def specific_send(self, payload):
        self.node.layer.send(payload)

    def specific_wait_frame(self, timeout=2):
        for _ in range(round(timeout * 1000)):
            if self.node.heard:
                return self.node.heard.pop(0)
            self.net.run(1)
        raise TimeoutError


@pytest.mark.evidence("ISO 15765-2: addressing")
def test_each_addressing_reaches_its_ecu_with_short_and_long_messages(net):
    long = "22" + "2001" * 2000
    for at, ids in enumerate((BRAKES, BODY, DOORS)):
        assert net.ask(ids, "22f190") == ["62f190"]
        assert net.ask(ids, long) == ["62" + long[2:]]
        assert net.ask(ids, "3e80") == []
        assert net.far[at].heard == [b"\x22\xf1\x90", bytes.fromhex(long), b"\x3e\x80"]
    assert net.ask(OWN, "3e00") == ["7e00"], "the gateway itself"
    counters = net.gateway.servers.counters()
    assert counters["routed"] == 9
    assert counters["isotp_errors"] == 0, "each of two routes by 0x6F1 passes over what is to the other one"


@pytest.mark.evidence("ISO 15765-2: escape length")
def test_answers_above_4095_bytes_have_the_escape_length(tmp_path):
    made = Net(tmp_path, answers=[lambda request: [(0, b"\x62" + request[1:3] + bytes(range(250)) * 80)]] * 3)
    wanted = "62f190" + bytes(range(250)).hex() * 80
    for ids in (BRAKES, BODY, DOORS):
        assert made.ask(ids, "22f190") == [wanted]
    one = Peer(made)
    assert one.activate(TESTER) == 0x10
    assert made.by_doip(one, 0x1001, "22f190") == [wanted]
    made.far[0].answer = lambda request: [(0, b"\x62" + request[1:3] + bytes(65532))]
    assert made.ask(BRAKES, "22f190") == ["62f190" + bytes(65532).hex()]
    assert made.by_doip(one, 0x1001, "22f190") == ["7f2214"], "longer than most_bytes"
    made.far[0].answer = lambda request: [(0, b"\x62" + request[1:3] + bytes(65533))]
    assert made.ask(BRAKES, "22f190") == ["7f2214"], "longer than the bound"
    assert not made.far[0].layer.transmitting(), "the ECU is told, too"
    assert made.state()["answers_cut"] == 1
    made.close()


def test_a_functional_request_goes_to_all_routes_of_its_length(net):
    assert net.ask_all("3e00") == {OWN: ["7e00"], BRAKES: ["7e00"]}
    assert net.ask_all("3e00", EXTENDED | 0x18DB33F1) == {DOORS: ["7e00"]}
    net.far[0].answer = lambda request: [(0, bytes([0x7F, request[0], 0x31]))]
    assert net.ask_all("22f190") == {}, "who is not meant is silent"
    assert net.ask_all("14ffffff")[BRAKES] == ["7f1433"]
    assert net.far[0].heard[2:] == []


def test_0x78_the_times_of_a_session_and_silence(net):
    net.far[0].answer = lambda request: [(0, bytes([0x7F, request[0], 0x78])), (0, bytes.fromhex("5001003201f4"))]
    assert net.ask(BRAKES, "1001") == ["7f1078", f"5001{251:04x}{521:04x}"]
    net.far[0].answer = lambda request: []
    assert net.ask(BRAKES, "22f190", ms=300) == ["7f2225"]
    assert net.ask_all("22f190", ms=300) == {}
    assert net.gateway.servers.counters()["routes_without_answer"] == 2
    net.gateway.controls.set_communication(receive=True, send=False, by="x")
    assert net.ask(BRAKES, "22f190") == ["7f2225"], "nothing may be sent"
    assert net.far[0].heard[3:] == []


def test_what_is_answered_to_others_is_not_passed_on(net):
    net.far[0].answer = lambda request: [(0, b"\x62\xf1\x91x"), (0, b"\x7f\x19\x31"), (0, b"\x62\xf1\x90y")]
    assert net.ask(BRAKES, "22f190") == ["62f19079"]
    frame = empty(1)
    put(frame, 0, net.now, 0x719, b"\x04\x62\xf1\x90\x01\x00\x00\x00", bus=1)
    net._feed(frame)
    net.run(10)
    assert [each.hex() for each in net.near[BRAKES].heard] == ["62f19079"], "nobody asked"
    net.far[0].answer = lambda request: []
    net.ask(BRAKES, "22f190", ms=5)
    put(frame, 0, net.now, 0x711, b"\x03\x22\xf1\x90\x00\x00\x00\x00", bus=1)  # another tester on the ECU's bus
    net._feed(frame)
    net.run(300)
    assert [each.hex() for each in net.near[BRAKES].heard] == ["7f2221"], "whose answer comes is not known"


def test_back_pressure_and_one_queue_with_polling_and_doip(tmp_path):
    made = Net(tmp_path, read=READ)
    one = Peer(made)
    assert one.activate(TESTER) == 0x10
    before = made.state()["answers"]
    for k in range(20):
        assert made.ask(BRAKES, f"22{k:04x}") == [f"62{k:04x}"]
        assert made.by_doip(one, 0x1001, f"22{k:04x}") == [f"62{k:04x}"]
    assert made.state()["passed"] == 40
    assert made.state()["answers"] - before >= 11, "1.2 s of polling at 10 Hz"
    made.far[0].answer = lambda request: []
    for _ in range(12):
        made.ask(BRAKES, "22f190", ms=1)
        made.near[BRAKES].heard.clear()
    assert made.ask(BRAKES, "22f190", ms=2) == ["7f2221"], "eight wait"
    made.far[0].answer = echo
    made.run(400)
    assert made.ask(BRAKES, "22f190") == ["62f190"]
    made.close()


def test_a_reload_sends_requests_back_and_goes_on(net):
    net.far[0].answer = lambda request: []
    net.ask(BRAKES, "22f190", ms=5)
    old = net.gateway
    old.finish(net.now)
    frame = empty(1)
    put(frame, 0, net.now, 0x7E1, b"\x03\x22\xf1\x91\x00\x00\x00\x00")
    assert [payload(each)[:4] for each in old.promise(frame, net.now)] == [b"\x03\x7f\x22\x78"]
    net.gateway = Gateway(old.config, store=old.store)
    net.gateway.succeed(old)
    net.run(10)
    assert [each.hex() for each in net.near[BRAKES].heard] == ["7f2221"]
    net.far[0].answer = echo
    assert net.ask(BRAKES, "22f190") == ["62f190"]
    assert net.gateway.servers.counters()["routed"] == 2


def test_udsoncan_reads_the_dtcs_of_another_gateway_as_it_has_them(tmp_path):
    made, ecu = Net(tmp_path), Can(tmp_path / "ecu", bus=1, request=0x711, response=0x719)
    made.now = max(made.now, ecu.rig.now)
    made.ecus[0] = ecu
    own = next(server for server in ecu.rig.gateway.servers.all if hasattr(server, "uds")).uds
    seen = 0
    for number, (length, _) in REPORTS.items():
        request = bytes([0x19, number]) + (b"\x10\x00\x11\xff" if length >= 4 else b"\xff" * 9)[:length].ljust(
            length, b"\xff"
        )
        (wanted,) = own.answer(request, False, ecu.rig.now)
        assert made.ask(BRAKES, request.hex(), ms=60) == [wanted.hex()]
        seen += wanted[0] == 0x59
    assert seen > 15
    (wanted,) = own.answer(b"\x19\x02\xff", False, ecu.rig.now)
    with Client(Connection(made, BRAKES)) as client:
        found = client.get_dtc_by_status_mask(0xFF).service_data.dtcs
        assert b"".join(struct.pack(">I", d.id << 8 | d.status.get_byte_as_int()) for d in found) == wanted[3:]
        with pytest.raises(NegativeResponseException, match="SecurityAccessDenied"):
            client.clear_dtc()
    noted = made.gateway.memory.interventions()[-1]
    assert (noted.bus, noted.address, noted.action, noted.outcome) == ("b to brakes", 0x7E1, "route", 0x33)
    made.close()
    ecu.rig.close()


def unlock(ask):
    """Open the extended session and level 1 by a function that asks the gateway."""
    assert ask("1003")[0].startswith("5003")
    seed = bytes.fromhex(ask("2701")[0][4:])
    assert ask("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == ["6702"]


ROLE = RULE.replace("security = 1", 'roles = ["workshop"]')


@pytest.mark.parametrize(("rule", "lacks"), [(RULE, 0x33), (ROLE, 0x34)], ids=["security", "role"])
def test_the_firewall_answers_the_same_by_can_and_by_doip(tmp_path, rule, lacks):
    """Random (session, security or role, condition, service, to one or to all): the ECU sees nothing forbidden."""
    seed = int(os.environ.get("GATEWAY_SEED", "51"))
    print("seed", seed)
    draw = random.Random(seed)
    certificates(tmp_path)
    made = Net(tmp_path, uds=AUTH, more=rule.format())
    one = Peer(made)
    assert one.activate(TESTER) == 0x10

    def by_can(request, patience=4):
        return "".join(made.ask(OWN, request, ms=4))

    def by_ip(request, patience=4):
        return "".join(made.by_doip(one, 0x1000, request, ms=4))

    def has_rights(ask, unit):
        assert ask("1003").startswith("5003")
        if unit and lacks == 0x34:
            assert log_in(ask, unit) == "6903120000"
        elif unit == "workshop":
            unlock(lambda request: [ask(request)])

    heard, tried = made.far[0].heard, set()
    for _ in range(amount(1500, 150)):
        state, moves = draw.choice(("default", "", "workshop", "workshop", "development")), draw.random() < 0.5
        made.speed(100.0 if moves else 0.0)
        sid = draw.choice((0x10, 0x11, 0x14, 0x19, 0x22, 0x27, 0x2E, 0x31, 0x34, 0x3E, 0x85, draw.randrange(0x80)))
        request = bytes([sid]) + draw.randbytes(draw.randrange(5))
        if draw.random() < 0.2:
            request = bytes([0x10, draw.choice((1, 0x81, 2, 3))])
        to_all = draw.random() < 0.3 and sid != 0x28  # this one would silence us before it is passed on
        reads = (request[0] in (0x19, 0x22, 0x3E)) or request in (b"\x10\x01", b"\x10\x81")
        wanted = 0x7F if state == "default" else lacks if state != "workshop" else 0x22 if moves else 0
        wanted, told, data = 0 if reads else wanted, [], request.hex()
        what = (seed, data, state, moves, to_all)
        for ask in (by_can, by_ip):
            if state != "default":
                has_rights(ask, state)
            heard.clear()
            if ask is by_can:
                found = made.ask_all(data, ms=4).get(BRAKES, []) if to_all else made.ask(BRAKES, data, ms=4)
            else:
                found = made.by_doip(one, 0xE400 if to_all else 0x1001, data, ms=4, sender=0x1001)
            told.append(found)
            assert heard == ([] if wanted else [request]), what
            made.run(1 if found else 210)  # an answer that does not come is waited for
            ask("1001")
        assert told[0] == told[1], what
        if wanted:
            assert told[0] == ([] if to_all and wanted == 0x7F else [f"7f{data[:2]}{wanted:02x}"]), what
        tried.add((moves, wanted, to_all))
    assert len(tried) >= 10
    made.close()


def test_a_key_at_another_address_of_the_gateway_opens_its_own_routes_alone(tmp_path):
    further = """[[output.uds.further]]
bus = "b"
request = 0x7E4
response = 0x7EC
[[output.uds.further.route]]
ecu = "brakes"
request = 0x7E5
response = 0x7ED
"""
    made = Net(tmp_path, more=further + RULE.format())
    two, other = (0x7E4, 0x7EC), (0x7E5, 0x7ED)
    made.near |= {ids: made.tester(*ids) for ids in (two, other)}
    made.speed(0.0)
    unlock(lambda request: made.ask(two, request, ms=5))
    assert made.ask(BRAKES, "14ffffff") == ["7f147f"], "another tester's key"
    assert made.ask(other, "14ffffff") == ["54ffffff"]
    assert made.gateway.asking.ecus[0].client.waiting.apart_ns == 20_000_000, "of three routes the slowest"
    assert [(each.address, each.outcome) for each in made.gateway.memory.interventions() if each.action == "route"] == [
        (0x7E1, 0x7F),
        (0x7E5, 0),
    ]
    made.close()


def test_the_check_prints_who_reaches_what(tmp_path, capsys):
    check(write_config(tmp_path, extra=ROUTES.format(read="", uds="") + RULE.format()), schema_wanted=False, json=False)
    said = capsys.readouterr().out
    more = "10 01, 19, 22, 3E, OBD but 04, 08; all else: in the extended session, security level 1, M1.Value in ..1"
    for line in (
        "by routes from bus to bus:",
        "  all who can send on the bus b, in the session at 0x7E0, reach:",
        f"    0x7E1, 0x7E9, with all by 0x7DF  brakes: {more}",
        f"    0x6F1 12, 0x612  body: {more}",
        f"    0x18DA33F1, 0x18DAF133, with all by 0x18DB33F1  doors: {more}",
    ):
        assert line in said.splitlines(), line


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ('ecu = "brake"\nrequest = 0x7E2\nresponse = 0x7EA', r"route\[4\].ecu.*the ECUs are brakes"),
        ('ecu = "brakes"\nrequest = 0x7E1\nresponse = 0x7EA', r"route\[4\].request = '0x7E1'.*route\[0\] has this"),
        ('ecu = "brakes"\nrequest = 0x6F1\nresponse = 0x7EA', r"route\[4\].request = '0x6F1'.*route\[1\] has this"),
        ('ecu = "brakes"\nrequest = 0x7E2\nresponse = 0x7E8', r"route\[4\].response.*output.uds has this"),
        ('ecu = "brakes"\nrequest = 0x7DF\nresponse = 0x7E8', "this request is to all ECUs"),
        ('ecu = "near"\nrequest = 0x7E2\nresponse = 0x7EA\n[[ecu]]\nname = "near"\nbus = "b"\naddress = 9', "own bus"),
        (
            'ecu = "quiet"\nrequest = 0x7E2\nresponse = 0x7EA\n[[ecu]]\nname = "quiet"\nbus = "q"\naddress = 9',
            "listened",
        ),
    ],
)
def test_wrong_routes_are_named(tmp_path, more, key):
    quiet = '[[bus]]\nname = "q"\nuri = "virtual:q"\nlisten_only = true\n'
    text = ROUTES.format(read="", uds="").replace(
        "[output.doip]", f"[[output.uds.route]]\n{more}\n{quiet}[output.doip]"
    )
    with pytest.raises((InputError, InputErrors), match=key):
        Car(write_config(tmp_path, extra=text))


def test_a_daemon_passes_on_between_its_buses(tmp_path):
    """In the daemon's own loop: the request, and the answer."""
    world = World()
    daemon = world.daemon(write_config(tmp_path, extra=ROUTES.format(read="", uds="")), tmp_path / "faults.sqlite")

    def script():
        yield from world.wait(0.05)
        world.put(0x7E1, b"\x03\x22\xf1\x90\0\0\0\0", "virtual:rig")
        yield from world.wait(0.02)
        world.put(0x719, b"\x05\x62\xf1\x90\x01\x02\0\0", "virtual:far")
        yield from world.wait(0.02)

    world.play(daemon, script())
    daemon.close()
    sent = [(uri, can_id, data[:6]) for _, uri, can_id, data in world.sent]
    assert sent == [
        ("virtual:far", 0x711, b"\x03\x22\xf1\x90\xcc\xcc"),
        ("virtual:rig", 0x7E9, b"\x05\x62\xf1\x90\x01\x02"),
    ]
