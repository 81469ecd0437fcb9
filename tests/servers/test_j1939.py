"""J1939 diagnostic messages; bytes from a real truck's log, and from SAE J1939-73 by hand."""

import struct
from itertools import pairwise

import j1939
import pytest
from rig import MS, Rig, write_config

from gateway.bus.frames import EXTENDED
from gateway_testers.j1939.claim import NameParams
from gateway_testers.j1939.server import J1939Server

ME, TOOL, ALL = 0x00, 0xF9, 0xFF

#: The truck's four DTCs: message -> SPN, FMI, occurrences.
TRUCK = {0: (980, 9, 126), 1: (3216, 20, 2), 2: (609, 9, 1), 3: (609, 12, 3)}
TRUCK_DM1 = bytes.fromhex("43FF D4030 97E 900C1402 61020901 61020C03".replace(" ", ""))

EXTRA = """
[output.j1939]
address = 0
{more}
"""
LAMPS = 'lamps = ["malfunction", "stop", "warning"]\n'


def coded(spn, fmi, more=""):
    return f"spn = {spn}\nfmi = {fmi}\n{more}"


def pgn_id(pgn, source=TOOL, destination=ALL, priority=6):
    number = priority << 26 | pgn << 8 | source
    if (pgn >> 8) & 0xFF < 240:
        number |= destination << 8
    return number | EXTENDED


class Heard(list):
    """Frames, and the messages that were whole with them: (pgn, destination, data)."""

    def __init__(self, frames, messages):
        super().__init__(frames)
        self.messages = messages

    def __add__(self, other):
        return Heard([*self, *other], self.messages + other.messages)


def j1939_of(rig):
    return next(each for each in rig.gateway.servers.all if isinstance(each, J1939Server))


class Bus(Rig):
    """What a J1939 tool sees: whole messages, transport sessions put together by hand."""

    def __init__(self, config, memory=None):
        self.open = {}
        super().__init__(config, memory)

    def _keep(self, made):
        frames = super()._keep(made)
        return Heard(frames, self.join([frame for frame in frames if frame[0] & EXTENDED]))

    def messages(self, frames):
        return frames.messages

    def join(self, frames):
        made = []
        for can_id, data in frames:
            pgn = can_id >> 8 & 0x3FFFF
            destination = ALL
            if (pgn >> 8) & 0xFF < 240:
                destination, pgn = pgn & 0xFF, pgn & 0x3FF00
            if pgn == 0xEC00 and data[0] in (16, 32):
                size, count = struct.unpack_from("<HB", data, 1)
                self.open[destination] = [int.from_bytes(data[5:8], "little"), size, count, b""]
            elif pgn == 0xEB00:
                session = self.open[destination]  # a packet without its announcement is an error
                session[3] = session[3][: 7 * (data[0] - 1)] + data[1:]
                assert data[0] * 7 == len(session[3]), "packets in order"
                if data[0] == session[2]:
                    made.append((session[0], destination, session[3][: session[1]]))
            elif pgn != 0xEC00:
                made.append((pgn, destination, data))
        return made

    def of(self, pgn, frames):
        return [data for group, _, data in self.messages(frames) if group == pgn]

    def request(self, pgn, destination=ME, milliseconds=0):
        asked = self.feed((pgn_id(0xEA00, destination=destination), pgn.to_bytes(3, "little")))
        return asked + self.wait(milliseconds) if milliseconds else asked


@pytest.fixture
def make(tmp_path):
    rigs = []

    def build(messages=4, more="", faults=None, claimed=True, extra=""):
        path = write_config(tmp_path, messages, extra=EXTRA.format(more=more) + extra, faults=faults or {})
        rigs.append(Bus(path))
        if claimed:
            rigs[-1].wait(300)
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.close()


