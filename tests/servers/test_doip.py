"""DoIP (ISO 13400-2:2019) without sockets: each message, denial, refusal and timer of the entity."""

import os
import random
import struct

import pytest
from amount import amount
from doip_rig import FUNCTIONAL, GATEWAY, TESTER, Peer, codes, cut, message, net
from mutating import mutate
from rig import FUNCTIONAL as CAN_FUNCTIONAL
from rig import MS, Tester, write_config
from test_access import LEVEL, SECRET, STANDS
from uds_tester import Asked, hexed

from gateway.config.load import load_config
from gateway.servers.uds.security import hmac_sha256
from gateway.servers.uds.services.x19_read_dtc_information import REPORTS
from gateway_fdi.errors import InputErrors
from gateway_testers.doip.connection import ENOUGH_BYTES, MOST_BYTES
from gateway_testers.doip.server import UNACTIVATED

#: Requests of which each is good somewhere, or nowhere; 27: a seed and its key.
REQUESTS = (
    "1001", "1003", "1003", "1002", "27", "27", "1101", "14ffffff", "1902ff", "190a", "22f190", "220123", "22beef",
    "280301", "280001", "2e01240a0b", "31010201", "3e00", "3e80", "8501", "8502", "8605", "ba", "04",
)  # fmt: skip
VIN, EID = b"1HGCM82633A004352", bytes.fromhex("0123456789AB")
VEHICLE = VIN + struct.pack(">H", GATEWAY) + EID + bytes.fromhex("BA9876543210") + b"\x00\x00"


@pytest.fixture
def doip(tmp_path):
    with net(tmp_path) as made:
        yield made


# Identification


@pytest.mark.evidence("ISO 13400-2: 0001", "ISO 13400-2: 0002", "ISO 13400-2: 0003")
def test_identification_plain_by_eid_and_by_vin(doip):
    for kind, body in ((1, b""), (2, EID), (3, VIN)):
        for version in (2, 3, 0xFF):
            assert doip.udp(kind, body, version=version) == [(4, VEHICLE)]
    assert doip.udp(2, bytes(6)) == doip.udp(3, bytes(17)) == [], "another is meant"


@pytest.mark.evidence("ISO 13400-2: 0004 no VIN")
def test_a_vin_that_is_not_known_is_told_as_not_known(tmp_path):
    with net(tmp_path, more="") as made:
        made.server.identity._read = lambda number: None
        ((_, body),) = made.udp(1)
        assert body[:17] == bytes(17)
        assert body[-1] == 0x10


@pytest.mark.evidence("ISO 13400-2: 4001")
def test_entity_status_counts_active_testers(doip):
    assert doip.udp(0x4001) == [(0x4002, struct.pack(">BBBI", 1, 4, 0, 65536))]
    doip.peer()
    doip.tester()
    assert doip.udp(0x4001) == [(0x4002, struct.pack(">BBBI", 1, 4, 1, 65536))]


@pytest.mark.evidence("ISO 13400-2: 4003")
def test_power_mode_is_that_of_the_configured_conditions(tmp_path):
    with net(tmp_path, doip='ready = [{ signal = "M1.Value", min = 9.0 }]') as made:
        assert made.udp(0x4003) == [(0x4004, b"\x00")], "a signal that never came"
        made.rig.value(1, 12.0)
        assert made.udp(0x4003) == [(0x4004, b"\x01")]


@pytest.mark.evidence("ISO 13400-2: datagrams")
def test_datagrams_that_are_wrong_are_refused_and_answers_of_others_are_not_answered(doip):
    ask = doip.udp
    assert ask(0x1234) == ask(0x8001, bytes(5)) == [(0, b"\x01")]
    assert ask(1, b"x") == ask(1, length=4) == [(0, b"\x04")]
    assert ask(1, length=1 << 20) == [(0, b"\x02")]
    assert ask(1, version=9) == ask(0x4001, version=0xFF) == [(0, b"\x00")]
    for kind, body in ((0, b"\x00"), (4, VEHICLE), (0x4002, bytes(3)), (0x4004, b"\x01"), (0, b"")):
        assert ask(kind, body) == []
    assert doip.server.identity.answer(b"\x02\xfd", 0) == b""


# Routing activation


