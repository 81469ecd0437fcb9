"""The wire as Wireshark reads it: dissectors of ISO-TP, UDS, OBD-II and J1939 that nobody here wrote.

A long session of all servers is recorded in process. No packet may be malformed, and what the dissectors say of each
message is what was asked and answered.
"""

import random
from collections import Counter

import pytest
from amount import amount
from grammar import CONFIG, MESSAGES, Grammar, Traffic
from recorded_wire import Wire, dissect, write_pcap
from rig import REQUEST, RESPONSE, Tester, write_config
from test_authentication import a_tester, certificates, field, signed
from test_j1939 import coded, pgn_id
from uds_tester import DIDS, hexed

from gateway.servers.uds.security import hmac_sha256
from gateway.servers.uds.services import SERVICES

#: OBD has an address of its own here: tshark reads all of an address by one dissector.
UDS_IDS, OBD_IDS = (0x7E0, 0x7E8, 0x7DE), (0x7E2, 0x7EA, 0x7DF)
UDS_FUNCTIONAL, OBD_FUNCTIONAL = 0x7DE, 0x7DF
ADDRESS, TOOL = 0x80, 0xF9
SECRET = "00112233"
VIN = "1HGCM82633A004352"
SERVERS = f"""
[output.uds]
functional = 0x7DE
security = [{{ level = 1, secret = "{SECRET}" }}]
authentication = {{ roots = ["root.pem"], roles = ["workshop"] }}
[access]
clear = {{ sessions = ["extended"] }}
[usage]
running = [{{ signal = "M0.Value", min = 400.0 }}]
denominator = [{{ signal = "M0.Value", min = 400.0 }}]
[output.obd]
request = 0x7E2
response = 0x7EA
vin = "{VIN}"
calibration = "GW-1"
calibration_check = 0x1234ABCD
ecu_name = "GATEWAY"
pid = [{{ id = 0x0C, signal = "M0.Value" }}, {{ id = 0x05, signal = "M1.Value" }}, {{ id = 0x0D, signal = "M2.Value" }}]
[output.j1939]
address = {ADDRESS}
vin = "{VIN}"
calibration = "GW-1"
component = {{ make = "ACME", model = "GW", serial = "42" }}
"""
FAULTS = {
    k: coded(100 + k, 1, 'indicator = true\nemission_related = true\nfreeze_frame = ["M0.Value"]\n') for k in range(6)
}
PROBLEMS = ("_ws.malformed", "iso15765.fragment.error", "iso15765.message_type.bad")


class Talk(Tester):
    """A tester that keeps what it asked and what it got, in order."""

    def __init__(self, rig, **options):
        super().__init__(rig, **options)
        self.asked, self.answered = [], []

    def __call__(self, request, **options):
        request = bytes.fromhex(request)
        self.asked.append(request)
        answers = self.exchange(request, **options)
        self.answered += answers
        return answers[0] if answers else b""


def read_everything(talk):
    """Every sub-function of 0x19, identifiers, sessions."""
    one = hexed(0)
    for request in (
        "1901ff", "1902ff", "1903", f"1904{one}01", "190501", f"1906{one}ff", "1907ffff", "1908ffff", f"1909{one}",
        "190a", "190b", "190c", "190d", "190e", "1914", "1915", "190f", "1916ff", "1917ff01", "191a01", "194233ffff",
        "195533", "19563303", "22f190", "220123f1900124", "22f186", "22fd10", "22f40c", "22f802", "22ffff", "3e00",
        "2703",
    ):  # fmt: skip
        assert talk(request)
    talk("3e80", functional=UDS_FUNCTIONAL)
    talk("22f190", functional=UDS_FUNCTIONAL)
    talk("2212ff", functional=UDS_FUNCTIONAL)  # nobody is meant: no answer