def truck(make):
    faults = {k: coded(spn, fmi, "indicator = true\n" if k == 0 else "") for k, (spn, fmi, _) in TRUCK.items()}
    rig = make(more=LAMPS, faults=faults)
    for k, (_, _, occurrences) in TRUCK.items():
        for n in range(occurrences):
            if n:
                rig.heal(k)
            rig.fail(k)
    return rig


@pytest.mark.evidence("SAE J1939-73: DM1")
def test_the_trucks_dm1_byte_for_byte(make):
    rig = truck(make)
    rig.wait(2000)
    frames = rig.wait(3000)
    sent = rig.of(0xFECA, frames)
    assert set(sent) == {TRUCK_DM1}
    assert len(TRUCK_DM1) == 18
    assert len(sent) == 3, "once a second"
    # And as another library receives it, transport and all.
    heard = []
    ecu = j1939.ElectronicControlUnit(send_message=lambda *_: None)
    dm1 = j1939.Dm1(ecu.add_ca(name=j1939.Name(identity_number=7), device_address=TOOL))
    dm1.subscribe(lambda source, lamps, dtcs, t: heard.append((source, lamps, dtcs)))
    for can_id, data in frames:
        ecu.notify(can_id & 0x1FFFFFFF, bytearray(data), 0.0)
    ecu.stop()
    source, lamps, dtcs = heard[-1]
    assert (source, lamps["mil"], lamps["rsl"]) == (ME, j1939.DtcLamp.ON, j1939.DtcLamp.OFF)
    assert [(d["spn"], d["fmi"], d["oc"]) for d in dtcs] == list(TRUCK.values())


@pytest.mark.evidence("SAE J1939-21: BAM")
def test_a_broadcast_keeps_its_gaps(make):
    rig = truck(make)
    rig.wait(2000)
    times = []
    for _ in range(1500):
        times += [(rig.now, can_id >> 16 & 0xFF) for can_id, _ in rig.wait(1, step=1)]
    begin = [page for _, page in times].index(0xEC)
    message = times[begin : begin + 4]
    assert [page for _, page in message] == [0xEC, 0xEB, 0xEB, 0xEB]
    gaps = [b - a for (a, _), (b, _) in pairwise(message)]
    assert all(50 * MS <= gap <= 60 * MS for gap in gaps)


@pytest.mark.evidence("SAE J1939-73: DM1 empty")
def test_the_all_clear_form_and_a_single_dtc(make):
    rig = make(faults={0: coded(91, 3)})
    assert rig.of(0xFECA, rig.wait(1100)) == [bytes.fromhex("00FF00000000FFFF")]
    rig.fail(0)
    assert rig.of(0xFECA, rig.wait(1100))[-1] == bytes.fromhex("00FF5B000301FFFF")


@pytest.mark.evidence("SAE J1939-73: DM1 count")
def test_occurrences_stop_at_126(make):
    rig = make(faults={0: coded(91, 3)})
    for _ in range(130):
        rig.fail(0)
        rig.heal(0)
    rig.fail(0)
    assert rig.of(0xFECA, rig.wait(1100))[-1] == bytes.fromhex("00FF5B00037EFFFF")


@pytest.mark.evidence("SAE J1939-73: DM1 lamps", "AUTOSAR DEM: indicators")
def test_lamps(make):
    faults = {
        k: coded(100 + k, 1, f'indicator = true\nlamp = "{lamp}"\n')
        for k, lamp in enumerate(("malfunction", "stop", "warning", "protect"))
    }
    rig = make(faults=faults)
    expected = 0
    for k, bits in enumerate((0x40, 0x10, 0x04, 0x01)):
        rig.fail(k)
        expected |= bits
        assert rig.of(0xFECA, rig.wait(1500))[-1][0] == expected