@pytest.mark.evidence("ISO 13400-2: 0005")
@pytest.mark.parametrize("version", [2, 3])
def test_activation_speaks_the_testers_version(doip, version):
    one = doip.peer()
    one.send(message(5, struct.pack(">HBI", TESTER, 0, 0), version=version))
    (told,) = cut(bytes(one.one.out))
    assert told == (version, 6, struct.pack(">HHBI", TESTER, GATEWAY, 0x10, 0))


@pytest.mark.evidence("ISO 13400-2: 0006 10")
def test_activation_with_and_without_what_carmakers_add(doip):
    assert codes(doip.peer().ask(5, struct.pack(">HBI", TESTER, 0, 0) + b"oems")) == 0x10
    assert codes(doip.peer().ask(5, struct.pack(">HBI", TESTER + 1, 1, 0))) == 0x10, "by regulation"


@pytest.mark.evidence("ISO 13400-2: 0006 00", "ISO 13400-2: 0006 02", "ISO 13400-2: 0006 06")
def test_each_denial(doip):
    for source, kind, code in ((0x0DFF, 0, 0x00), (0x1000, 0, 0x00), (TESTER, 2, 0x06), (TESTER, 0xE0, 0x06)):
        one = doip.peer()
        assert one.activate(source, kind) == code
        assert one.closed
    one = doip.tester()
    assert one.activate(TESTER) == 0x10, "again"
    assert one.activate(TESTER + 1) == 0x02
    assert one.closed
    assert doip.rig.gateway.servers.counters()["doip_activation_denied"] == 5


@pytest.mark.evidence("ISO 13400-2: 0006 03")
def test_who_is_active_elsewhere_is_denied_while_the_other_is_alive(doip):
    one, two = doip.tester(), doip.peer()
    assert two.activate() is None
    assert one.take() == [(7, b"")]
    one.send(message(8, struct.pack(">H", TESTER)))
    assert codes(two.take()) == 0x03
    assert two.closed
    doip.wait(1)
    assert not one.closed


@pytest.mark.evidence("ISO 13400-2: 0007")
def test_who_is_active_elsewhere_takes_the_place_of_one_that_died(doip):
    one, two = doip.tester(), doip.peer()
    assert two.activate() is None
    one.send(message(8, struct.pack(">H", TESTER + 1)))
    assert two.take() == [], "another one's answer proves nothing"
    doip.wait(0.45)
    assert two.take() == []
    doip.wait(0.1)
    assert one.closed
    assert codes(two.take()) == 0x10
    assert two("3e00") == "7e00"


def test_a_tester_that_goes_makes_room_at_once(doip):
    one, two = doip.tester(), doip.peer()
    assert two.activate() is None
    one.close()
    assert codes(two.take()) == 0x10


@pytest.mark.evidence("ISO 13400-2: 0006 01")
def test_all_sockets_are_taken_until_one_does_not_answer(tmp_path):
    with net(tmp_path, doip="connections = 2") as made:
        testers, late = [made.tester(TESTER + k) for k in range(2)], made.peer()
        assert late.activate(TESTER + 5) is None
        for k, one in enumerate(testers):
            assert one.take() == [(7, b"")]
            one.send(message(8, struct.pack(">H", TESTER + k)))
        assert codes(late.take()) == 0x01
        assert late.closed
        again = made.peer()
        assert again.activate(TESTER + 5) is None
        testers[0].send(message(8, struct.pack(">H", TESTER)))
        made.wait(0.6)
        assert codes(again.take()) == 0x10
        assert [one.closed for one in testers] == [False, True]


TLS = """[output.doip.tls]
certificate = "c.pem"
key = "k.pem"
client_ca = "ca.pem"
required = {required}
[[output.doip.tester]]
address = 0x0E00
[[output.doip.tester]]
address = 0x0E10
certificate = "workshop"
"""


@pytest.mark.evidence("ISO 13400-2: 0006 04", "ISO 13400-2: 0006 07")
def test_tls_and_certificates_that_activation_needs(tmp_path, monkeypatch):
    monkeypatch.setattr("gateway_testers.doip.section.tls_context", lambda params: None)
    with net(tmp_path, more=TLS.format(required="true")) as made:
        one = made.peer()
        assert one.activate() == 0x07
        assert one.closed
        assert made.peer(secure=True).activate() == 0x10
        alive = made.peer(secure=True, certificate="workshop")
        assert alive.activate(0x0E10) == 0x10
        other = made.peer(secure=True, certificate="fleet")
        assert other.activate(0x0E10) == 0x04
        assert not other.closed, "it may come with a right address"
        assert alive.take() == [], "nobody is asked to give way to a stranger"
        assert other.uds("3e00", source=0x0E10) == (0x8003, 0x02, [])
    with net(tmp_path, more=TLS.format(required="false")) as made:
        assert made.peer().activate() == 0x10
        assert made.peer().activate(0x0E10) == 0x04