def intervene(talk):
    """Every service that changes something, refused and done."""
    for request in ("1101", "14ffffff", "280101", "2e01240a0b", "31010201", "8502", "7777", "2701", "860102"):
        assert talk(request)
    assert talk("1003")
    assert talk("2e01240a0b")[2] == 0x33
    assert talk("2702" + "00" * 32)[2] in (0x24, 0x35)
    seed = talk("2701")[2:]
    assert talk("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == b"\x67\x02"
    key, certificate = a_tester()
    ours = talk("290100" + field(certificate) + field(b"mine"), patience=300)[5:37]
    assert talk("2903" + field(signed(key, ours + b"mine")) + field(b""), patience=300)[:2] == b"\x69\x03"
    for request in ("2908", "86010208190208", "860502", "860602", "2e01240a0b", "280101", "280001", "8502", "8501"):
        assert talk(request)[0] != 0x7F, request
    for request in ("31010202", "31030202", "31010201", "14" + hexed(1), "2900", "1001", "1003", "14ffffff", "1101"):
        assert talk(request), request


def read_obd(talk):
    for request in ("0100", "0101", "010c", "0105", "010d", "010c050d", "020200", "020c00", "03", "07", "0a", "0600",
                    "06e1", "0900", "0902", "0904", "0908", "0906", "090a", "04"):  # fmt: skip
        assert talk(request, functional=OBD_FUNCTIONAL), request
        assert talk(request), request
    assert not talk("01ff", functional=OBD_FUNCTIONAL)
    assert talk("01ff")[0] == 0x7F


def read_j1939(rig, groups):
    for pgn in groups:
        rig.feed((pgn_id(0xEA00, source=TOOL, destination=0xFF), pgn.to_bytes(3, "little")))
        rig.wait(700)
    answers = rig.feed((pgn_id(0xEA00, source=TOOL, destination=ADDRESS), (0xFECA).to_bytes(3, "little")))
    assert answers[0][1][0] == 16, "request to send"
    cts = bytes([17, answers[0][1][3], 1, 0xFF, 0xFF]) + (0xFECA).to_bytes(3, "little")
    rig.feed((pgn_id(0xEC00, source=TOOL, destination=ADDRESS), cts))
    end = bytes([19, *answers[0][1][1:4], 0xFF]) + (0xFECA).to_bytes(3, "little")
    rig.feed((pgn_id(0xEC00, source=TOOL, destination=ADDRESS), end))
    for pgn in (0xFE00, 0xFED3):  # there is none; clearing
        rig.feed((pgn_id(0xEA00, source=TOOL, destination=ADDRESS), pgn.to_bytes(3, "little")))
        rig.wait(50)


#: DM1, 2, 5, 6, 12, 19, 20, 21, 24, 25, 26, 28, 29; component, software, vehicle identification; the claim.
GROUPS = (
    0xFECA, 0xFECB, 0xFECE, 0xFECF, 0xFED4, 0xD300, 0xC200, 0xC100, 0xFDB6, 0xFDB7, 0xFDB8, 0xFD80, 0x9E00, 0xFEEB,
    0xFEDA, 0xFEEC, 0xEE00,
)  # fmt: skip
#: Of these come by the transport protocol here.
LONG = (0xFECA, 0xFECF, 0xFED4, 0xD300, 0xC200, 0xFDB7, 0xFD80, 0xFEEB, 0xFEDA, 0xFEEC)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Return the recording of a session, and what its testers said and got."""
    folder = tmp_path_factory.mktemp("wire")
    certificates(folder)
    rig = Wire(write_config(folder, 6, extra=SERVERS + DIDS, faults=FAULTS))
    uds, obd = Talk(rig), Talk(rig, request=0x7E2, response=0x7EA)
    rig.wait(300)
    for k in range(6):
        rig.value(k, 100.0 + k)
        rig.fail(k)
    rig.value(0, 812.5)
    rig.wait(200)
    read_everything(uds)
    read_j1939(rig, GROUPS)
    for k in range(6):
        rig.fail(k)
    rig.value(0, 812.5)
    rig.value(1, 90)
    rig.value(2, 50)
    read_obd(obd)
    intervene(uds)
    write_pcap(rig.frames, folder / "session.pcap")
    rig.close()
    return folder / "session.pcap", uds, obd


def one(row, name):
    (text,) = row[name]
    return int(text, 0)


@pytest.mark.evidence("ISO 14229-1: others tshark")
def test_nothing_is_malformed(session):
    pcap, _, _ = session
    for dissector, identifiers in (("uds", UDS_IDS), ("obd-ii", OBD_IDS)):
        rows = dissect(pcap, dissector, identifiers, ["frame.number", "frame.protocols", *PROBLEMS])
        wrong = [row for row in rows if any(row[name] for name in PROBLEMS)]
        assert wrong == []
        seen = Counter(row["frame.protocols"][0].rpartition(":")[2] for row in rows)
        assert seen[dissector] > 40
        assert seen["j1939"] > 100


def test_what_is_malformed_would_be_seen(tmp_path):
    cut = [(0, 0x7E8, 0, bytes.fromhex("0262f1cccccccccc")), (1, 0x7E8, 0, bytes.fromhex("f0cccccccccccccc"))]
    write_pcap(cut, tmp_path / "cut.pcap")
    first, second = dissect(tmp_path / "cut.pcap", "uds", UDS_IDS, list(PROBLEMS))
    assert first["_ws.malformed"]
    assert second["iso15765.message_type.bad"]


@pytest.mark.evidence("ISO 14229-1: others tshark")
def test_uds_is_read_as_it_was_meant(session):
    pcap, uds, _ = session
    fields = ["can.id", "uds.sid", "uds.reply", "uds.err.sid", "uds.err.code", "uds.rdbi.data_identifier",
              "uds.rdbi.data_record", "uds.rdtci.type", "uds.rdtci.record", "uds.sa.seed"]  # fmt: skip
    rows = dissect(pcap, "uds", UDS_IDS, fields, only="uds")
    asked = [row for row in rows if one(row, "can.id") != 0x7E8]
    answered = [row for row in rows if one(row, "can.id") == 0x7E8]
    assert [one(row, "uds.sid") for row in asked] == [request[0] & 0xBF for request in uds.asked]
    assert {one(row, "uds.sid") for row in asked} >= set(SERVICES), "each service that there is"
    assert [one(row, "uds.sid") for row in answered] == [answer[0] & 0xBF for answer in uds.answered]
    compared = Counter()
    for row, answer in zip(answered, uds.answered, strict=True):
        assert one(row, "uds.reply") == 1
        if answer[0] == 0x7F:
            assert (one(row, "uds.err.sid"), one(row, "uds.err.code")) == (answer[1], answer[2])
        elif answer[0] == 0x59:
            assert one(row, "uds.rdtci.type") == answer[1]
            assert row["uds.rdtci.record"] == ([answer[2:].hex()] if len(answer) > 2 else [])
        elif answer[0] == 0x62 and len(answer) < 64:
            assert one(row, "uds.rdbi.data_identifier") == int.from_bytes(answer[1:3], "big")
            assert row["uds.rdbi.data_record"] == [answer[3:].hex()]
        elif answer[:2] == b"\x67\x01":
            assert row["uds.sa.seed"] == [answer[2:].hex()]
        else:
            continue
        compared[answer[0]] += 1
    assert compared[0x59] > 20
    assert compared[0x62] > 5
    assert compared[0x67] == 1
    assert compared[0x7F] > 10


@pytest.mark.evidence("SAE J1979: others")
def test_obd_is_read_as_it_was_meant(session):
    """This dissector knows requests to all only, and values of one PID in an answer; we ask both ways."""
    pcap, _, obd = session
    values = ("obd-ii.mode01_engine_rpm", "obd-ii.mode01_engine_coolant_temp", "obd-ii.mode01_vehicle_speed",
              "obd-ii.VIN", "obd-ii.ecu_name")  # fmt: skip
    more = ("obd-ii.mode", "obd-ii.mode01_supported_pid")
    rows = dissect(pcap, "obd-ii", OBD_IDS, ["can.id", *more, *values], only="obd-ii")
    answered = [row for row in rows if one(row, "can.id") == 0x7EA]
    assert [one(row, "obd-ii.mode") for row in answered] == [answer[0] & 0xBF for answer in obd.answered]
    seen = {name: {text.rstrip("\0") for row in answered for text in row[name]} for name in values}
    assert seen == dict(zip(values, ({"812.5"}, {"90"}, {"50"}, {VIN}, {"GATEWAY"}), strict=True))
    supported = next(row for row in answered if row["obd-ii.mode01_supported_pid"])
    assert [int(text, 16) for text in supported["obd-ii.mode01_supported_pid"]] == [0x01, 0x05, 0x0C, 0x0D, 0x1C, 0x20]


@pytest.mark.evidence("SAE J1939-73: others")
def test_j1939_is_read_as_it_was_meant(session):
    pcap, _, _ = session
    rows = dissect(pcap, "uds", UDS_IDS, ["j1939.pgn", "j1939.src_addr", "j1939.data"], only="j1939")
    assert {one(row, "j1939.src_addr") for row in rows} == {ADDRESS, TOOL}
    ours = Counter(one(row, "j1939.pgn") for row in rows if one(row, "j1939.src_addr") == ADDRESS)
    single = {pgn for pgn in GROUPS if pgn not in LONG}
    assert ours.keys() >= single | {0xEC00, 0xEB00, 0xE800}
    announced = {
        int.from_bytes(bytes.fromhex(text)[5:8], "little")
        for row in rows
        for text in row["j1939.data"]
        if one(row, "j1939.pgn") == 0xEC00 and text[:2] in ("20", "10")
    }
    assert announced == set(LONG)


@pytest.mark.evidence("ISO 15765-2: others")
def test_can_fd_is_read_too(tmp_path):
    rig = Wire(write_config(tmp_path, 6, extra=f"[output.uds]\nfd = true\n{DIDS}"))
    talk = Talk(rig, can_fd=True, tx_data_length=64)
    for k in range(6):
        rig.fail(k)
    for request in ("1902ff", "22f190", "22f190012301240123f190f190f190", "1003", "190a", "7777"):
        assert talk(request)
    write_pcap(rig.frames, tmp_path / "fd.pcap")
    rig.close()
    rows = dissect(tmp_path / "fd.pcap", "uds", UDS_IDS, ["can.id", "uds.sid", "frame.len", *PROBLEMS], only="iso15765")
    assert not [row for row in rows if any(row[name] for name in PROBLEMS)]
    assert max(one(row, "frame.len") for row in rows) == 72
    answered = [one(row, "uds.sid") for row in rows if row["uds.sid"] and one(row, "can.id") == RESPONSE]
    assert answered == [answer[0] & 0xBF for answer in talk.answered]


@pytest.mark.long
def test_whatever_is_asked_no_answer_is_malformed(tmp_path):
    """Requests of a grammar, one in ten broken on purpose: what comes back is well-formed all the same."""
    seed = 82
    print(f"seed {seed}")
    rng = random.Random(seed)
    rig = Wire(write_config(tmp_path, MESSAGES, extra=CONFIG))
    traffic, grammar = Traffic(rig, rng), Grammar(rng)
    rig.wait(300)
    for n in range(amount(20_000, 1000, 100)):
        if n % 7 == 0:
            rig.feed(grammar.noise())
        else:
            traffic.ask(grammar.request(), rng.choice((REQUEST, 0x7E4)))
        if n % 50 == 0:
            rig.fail(rng.randrange(MESSAGES))
        traffic.settle()
    write_pcap(rig.frames, tmp_path / "grammar.pcap")
    rig.close()
    answers = (RESPONSE, 0x7EC)
    rows = dissect(tmp_path / "grammar.pcap", "uds", (REQUEST, 0x7E4, *answers), ["can.id", "uds.sid", *PROBLEMS])
    ours = [row for row in rows if one(row, "can.id") in answers]
    assert [row for row in ours if row["_ws.malformed"] or row["iso15765.message_type.bad"]] == []
    assert len({one(row, "uds.sid") for row in ours if row["uds.sid"]}) > 12