@pytest.mark.evidence("SAE J1939-73: DM1 rate")
def test_a_change_is_told_at_once_and_at_most_once_a_second(make):
    rig = make(faults={0: coded(91, 3)}, more="when_clear = false\n")
    assert rig.of(0xFECA, rig.wait(1500)) == []
    begun = rig.now
    assert rig.of(0xFECA, rig.fail(0)) == [bytes.fromhex("00FF5B000301FFFF")]
    assert rig.now == begun + 2 * MS
    told = []
    for _ in range(8):
        told += rig.of(0xFECA, rig.heal(0) + rig.fail(0))
    assert rig.now - begun < 1000 * MS
    assert len(told) <= 1, "it chatters, and DM1 does not"
    rig.heal(0)
    assert rig.of(0xFECA, rig.wait(1500))[-1] == bytes.fromhex("00FF00000000FFFF")
    assert rig.of(0xFECA, rig.wait(3000)) == [], "nothing is active any more"


@pytest.mark.evidence("SAE J1939-73: DM2", "SAE J1939-73: DM6", "SAE J1939-73: DM12", "SAE J1939-73: DM28")
def test_dm2_dm6_dm12_and_dm28(make):
    faults = {
        0: coded(100, 1, "indicator = true\n"),
        1: coded(101, 2),
        2: coded(102, 3, "confirm_cycles = 2\n"),
        3: coded(103, 4, "emission_related = false\n"),
    }
    rig = make(faults=faults)
    for k in range(4):
        rig.fail(k)
    rig.heal(1)

    def dtcs(pgn):
        rig.wait(600)  # what is under way still is of before
        data = rig.of(pgn, rig.request(pgn, destination=ALL, milliseconds=600))[-1]
        found = [struct.unpack_from("<HBB", data, at) for at in range(2, len(data) - 3, 4)]
        return [(spn, fmi, count) for spn, fmi, count in found if (spn, fmi) != (0xFFFF, 0xFF) and spn]

    assert dtcs(0xFECA) == [(100, 1, 1), (103, 4, 1)]
    assert dtcs(0xFECB) == [(101, 2, 1)]
    assert dtcs(0xFECF) == [(100, 1, 1), (101, 2, 1), (102, 3, 1), (103, 4, 1)]
    assert dtcs(0xFED4) == [(100, 1, 1)]
    assert dtcs(0xFD80) == [(100, 1, 1)]


@pytest.mark.evidence("SAE J1939-73: DM5")
def test_dm5_counts_and_readiness(make):
    related = "emission_related = true\n"
    faults = dict.fromkeys(range(4), related)
    faults |= {0: coded(100, 1), 1: coded(101, 1, 'readiness = "egr"\n' + related)}
    rig = make(faults=faults)
    rig.fail(0)
    rig.heal(2)
    rig.heal(3)
    assert rig.of(0xFECE, rig.request(0xFECE)) == [bytes.fromhex("0100050480008000")]
    rig.heal(1)
    rig.heal(0)
    assert rig.of(0xFECE, rig.request(0xFECE)) == [bytes.fromhex("0001050480000000")]


@pytest.mark.evidence("SAE J1939-73: DM4")
def test_freeze_frames(make):
    more = (
        'freeze_frame = [{ spn = 190, signal = "M0.Value", length = 2, scale = 0.125 },'
        ' { spn = 84, signal = "M1.Value" }]\n'
    )
    rig = make(faults={0: coded(0x7ABCD, 3)}, more=more)
    assert rig.of(0xFDB6, rig.request(0xFDB6)) == [bytes.fromhex("BE001E02 54001E01")]
    assert rig.of(0xFDB7, rig.request(0xFDB7)) == [bytes.fromhex("0000000000FFFFFF")]
    rig.value(0, 100.0)
    rig.fail(0)
    assert rig.of(0xFDB7, rig.request(0xFDB7)) == [
        bytes([7, 0xCD, 0xAB, 7 << 5 | 3, 1]) + (800).to_bytes(2, "little") + b"\xff"
    ]