# Diagnostic messages


@pytest.mark.evidence("ISO 13400-2: 8003 02", "ISO 13400-2: 8003 03", "ISO 13400-2: 8003 04")
def test_each_refusal_of_a_diagnostic_message(doip):
    one = doip.tester()
    assert one.uds("3e00", target=0x1001) == (0x8003, 0x03, [])
    assert one.uds("22" + "f190" * 2048) == (0x8003, 0x04, [])
    assert one.uds("3e00") == (0x8002, 0x00, ["7e00"])
    assert one.uds("3e00", source=TESTER + 1) == (0x8003, 0x02, [])
    assert one.closed
    two = doip.peer()
    assert two.uds("3e00", source=TESTER) == (0x8003, 0x02, []), "not activated"
    assert two.closed


@pytest.mark.evidence("ISO 13400-2: 8002")
def test_acknowledges_and_answers_name_their_sender(doip):
    one = doip.tester()
    address = struct.pack(">HH", TESTER, GATEWAY)
    assert one.ask(0x8001, address + b"\x3e\x00") == [
        (0x8002, struct.pack(">HHB", GATEWAY, TESTER, 0)),
        (0x8001, struct.pack(">HH", GATEWAY, TESTER) + b"\x7e\x00"),
    ]
    address = struct.pack(">HH", TESTER, FUNCTIONAL)
    assert one.ask(0x8001, address + b"\x3e\x00") == [
        (0x8002, struct.pack(">HHB", FUNCTIONAL, TESTER, 0)),
        (0x8001, struct.pack(">HH", GATEWAY, TESTER) + b"\x7e\x00"),
    ]
    assert one.uds("3e80") == (0x8002, 0, []), "no answer is wanted"
    assert one.uds("ba", target=FUNCTIONAL) == (0x8002, 0, []), "not meant"
    assert one.uds("ba") == (0x8002, 0, ["7fba11"])


def test_all_reports_of_60_dtcs_are_those_of_can(tmp_path):
    with net(tmp_path, messages=60) as made:
        for k in range(60):
            made.rig.fail(k)
        one, can = made.tester(), Tester(made.rig)
        seen = 0
        for number, (length, _) in REPORTS.items():
            for more in {bytes(length), b"\xff" * length, bytes.fromhex(hexed(7) + "ff")} if length else {b""}:
                request = bytes([0x19, number]) + more[:length].ljust(length, b"\xff")
                (answer,) = can.exchange(request, patience=400)
                assert one(request.hex()) == answer.hex(), request.hex()
                seen += answer[0] == 0x59
        assert seen > 20


@pytest.mark.evidence("ISO 13400-2: 8001 long")
def test_an_answer_of_20_kilobytes(tmp_path):
    """4095 bytes are the limit of ISO-TP, not that of DoIP; by CAN it is refused as too long (0x14)."""
    many = "".join(f'[[did]]\nid = {0x2000 + k}\nname = "n{k}"\nhex = "{bytes([k]).hex() * 400}"\n' for k in range(50))
    with net(tmp_path, more=many) as made:
        request = "22" + "".join(f"{0x2000 + k:04x}" for k in range(50))
        answer = bytes.fromhex(made.tester()(request))
        assert len(answer) == 1 + 50 * 402
        assert answer == b"\x62" + b"".join(struct.pack(">H", 0x2000 + k) + bytes([k]) * 400 for k in range(50))
        assert Tester(made.rig).ask(request, patience=300) == bytes.fromhex("7f2214")
    with net(tmp_path, more=many, doip="most_bytes = 8192") as made:
        assert made.tester()(request) == "7f2214"


def test_an_answer_that_takes_its_time_comes_after_0x78(doip):
    one = doip.tester()
    one("1003")
    assert one("31010202") == "7f3178"
    doip.wait(0.01)
    assert [body[4:].hex() for _, body in one.take()] == ["7101020200"]