@pytest.mark.evidence("SAE J1939-73: DM3", "SAE J1939-73: DM11")
def test_dm3_clears_what_is_no_longer_active_and_dm11_the_rest(make):
    rig = make(faults={0: coded(100, 1), 1: coded(101, 2)})
    rig.fail(0)
    rig.fail(1)
    rig.heal(1)
    ((_, to, data),) = rig.messages(rig.request(0xFECC))
    assert (to, data) == (ALL, bytes([0, 0xFF, 0xFF, 0xFF, TOOL]) + (0xFECC).to_bytes(3, "little"))
    assert (rig.status(0), rig.status(1)) == (0x2F, 0x50)
    assert rig.messages(rig.request(0xFED3, destination=ALL)) == [], "nobody answers for all"
    assert rig.status(0) == 0x50


@pytest.mark.evidence("SAE J1939-73: denied")
def test_clearing_can_be_denied(make):
    rig = make(faults={0: coded(100, 1)}, more="allow_clear = false\n")
    rig.fail(0)
    ((_, _, data),) = rig.messages(rig.request(0xFED3))
    assert data[0] == 2
    assert rig.status(0) == 0x2F


@pytest.mark.evidence("SAE J1939-73: NACK")
def test_requests_for_what_there_is_not(make):
    rig = make()
    ((pgn, _, data),) = rig.messages(rig.request(0xFEE5))
    assert (pgn, data[0], data[4]) == (0xE800, 1, TOOL)
    assert data[5:] == (0xFEE5).to_bytes(3, "little")
    assert rig.request(0xFEE5, destination=ALL) == []
    assert rig.request(0xFECB, destination=0x21) == [], "not for us"


# Transport


def cts(count, first, pgn=0xFECB):
    return bytes([17, count, first, 0xFF, 0xFF]) + pgn.to_bytes(3, "little")


def previous(make, count=5):
    rig = make(count, faults={k: coded(100 + k, 1) for k in range(count)})
    for k in range(count):
        rig.fail(k)
    for k in range(count):
        rig.heal(k)
    return rig


@pytest.mark.evidence("SAE J1939-21: RTS CTS")
def test_a_long_answer_to_one_goes_by_rts_and_cts(make):
    rig = previous(make)
    ((can_id, data),) = rig.request(0xFECB)
    assert can_id == pgn_id(0xEC00, ME, TOOL, 7)
    assert data == bytes([16, 22, 0, 4, 0xFF]) + (0xFECB).to_bytes(3, "little")
    to_me = pgn_id(0xEC00, destination=ME, priority=7)
    first = rig.feed((to_me, cts(2, 1)))
    assert [d[0] for _, d in first] == [1, 2]
    assert rig.feed((to_me, cts(0, 0xFF))) == [], "hold"
    again = rig.feed((to_me, cts(3, 2)))
    assert [d[0] for _, d in again] == [2, 3, 4], "sent again from where the receiver wants"
    whole = (first[0][1][1:] + b"".join(d[1:] for _, d in again))[:22]
    assert whole[:6] == bytes.fromhex("00FF64000101")
    done = bytes([19, 22, 0, 4, 0xFF]) + (0xFECB).to_bytes(3, "little")
    rig.feed((to_me, done))
    assert j1939_of(rig).endpoint.transport._sending is None


@pytest.mark.evidence("SAE J1939-21: silent receiver")
def test_a_receiver_that_falls_silent_is_given_up(make):
    rig = previous(make)
    rig.request(0xFECB)
    later = [d for can_id, d in rig.wait(1400) if can_id == pgn_id(0xEC00, ME, TOOL, 7)]
    assert later == [bytes([255, 3, 0xFF, 0xFF, 0xFF]) + (0xFECB).to_bytes(3, "little")]
    ((_, data),) = [f for f in rig.request(0xFECB) if f[1][0] == 16]
    assert data[0] == 16, "and may ask again"


@pytest.mark.evidence("SAE J1939-21: receive")
def test_a_long_message_to_us_is_received(make):
    """A request padded to 10 bytes, sent by RTS/CTS: unusual, legal, and answered."""
    rig = make(faults={0: coded(100, 1)})
    to_me = pgn_id(0xEC00, destination=ME, priority=7)
    packet = pgn_id(0xEB00, destination=ME, priority=7)
    body = (0xFECE).to_bytes(3, "little") + bytes(7)
    rts = bytes([16, 10, 0, 2, 0xFF]) + (0xEA00).to_bytes(3, "little")
    ((_, data),) = rig.feed((to_me, rts))
    assert data == cts(2, 1, 0xEA00)
    assert rig.feed((packet, bytes([1]) + body[:7])) == []
    answers = rig.feed((packet, bytes([2]) + body[7:] + bytes([0xFF] * 4)))
    assert answers[0][1] == bytes([19, 10, 0, 2, 0xFF]) + (0xEA00).to_bytes(3, "little")
    assert rig.of(0xFECE, answers)


@pytest.mark.evidence("SAE J1939-21: twice")
def test_a_packet_sent_twice_does_no_harm(make):
    rig = make()
    to_me = pgn_id(0xEC00, destination=ME, priority=7)
    packet = pgn_id(0xEB00, destination=ME, priority=7)
    body = (0xFECE).to_bytes(3, "little") + bytes(11)
    rts = bytes([16, 14, 0, 2, 0xFF]) + (0xEA00).to_bytes(3, "little")
    first = (packet, bytes([1]) + body[:7])
    assert rig.feed((to_me, rts), first, first)[1:] == []
    answers = rig.feed((packet, bytes([2]) + body[7:]))
    assert answers[0][1][0] == 19
    assert rig.of(0xFECE, answers)


def test_a_message_that_still_waits_is_replaced_by_its_successor(make):
    rig = previous(make)
    rig.wait(600)
    for _ in range(3):  # the first begins, the others wait
        rig.request(0xFECB, destination=ALL)
    assert len(rig.of(0xFECB, rig.wait(3000))) == 2


@pytest.mark.evidence("SAE J1939-21: abort")
def test_a_packet_out_of_order_aborts_and_silence_does_too(make):
    rig = make()
    to_me = pgn_id(0xEC00, destination=ME, priority=7)
    packet = pgn_id(0xEB00, destination=ME, priority=7)
    rts = bytes([16, 20, 0, 3, 0xFF]) + (0xEA00).to_bytes(3, "little")
    rig.feed((to_me, rts), (packet, bytes([1]) + bytes(7)))
    ((_, data),) = rig.feed((packet, bytes([3]) + bytes(7)))
    assert data[:2] == bytes([255, 7])
    rig.feed((to_me, rts))
    aborts = [d for can_id, d in rig.wait(1500) if can_id == pgn_id(0xEC00, ME, TOOL, 7)]
    assert [d[:2] for d in aborts] == [bytes([255, 3])]
    assert rig.gateway.summary(1.0)["counters"]["j1939_aborted"] == 2


@pytest.mark.evidence("SAE J1939-21: many senders")
def test_interleaved_broadcasts_of_many_senders_keep_their_bounds(make):
    rig = make()
    bam = bytes([32, 20, 0, 3, 0xFF]) + (0xFECA).to_bytes(3, "little")
    for source in range(1, 200):
        rig.feed((pgn_id(0xEC00, source, ALL, 7), bam))
    assert len(j1939_of(rig).endpoint.transport._receiving) == 64
    rig.wait(1000)
    assert len(j1939_of(rig).endpoint.transport._receiving) == 0


# Address claim


@pytest.mark.evidence("SAE J1939-81: claim")
def test_the_name_and_the_first_claim(make):
    rig = make(claimed=False, more="name = { identity = 5, manufacturer = 0x123, function = 0 }\n")
    name = NameParams(identity=5, manufacturer=0x123, function=0)
    ((can_id, data),) = rig.wait(10)
    assert can_id == pgn_id(0xEE00, ME, ALL)
    assert data == name.value.to_bytes(8, "little") == (5 | 0x123 << 21).to_bytes(8, "little")
    assert rig.wait(200) == [], "nothing is said before the address is ours"
    assert rig.of(0xFECA, rig.wait(100)), "250 ms later DM1 begins"
    assert rig.of(0xEE00, rig.request(0xEE00, destination=ALL)) == [data]