def test_responses_on_events_go_to_the_tester_that_asked(doip):
    one, two = doip.tester(), doip.tester(TESTER + 1)
    assert one("860102081902ff").startswith("c601")
    assert one("860502").startswith("c605")
    doip.rig.fail(0)
    doip.wait(0.1)
    assert any(body[4:6] == b"\x59\x02" for _, body in one.take())
    assert two.take() == []


# A session of his own


def test_each_tester_has_a_session_and_a_security_of_his_own_whatever_he_comes_by(tmp_path):
    with net(tmp_path, uds=LEVEL) as made:
        one, two, can = made.tester(), made.tester(TESTER + 1), Tester(made.rig)
        assert one("1003").startswith("5003")
        assert [one("22f186"), two("22f186"), can.ask("22f186").hex()] == ["62f18603", "62f18601", "62f18601"]
        assert one("2701").startswith("6701")
        assert two("2701") == "7f277f"
        one.close()
        assert made.tester()("22f186") == "62f18601", "the next one with this address begins again"


def test_what_a_tester_switched_off_is_on_when_he_is_gone(doip):
    one = doip.tester()
    one("1003")
    assert one("8502") == "c502"
    assert not doip.rig.gateway.controls.monitoring
    assert doip.rig.gateway.controls.off_by == ["doip 192.0.2.1:E00"]
    one.close()
    assert doip.rig.gateway.controls.monitoring
    found = [(i.protocol, i.bus, i.address, i.action) for i in doip.rig.gateway.memory.interventions()]
    assert found[0] == ("uds", "doip 192.0.2.1", TESTER, "dtc_setting")
    assert found[1][1:] == ("doip 192.0.2.1", TESTER, "dtc_setting_ended")


def test_a_session_ends_by_s3_and_a_condition_that_is_unmet_ends_what_it_let(tmp_path):
    with net(tmp_path, more=STANDS) as made:
        one = made.tester()
        one("1003")
        assert one("8502") == "7f8522"
        made.rig.value(1, 0.0)
        assert one("8502") == "c502"
        made.rig.value(1, 50.0)
        made.wait(0.2)
        assert made.rig.gateway.controls.monitoring
        made.wait(5.1)
        assert one("22f186") == "62f18601"


@pytest.mark.evidence("ISO 13400-2: 8001")
def test_the_same_requests_get_the_same_answers_by_can_and_by_doip(tmp_path):
    """Of two gateways, one asked by CAN and one by IP: session, key, condition and request at random."""
    seed = int(os.environ.get("GATEWAY_SEED", "51"))
    print("seed", seed)
    draw, refused = random.Random(seed), set()
    (tmp_path / "can").mkdir()
    with net(tmp_path, uds=LEVEL, more=STANDS) as by_ip, net(tmp_path / "can", uds=LEVEL, more=STANDS) as by_can:
        one, can = by_ip.tester(), Asked(by_can.rig)
        for _ in range(amount(3000, 300)):
            speed = draw.choice((0.0, 50.0))
            request = draw.choice(REQUESTS)
            for each in (by_ip, by_can):
                each.rig.wait((max(by_ip.rig.now, by_can.rig.now) - each.rig.now) / MS + 1, step=5)
                each.rig.value(1, speed)
            if request == "27":
                answers = [unlocked(ask) for ask in (one, can)]
            elif draw.random() < 0.2:
                answers = [" ".join(one.uds(request, target=FUNCTIONAL)[2]), can(request, functional=CAN_FUNCTIONAL)]
            else:
                answers = [one(request), can(request)]
            assert answers[0] == answers[1], request
            refused.add(answers[0][4:6] if answers[0].startswith("7f") else "done")
        assert {"done", "22", "33", "7f"} <= refused
        noted = [  # those alike in a row are one; a functional request has another identifier by CAN
            [
                (i.action, i.outcome, i.session)
                for i in each.rig.gateway.memory.interventions()
                if not i.action.endswith("_ended")  # with time, which is not the same to the millisecond
                for _ in range(i.count)
            ]
            for each in (by_ip, by_can)
        ]
        assert noted[0][-60:] == noted[1][-60:]


def unlocked(ask):
    """Unlock level 1 if that is possible now; returns what came of it."""
    seed = ask("2701")
    if seed.startswith("7f") or not int(seed[4:], 16):
        return seed
    return ask("2702" + hmac_sha256(bytes.fromhex(seed[4:]), bytes.fromhex(SECRET), 1).hex())