@pytest.mark.evidence("SAE J1939-81: contention")
def test_a_stronger_name_takes_the_address_and_a_weaker_one_does_not(make):
    rig = make()
    weak, strong = b"\xff" * 8, bytes(8)
    assert rig.of(0xEE00, rig.feed((pgn_id(0xEE00, ME), weak))), "defended"
    assert rig.feed((pgn_id(0xEE00, ME), strong)) == []
    ((can_id, _),) = rig.wait(160, step=1)
    assert can_id & 0xFF == 0xFE, "cannot claim: says so from the null address"
    assert rig.wait(3000) == [], "and is silent"


def test_our_own_frames_that_come_back_are_no_other_node(make):
    """From a bridge, a second adapter, an echo without a mark: the address is kept, and nothing is answered twice."""
    rig = make()
    (claim,) = rig.of(0xEE00, rig.request(0xEE00, destination=ALL))
    for _ in range(3):
        assert rig.feed((pgn_id(0xEE00, ME), claim)) == [], "no contention"
    assert rig.of(0xEE00, rig.request(0xEE00, destination=ALL)) == [claim], "the address is kept"
    assert rig.of(0xFECA, rig.wait(1100)), "DM1 goes on"
    mine = (pgn_id(0xEA00, ME, ALL), bytes.fromhex("CAFE00"))
    assert rig.feed(mine) == [], "a request of our own address"
    assert rig.of(0xFECA, rig.request(0xFECA)), "that of another one is answered"


@pytest.mark.evidence("SAE J1939-81: cannot claim")
def test_who_has_no_address_says_so_when_asked(make):
    """D13: to all and to the null address; after a delay that differs from device to device."""
    delays = set()
    for identity in range(4):
        rig = make(more=f"name = {{ identity = {identity + 1}, manufacturer = 1 }}\n")
        rig.feed((pgn_id(0xEE00, ME), bytes(8)))
        rig.wait(200)
        for destination in (ALL, 0xFE):
            begun = rig.now
            assert rig.of(0xEE00, rig.request(0xEE00, destination=destination)) == []
            said = []
            while not said and rig.now - begun < 200 * MS:
                said = rig.wait(1, step=1)
            ((can_id, data),) = said
            assert can_id == pgn_id(0xEE00, 0xFE, ALL)
            assert data[0] == identity + 1
            assert rig.now - begun <= 155 * MS
            delays.add(rig.now - begun)
        assert rig.request(0xFECA, destination=ALL) == [], "nothing else"
    assert len(delays) > 4


def test_a_claim_is_told_while_it_is_contended(make):
    rig = make(claimed=False)
    rig.wait(10)
    assert rig.of(0xEE00, rig.request(0xEE00, destination=ALL)), "in the 250 ms, too"
    assert rig.request(0xFECE) == []


def test_the_contention_at_the_start_is_real_time(make):
    """D13: the first claim was stamped with the engine's start, the next look at the clock was decades later."""
    rig = make(claimed=False)
    server = j1939_of(rig)
    rig.gateway.advance(0)
    now = 1_700_000_000_000 * MS
    sent = []
    for k in range(240):
        sent += list(server.on_time(now + k * MS))
    assert sent == []
    for k in range(240, 300):
        sent += list(server.on_time(now + k * MS))
    assert [int(frame["can_id"]) >> 8 & 0xFFFF for frame in sent] == [0xFECA]


@pytest.mark.evidence("SAE J1939-81: times")
def test_the_contention_counts_from_when_the_claim_has_left(make):
    """D13b: the claim had the engine's time, which was up to 95 ms old when the frame left."""
    rig = make(claimed=False)
    server = j1939_of(rig)
    ((claim),) = rig.gateway.advance(100 * MS)
    assert int(claim["can_id"]) >> 8 & 0xFF00 == 0xEE00
    assert server.next_ns <= 100 * MS + 1, "wants the next look at once"
    left = 195 * MS  # the next look at the clock: only then is it known that the frame has left
    sent = {t: list(server.on_time(t * MS)) for t in range(195, 600)}
    (first, *_) = (t for t, frames in sent.items() if frames)
    assert 250 <= first - left // MS <= 280
    assert int(sent[first][0]["can_id"]) >> 8 & 0xFFFF == 0xFECA


@pytest.mark.evidence("SAE J1939-21: grant")
@pytest.mark.parametrize(("most", "granted"), [(0xFF, [16, 4]), (20, [16, 4]), (8, [8, 8, 4]), (1, [1] * 20)])
def test_a_grant_is_never_more_than_the_sender_can_send(make, most, granted):
    """J1939-21, 5.10.3.1: byte 5 of the RTS, packets that can be sent in response to one CTS."""
    rig = make(faults={0: coded(100, 1)})
    to_me, packet = pgn_id(0xEC00, destination=ME, priority=7), pgn_id(0xEB00, destination=ME, priority=7)
    answers = rig.feed((to_me, bytes([16, 140, 0, 20, most]) + (0xEF00).to_bytes(3, "little")))
    counts, sent = [], 0
    while answers and answers[0][1][0] == 17:
        counts.append(answers[0][1][1])
        assert answers[0][1][2] == sent + 1
        for _ in range(counts[-1]):
            sent += 1
            answers = rig.feed((packet, bytes([sent]) + bytes(7)))
    assert counts == granted
    assert answers[0][1][0] == 19


def test_a_sender_that_can_send_nothing_is_refused(make):
    rig = make()
    rts = bytes([16, 140, 0, 20, 0]) + (0xEF00).to_bytes(3, "little")
    ((_, data),) = rig.feed((pgn_id(0xEC00, destination=ME, priority=7), rts))
    assert (data[0], data[1]) == (255, 2)


NAME = NameParams(identity=5, manufacturer=0x123)


def command(rig, address, name=NAME):
    """Command an address, as a tool does: nine bytes, by broadcast."""
    body = name.value.to_bytes(8, "little") + bytes([address])
    bam = bytes([32, 9, 0, 2, 0xFF]) + (0xFED8).to_bytes(3, "little")
    packets = [bytes([1]) + body[:7], bytes([2]) + body[7:] + bytes([0xFF] * 5)]
    made = rig.feed((pgn_id(0xEC00, TOOL, ALL, 7), bam))
    for data in packets:
        made += rig.feed((pgn_id(0xEB00, TOOL, ALL, 7), data))
    return made


def commandable(make, more="commanded_address = true\n"):
    return make(more=more + "name = { identity = 5, manufacturer = 0x123 }\n")


@pytest.mark.evidence("SAE J1939-81: commanded")
def test_a_commanded_address_is_taken(make):
    rig = commandable(make)
    assert command(rig, 0x42, NameParams(identity=6)) == [], "it is another's NAME"
    ((can_id, data),) = command(rig, 0x42)
    assert can_id == pgn_id(0xEE00, 0x42, ALL)
    assert data == NAME.value.to_bytes(8, "little")
    assert rig.wait(240) == []
    assert {can_id & 0xFF for can_id, _ in rig.wait(1100)} == {0x42}
    (noted,) = rig.gateway.memory.interventions()
    assert (noted.action, noted.address) == ("address", TOOL)


def test_a_commanded_address_brings_back_who_had_none(make):
    rig = commandable(make)
    rig.feed((pgn_id(0xEE00, ME), bytes(8)))
    rig.wait(200)
    assert command(rig, 0x42)
    assert {can_id & 0xFF for can_id, _ in rig.wait(1500)} == {0x42}