@pytest.mark.evidence("ISO 14229-1: 0x27 all")
def test_wrong_keys_count_for_all_transports(tmp_path):
    with net(tmp_path, uds=LEVEL) as made:
        for k in range(3):
            one = made.tester(TESTER + k)
            one("1003")
            one("2701")
            assert one("2702" + "00" * 8) == ("7f2736" if k == 2 else "7f2735")
        can = Tester(made.rig)
        can.ask("1003")
        assert can.ask("2701").hex() == "7f2737"


# Headers


@pytest.mark.evidence("ISO 13400-2: 0000 00", "ISO 13400-2: 0000 01", "ISO 13400-2: 0000 02", "ISO 13400-2: 0000 04")
def test_each_refusal_of_a_header(doip):
    for wrong, code, closes in (
        (message(5, bytes(7), version=4), 0, True),
        (b"\x03\xfd\x00\x05\x00\x00\x00\x07" + bytes(7), 0, True),
        (message(0x1234, bytes(9)), 1, False),
        (message(1), 1, False),
        (message(0x8001, length=65537), 2, False),
        (message(5, bytes(8)), 4, True),
        (message(0x8001, bytes(4)), 4, True),
        (message(8, bytes(3)), 4, True),
    ):
        one = doip.peer()
        one.send(wrong)
        assert one.take() == [(0, bytes([code]))], wrong
        assert one.closed == closes
    assert doip.rig.gateway.servers.counters()["doip_header_refused"] == 8


@pytest.mark.evidence("ISO 13400-2: 0000 02")
def test_what_is_too_large_is_passed_over_and_the_next_message_is_taken(doip):
    one = doip.peer()
    one.send(
        message(0x8001, bytes(100_000)) + message(0x7777, bytes(3)) + message(5, struct.pack(">HBI", TESTER, 0, 0))
    )
    assert one.take() == [(0, b"\x02"), (0, b"\x01"), (6, struct.pack(">HHBI", TESTER, GATEWAY, 0x10, 0))]


@pytest.mark.evidence("ISO 13400-2: 0000 03")
def test_unfinished_messages_of_all_testers_have_one_room(doip):
    testers = [doip.tester(TESTER + k) for k in range(3)]
    address = struct.pack(">HH", TESTER, GATEWAY)
    for one in testers:
        one.send(message(0x8001, address, length=65536))
    assert [one.take() for one in testers] == [[], [], [(0, b"\x03")]]
    assert doip.tester(TESTER + 3)("3e00") == "7e00", "short ones always have room"
    testers[0].close()
    testers[2].send(bytes(65532))  # the rest, which is passed over
    assert testers[2].uds("3e00") == (0x8002, 0, ["7e00"])


@pytest.mark.evidence("ISO 13400-2: stream")
def test_a_stream_may_come_byte_by_byte(doip):
    whole = message(5, struct.pack(">HBI", TESTER, 0, 0)) + message(
        0x8001, struct.pack(">HH", TESTER, GATEWAY) + b"\x3e\x00"
    )
    one = doip.peer()
    for k in range(len(whole)):
        one.send(whole[k : k + 1])
    assert [kind for kind, _ in one.take()] == [6, 0x8002, 0x8001]


def test_many_messages_at_once_are_taken_a_few_a_turn(doip):
    one = doip.tester()
    one.send(message(0x8001, struct.pack(">HH", TESTER, GATEWAY) + b"\x3e\x00") * 100)
    assert len(one.take()) == 32
    assert not one.one.hungry
    doip.wait(0.01)
    assert len(one.take()) > 100
    assert one.one.hungry


# Timers and bounds


@pytest.mark.evidence("ISO 13400-2: T_TCP_General")
def test_inactivity(doip):
    silent, one = doip.peer(), doip.tester()
    doip.wait(1.8)
    assert not silent.closed
    doip.wait(0.3)
    assert silent.closed
    doip.wait(290)
    assert one("3e00") == "7e00"
    doip.wait(299)
    assert not one.closed
    doip.wait(2)
    assert one.closed


@pytest.mark.evidence("ISO 13400-2: T_TCP_Initial")
def test_who_only_asks_to_be_activated_is_closed_in_time(doip):
    one = doip.peer()
    for _ in range(5):
        doip.wait(0.45)
        one.send(message(0x7777))
    assert one.closed