@pytest.mark.evidence("SAE J1939-81: commanded")
def test_nobody_commands_an_address_unless_it_is_allowed(make):
    rig = commandable(make, "")
    assert command(rig, 0x42) == []
    assert {can_id & 0xFF for can_id, _ in rig.wait(1100)} == {ME}


@pytest.mark.evidence("SAE J1939-73: identifications")
def test_identifications(make):
    more = (
        'vin = "1HGCM82633A004352"\ncalibration = "GW-1"\ncalibration_check = 0x12345678\n'
        'component = { make = "ACME", model = "GW", serial = "42" }\nsoftware = ["gw 3", "cal 7"]\n'
    )
    rig = make(more=more)
    wanted = {
        0xFEEC: b"1HGCM82633A004352*",
        0xFEEB: b"ACME*GW*42**",
        0xFEDA: b"\x02gw 3*cal 7*",
        0xD300: bytes.fromhex("78563412") + b"GW-1".ljust(16, b"\0"),
    }
    for pgn, data in wanted.items():
        frames = rig.request(pgn, destination=ALL, milliseconds=400)
        assert rig.of(pgn, frames) == [data], hex(pgn)


@pytest.mark.evidence("SAE J1939-73: identifications")
def test_identifications_that_there_are_not(make):
    rig = make()
    for pgn in (0xFEEC, 0xFEEB, 0xD300):
        ((_, _, data),) = rig.messages(rig.request(pgn))
        assert data[0] == 1, "not acknowledged"
    frames = rig.request(0xFEDA, destination=ALL, milliseconds=400)
    ((data,)) = rig.of(0xFEDA, frames)
    assert data.startswith(b"\x01gateway ")


@pytest.mark.evidence("SAE J1939-73: DM26, DM29")
def test_dm26_and_dm29(make):
    mil = "indicator = true\nemission_related = true\n"
    faults = {0: coded(100, 1, mil), 1: coded(101, 2, "confirm_cycles = 2\n"), 2: coded(102, 3, mil)}
    rig = make(faults=faults)
    assert rig.of(0xFDB8, rig.request(0xFDB8)) == [bytes.fromhex("FFFFFF4400000000")]
    assert rig.of(0x9E00, rig.request(0x9E00)) == [bytes.fromhex("0000000000FFFFFF")]
    for k in range(3):
        rig.fail(k)
    assert rig.of(0x9E00, rig.request(0x9E00)) == [bytes.fromhex("0203020002FFFFFF")]
    rig.heal(0)
    rig.heal(2)
    assert rig.of(0xFDB8, rig.request(0xFDB8)) == [bytes.fromhex("FFFFFF0400000000")]
    for _ in range(4):
        rig.cycle(passing=(0,))
    assert rig.of(0x9E00, rig.request(0x9E00))[0][2:4] == bytes([1, 1]), "one lamp is out, its DTC is there still"


def test_a_claim_of_another_address_is_not_ours_to_answer(make):
    rig = make()
    assert rig.feed((pgn_id(0xEE00, 0x21), bytes(8))) == []
    assert {can_id & 0xFF for can_id, _ in rig.wait(1100)} == {ME}


@pytest.mark.evidence("SAE J1939-81: before")
def test_nothing_is_answered_before_the_address_is_ours(make):
    rig = make(claimed=False)
    rig.wait(10)
    assert rig.request(0xFECE) == []
    rig.wait(300)
    assert rig.of(0xFECE, rig.request(0xFECE))


@pytest.mark.evidence("SAE J1939-81: arbitrary")
def test_any_address_will_do_if_it_may(make):
    rig = make(more="name = { any_address = true }\n")
    rig.feed((pgn_id(0xEE00, 128), bytes(8)))
    ((can_id, _),) = rig.feed((pgn_id(0xEE00, ME), bytes(8)))
    assert can_id & 0xFF == 129, "the first that nobody has"
    rig.wait(300)
    sent = rig.wait(1100)
    assert {can_id & 0xFF for can_id, _ in sent} == {129}