def test_half_open_connections_give_way_to_new_ones(doip):
    """Those of the address that has most of them do: who floods the door keeps nobody else out."""
    one, elsewhere = doip.tester(), doip.peer(ip="192.0.2.2")
    waiting = [doip.peer() for _ in range(1000)]
    assert sum(not each.closed for each in waiting) == UNACTIVATED - 1
    assert elsewhere.activate(TESTER + 2) == 0x10
    assert one("3e00") == "7e00"
    assert doip.tester(TESTER + 1)("3e00") == "7e00"


def test_a_slow_reader_is_not_served_and_holds_nobody_up(tmp_path):
    many = f'[[did]]\nid = 0x2000\nname = "big"\nhex = "{"ab" * 4000}"\n'
    with net(tmp_path, more=many) as made:
        slow, other = made.tester(), made.tester(TESTER + 1)
        request = message(0x8001, struct.pack(">HH", TESTER, GATEWAY) + b"\x22\x20\x00")
        for _ in range(20):
            slow.send(request * 16)
            made.wait(0.05)
        assert ENOUGH_BYTES <= len(slow.one.out) < ENOUGH_BYTES + 5000
        assert not slow.one.hungry
        assert made.rig.gateway.next_ns > made.rig.now, "and the loop does not turn for nothing"
        assert other("3e00") == "7e00"
        assert made.peer().activate(TESTER) is None
        made.wait(0.6)
        assert slow.closed, "it keeps its place from nobody"
        slow = made.tester(TESTER + 2)
        slow.one.out += bytes(MOST_BYTES)
        slow.one.server.on_changes = lambda changes, t_ns: [b"\xc6"]
        made.server.on_changes([None], made.rig.now)
        assert slow.closed
        assert made.rig.gateway.servers.counters()["doip_sent_away"] == 1


# Fuzz


@pytest.mark.evidence("ISO 13400-2: mutants")
def test_mutated_streams(tmp_path):
    """Whatever comes, the next tester is served as before, and nothing is left of it."""
    seed = int(os.environ.get("GATEWAY_SEED", "51"))
    print("seed", seed)
    draw = random.Random(seed)
    with net(tmp_path) as made:
        for _ in range(amount(100_000, 1_000)):
            one = Peer(made)
            data = bytearray(good_stream(draw))
            for _ in range(draw.randint(0, 4)):
                mutate(draw, data)
            while data:
                size = draw.choice([1, 7, 8, 40, 10_000])
                one.send(bytes(data[:size]))
                del data[:size]
            assert len(one.one.out) < 1 << 20
            cut(bytes(one.one.out))
            one.close()
        assert made.server.connections == []
        assert len(made.server.counts) < 12
        left = made.rig.gateway
        assert left.controls.monitoring
        assert left.authority.lasting() == []
        assert len(left.authority._holders) == 1, "that of CAN"
        assert made.tester()("22f190") == "62f190" + VIN.hex()


def good_stream(draw):
    made = message(5, struct.pack(">HBI", TESTER, 0, 0), version=draw.choice((2, 3)))
    for _ in range(draw.randint(0, 5)):
        request = bytes([draw.choice((0x10, 0x11, 0x14, 0x19, 0x22, 0x27, 0x2E, 0x31, 0x3E, 0x85))]) + draw.randbytes(3)
        target = draw.choice((GATEWAY, FUNCTIONAL, 5))
        made += message(draw.choice((0x8001, 0x8001, 7, 8)), struct.pack(">HH", TESTER, target) + request)
    return made


# Configurations


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("address = 0x0E05", "0x0E05"),
        ('bind = ["localhost"]', "localhost"),
        ('bind = ["0.0.0.0"]\nannounce = ["192.0.2.255"]', "announce"),
        ('announce = ["239.1.1.1"]', "announce"),
        ('[[output.doip.tester]]\naddress = 0x0E10\ncertificate = "x"', "client_ca"),
        ('vin = "SHORT"', "vin"),
        ("adress = 1", "adress"),
    ],
)
def test_wrong_settings_are_named(tmp_path, text, key):
    with pytest.raises(InputErrors, match=key):
        load_config(write_config(tmp_path, extra="[output.uds]\n[output.doip]\n" + text))


def test_it_needs_the_services_of_uds(tmp_path):
    with pytest.raises(InputErrors, match=r"output\.uds"):
        load_config(write_config(tmp_path, extra="[output.doip]\n"))
