"""The UDS server, asked through can-isotp on the frames' own clock; every answer is read by py-uds too."""

import struct
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rig import FUNCTIONAL, MS, Rig, Tester, dtc_text, write_config
from uds.translator import BASE_TRANSLATOR_2020

from gateway.bus.frames import empty
from gateway.faults.dtc import Dtc
from gateway.outputs.uds.params import SecurityLevel
from gateway.outputs.uds.security import Security, hmac_sha256
from gateway.outputs.uds.services import SERVICES

EXTRA = """
[output.uds]
{uds}

[[did]]
id = 0xF190
name = "vin"
text = "1HGCM82633A004352"

[[did]]
id = 0x0123
name = "volts"
signal = "M0.Value"
type = "u16"
scale = 0.25

[[did]]
id = 0x0124
name = "setting"
hex = "0102"
writable = true
"""

SECRET = "00112233"
SECURE = f"""
clear = {{ sessions = ["extended"], security = 1 }}
write = {{ sessions = ["extended"], security = 1 }}
security = [{{ level = 1, secret = "{SECRET}", attempts = 2, delay_s = 3.0 }}]
"""


def hexed(k):
    return bytes(Dtc.parse(dtc_text(k))).hex()


def read_by_others(answer):
    """Read an answer as py-uds understands ISO 14229-1:2020; raises what it finds wrong."""
    known = BASE_TRANSLATOR_2020.services_mapping
    if answer[0] != 0x7F:
        known[answer[0]].decode(answer)
    elif answer[1] in known:
        known[answer[1]].decode_negative_response(answer)


class Asked(Tester):
    """Answers as hex digits, each read by another decoder on the way."""

    def __call__(self, request, **options):
        answers = self.exchange(bytes.fromhex(request), **options)
        for answer in answers:
            if answer[0] not in (0x59,) or answer[1] not in (
                0x04,
                0x06,
            ):  # their length needs our table
                read_by_others(answer)
        return " ".join(answer.hex() for answer in answers)


@pytest.fixture
def make(tmp_path):
    rigs = []

    def build(messages=3, uds="", memory=None, more="", **options):
        path = write_config(tmp_path, messages, extra=EXTRA.format(uds=uds) + more, **options)
        rigs.append(Rig(path, memory))
        return rigs[-1], Asked(rigs[-1])

    yield build
    for rig in rigs:
        rig.close()


# The checks before a service, in the order of the standard


@pytest.mark.parametrize(
    ("request_", "expected", "why"),
    [
        ("00", "7f0011", "no such service"),
        ("ba00", "7fba11", "no such service, whatever follows"),
        ("2701", "7f2711", "no level is set up: not offered"),
        ("2801", "7f287f", "not in the default session"),
        ("28", "7f287f", "the session comes before the length"),
        ("8501", "7f857f", "not in the default session"),
        ("10", "7f1013", "too short"),
        ("1002", "7f1012", "there is no programming session"),
        ("100100", "7f1013", "too long"),
        ("1041", "7f1012", "sub-functions have 7 bits"),
        ("19", "7f1913", "too short"),
        ("1905", "7f1912", "not offered"),
        ("1999ff", "7f1912", "the sub-function comes before the length"),
        ("1902", "7f1913", "its mask is missing"),
        ("1902ffff", "7f1913", "one byte too many"),
        ("190200", "5902ff", "an empty mask finds nothing"),
        ("22", "7f2213", "too short"),
        ("22f1", "7f2213", "half an identifier"),
        ("22f190f1", "7f2213", "one and a half"),
        ("22beef", "7f2231", "no such identifier"),
        ("2e01240304", "7f2e7f", "writing is of the extended session"),
        ("3100", "7f317f", "routines are of the extended session"),
        ("3e01", "7f3e12", "only zero"),
        ("3e", "7f3e13", "too short"),
        ("3e00", "7e00", "good"),
        ("14ffff", "7f1413", "too short"),
        ("14123456", "7f1431", "no such DTC"),
        ("14000000", "7f1431", "reserved: clears nothing"),
        ("14fffffe", "7f1431", "a group that we do not have"),
    ],
)
def test_refusals(make, request_, expected, why):
    _, ask = make()
    assert ask(request_) == expected, why


def test_what_concerns_others_is_not_answered_to_a_functional_request(make):
    rig, ask = make()
    for request in ("ba00", "1905", "22beef", "2801", "14123456", "1002"):
        assert ask(request, functional=FUNCTIONAL) == "", request
    assert ask("3e00", functional=FUNCTIONAL) == "7e00"
    assert ask("10", functional=FUNCTIONAL) == "7f1013", "a wrong length is told to everybody"
    assert ask("1902", functional=FUNCTIONAL) == "7f1913"
    # A functional request is a single frame; a first frame gets no flow control.
    assert rig.feed((FUNCTIONAL, bytes.fromhex("100a190200000000"))) == []
    assert rig.gateway.summary(1.0)["counters"]["isotp_errors"] == 1


def test_the_suppress_bit_silences_the_good_answer_only(make):
    _, ask = make()
    assert ask("3e80") == ""
    assert ask("1083") == ""
    assert ask("22f186") == "62f18603"
    assert ask("3e81") == "7f3e12"
    assert ask("1982") == "7f1913"


# Sessions


def test_a_session_ends_after_s3_and_takes_everything_with_it(make):
    rig, ask = make()
    assert ask("1003") == "5003003201f4"
    rig.wait(4900)
    assert ask("3e80") == ""
    rig.wait(4900)
    assert ask("22f186") == "62f18603", "tester present keeps it"
    assert ask("8502") == "c502"
    rig.fail(0)
    assert rig.status(0) == 0x50, "status bytes are frozen"
    rig.wait(5001)
    assert ask("22f186") == "62f18601"
    rig.fail(0)
    assert rig.status(0) == 0x2F, "and are updated again"


def test_dtc_setting_off_freezes_and_default_session_switches_it_on(make):
    rig, ask = make()
    rig.feed((256, b"\x01"))
    before = rig.gateway.engine.fault_detection_counter(0)
    assert before == 63
    assert ask("1003")
    assert ask("8502ffffff") == "c502"
    assert ask("8502000001") == "7f8531", "one DTC cannot be set off alone"
    assert ask("850200") == "7f8513"
    rig.fail(0)
    assert rig.gateway.engine.fault_detection_counter(0) == before
    assert ask("8501") == "c501"
    rig.feed((256, b"\x01"))
    assert rig.status(0) == 0x2F
    assert ask("8502") == "c502"
    assert ask("1001")
    rig.fail(1)
    assert rig.status(1) == 0x2F


def test_communication_control(make):
    rig, ask = make(uds="", messages=2)
    assert ask("1003")
    for wrong in ("280000", "28000400", "280011", "280014"):
        assert ask(wrong).startswith("7f28"), wrong
    assert ask("280401") == "7f2812"
    assert ask("280201") == "6802"
    rig.fail(0)
    rig.wait(3000)
    assert rig.status(0) == 0x50, "what is not received is no fault, and silence is none either"
    assert ask("28000f").startswith("7f2831"), "a reserved bit of the communication type"
    assert len(rig.gateway.feed(empty(0))) == 0
    assert ask("280001") == "6800"
    rig.fail(0)
    assert rig.status(0) == 0x2F


def test_communication_off_silences_what_the_gateway_says_by_itself(make):
    rig, ask = make(
        faults={0: "spn = 100\nfmi = 1\n"},
        more="[output.dtc_frame]\ncycle_ms = 100.0\n[output.j1939]\n",
    )
    ours = {0x7E8}
    rig.wait(1500)
    assert {can_id for can_id, _ in rig.sent} - ours == {0x6F0, 0x98EEFFF9, 0x98FECAF9}
    assert ask("1003")
    assert ask("280101") == "6801"
    rig.sent.clear()
    rig.fail(0)
    rig.wait(1500)
    assert ask("3e00") == "7e00"
    assert {can_id for can_id, _ in rig.sent} == ours
    assert rig.status(0) == 0x2F, "what is received still counts"
    rig.wait(5100)
    rig.sent.clear()
    rig.wait(1500)
    assert {can_id for can_id, _ in rig.sent} == {0x6F0, 0x98FECAF9}, (
        "the end of the session ends it"
    )


def test_ecu_reset_starts_the_next_operation_cycle(make):
    rig, ask = make()
    rig.fail(0)
    assert ask("1003")
    number = rig.gateway.memory.cycle_number()
    assert ask("1101") == "5101"
    assert rig.gateway.memory.cycle_number() == number + 1
    assert ask("22f186") == "62f18601"
    assert rig.status(0) == 0x6D
    assert ask("1104") == "7f1112"


# Security


def test_security_access(make):
    rig, ask = make(uds=SECURE)
    assert ask("2701") == "7f277f"
    assert ask("1003")
    assert ask("2703") == "7f2712"
    assert ask("14ffffff") == "7f1433"
    assert ask("270200000000") == "7f2724", "a key before its seed"
    seed = bytes.fromhex(ask("2701")[4:])
    key = hmac_sha256(seed, bytes.fromhex(SECRET), 1)
    assert ask("2702" + bytes(b ^ 1 for b in key).hex()) == "7f2735"
    assert ask("2702" + key.hex()) == "7f2724", "each seed is good for one try"
    other = bytes.fromhex(ask("2701")[4:])
    assert other != seed
    assert ask("2702" + "00" * 4) == "7f2736", "the second wrong key"
    assert ask("2701") == "7f2737", "the delay runs"
    rig.wait(2900)
    assert ask("2701") == "7f2737"
    rig.wait(200)
    seed = bytes.fromhex(ask("2701")[4:])
    assert ask("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == "6702"
    assert ask("2701") == "670100000000", "unlocked already"
    assert ask("14ffffff") == "54"
    assert ask("2e01240a0b") == "6e0124"
    assert ask("1003")
    assert ask("14ffffff") == "7f1433", "a change of session locks again"
    assert ask("1001")
    assert ask("14ffffff") == "7f147f", "clearing is of the extended session here"


def test_a_seed_is_never_all_zero():
    """Zeros would say that the level is unlocked already."""
    drawn = iter([bytes(4), bytes(4), b"\x00\x00\x00\x01"])
    security = Security([SecurityLevel(level=1, secret="00")], random=lambda n: next(drawn))
    assert security.seed(1, 0) == b"\x00\x00\x00\x01"


def test_a_key_function_of_the_user(tmp_path, monkeypatch):
    (tmp_path / "my_keys.py").write_text(
        "def key(seed, secret, level): return seed[::-1] + secret\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    uds = 'security = [{ level = 3, secret = "aa", key = "my_keys:key", seed_length = 2 }]'
    rig = Rig(write_config(tmp_path, extra=EXTRA.format(uds=uds)))
    ask = Asked(rig)
    assert ask("1003")
    seed = bytes.fromhex(ask("2705")[4:])
    assert len(seed) == 2
    assert ask("2706" + seed[::-1].hex() + "aa") == "6706"
    rig.close()


# Data


def test_identifiers_are_served_live(make):
    rig, ask = make()
    assert ask("22f190") == "62f190" + b"1HGCM82633A004352".hex()
    assert ask("220123") == "620123ffff", "never received: not available"
    rig.value(0, 3.5)
    assert ask("220123") == "620123000e"
    assert ask("220123beef0124") == "620123000e01240102", "of several, those that there are"


def test_writing_is_kept_over_a_restart(make, tmp_path):
    rig, ask = make(memory=tmp_path / "m.sqlite")
    assert ask("1003")
    assert ask("2e01240a0b") == "6e0124"
    assert ask("2e01240a") == "7f2e13", "another length"
    assert ask("2ef19041") == "7f2e31", "not writable"
    assert ask("2ebeef41") == "7f2e31"
    rig.close()
    _, ask = make(memory=tmp_path / "m.sqlite")
    assert ask("220124") == "6201240a0b"


def test_routines(make, tmp_path):
    rig, ask = make(memory=tmp_path / "m.sqlite")
    assert ask("1003")
    assert ask("31010203") == "7f3131"
    assert ask("31020201") == "7f3112"
    assert ask("31030202") == "7f3124", "results before a start"
    assert ask("310102") == "7f3113"
    assert ask("31010202") == "7f3178 7101020200", "it takes its time, and says so"
    assert ask("31810202") == "7f3178 7181020200"[:6] + " 7101020200", (
        "after 0x78 the end is always told"
    )
    assert ask("31030202") == "7103020200"
    number = rig.gateway.memory.cycle_number()
    assert ask("31010201") == "7101020100"
    assert rig.gateway.memory.cycle_number() == number + 1


def test_the_shipped_default_lets_anyone_clear(make):
    rig, ask = make()
    for k in range(3):
        rig.fail(k)
    assert ask("14" + hexed(1)) == "54"
    assert [rig.status(k) for k in range(3)] == [0x2F, 0x50, 0x2F]
    assert ask("14ffffff") == "54"
    assert [rig.status(k) for k in range(3)] == [0x50, 0x50, 0x50]


def test_a_clear_by_letter(make):
    rig, ask = make(messages=5)
    for k in range(5):
        rig.fail(k)
    assert ask("14400000") == "54"
    assert [rig.status(k) for k in range(5)] == [0x2F, 0x50, 0x2F, 0x2F, 0x2F]


# 0x19


FAULTS = {
    0: 'severity = "immediately"\nfunctional_unit = 7\nfreeze_frame = ["M1.Value", "volts", "M0.Value"]\n',
    1: 'severity = "maintenance"\nindicator = true\nconfirm_cycles = 2\n',
    2: "emission_related = false\n",
}


def test_every_sub_function(make):
    rig, ask = make(faults=FAULTS)
    rig.value(0, 5.0)
    rig.value(1, 4.0)
    rig.fail(1)
    rig.fail(0)
    rig.feed((258, b"\x01"))  # one of the two that fault 2 needs
    a, b, c = (hexed(k) for k in range(3))
    assert ask("1901ff") == "5901ff000003"
    assert ask("190108") == "5901ff000001"
    assert ask("1902ff") == f"5902ff{a}2f{b}27{c}50"
    assert ask("190204") == f"5902ff{a}2f{b}27"
    assert ask("1903") == f"5903{a}01{b}01"
    assert (
        ask(f"1904{a}01")
        == f"5904{a}2f" + "0102" + "4000" + struct.pack(">f", 4.0).hex() + "01230014"
    )
    assert ask(f"1904{a}ff") == ask(f"1904{a}01")
    assert ask(f"1904{a}02") == f"5904{a}2f", "a record that is not there"
    assert ask(f"1904{a}03") == "7f1931", "a record that cannot be"
    assert ask(f"1904{a}00") == "7f1931"
    assert ask("190412345601") == "7f1931", "an unknown DTC"
    assert ask(f"1906{a}01") == f"5906{a}2f0101"
    assert ask(f"1906{a}03") == f"5906{a}2f037f"
    assert ask(f"1906{a}20")[12:14] == "20"
    assert ask(f"1906{c}ff") == f"5906{c}50", "nothing is stored of it"
    assert ask(f"1906{a}99") == "7f1931"
    assert ask("1907e0ff") == "5907ff000002"
    assert ask("190780ff") == "5907ff000001"
    assert ask("190880ff") == f"5908ff8107{a}2f"
    assert ask("190820ff") == f"5908ff2100{b}27"
    assert ask(f"1909{a}") == f"5909ff8107{a}2f"
    assert ask("1909123456") == "7f1931"
    assert ask("190a") == f"590aff{a}2f{b}27{c}50"
    assert ask("190b") == f"590bff{b}27"
    assert ask("190c") == f"590cff{a}2f"
    assert ask("190d") == f"590dff{a}2f"
    assert ask("190e") == f"590eff{a}2f"
    assert ask("1914") == f"5914{c}3f"
    assert ask("1915") == "5915ff"
    assert ask("194233ff80") == f"594233ffff0481{a}2f"
    assert ask("1942ffffe0") == f"5942ffffff0481{a}2f21{b}27"
    assert ask("194212ffe0") == "7f1931"
    assert ask("195533") == "595533ff04"
    rig.cycle(1)
    assert rig.status(1) == 0xAF
    assert ask("1915") == f"5915ff{b}af"
    assert ask("195533") == f"595533ff04{b}af"
    assert ask("190e") == f"590eff{b}af"
    assert ask("14ffffff") == "54"
    assert ask("1915") == f"5915ff{b}50", "permanent, though cleared"


def test_extended_data_is_what_the_memory_knows(make):
    rig, ask = make()
    rig.fail(0)
    rig.heal(0)
    rig.fail(0)
    first, last = rig.gateway.memory.entry("b.M0.length").first_ns, rig.now
    answer = bytes.fromhex(ask(f"1906{hexed(0)}ff"))
    assert answer[6:8] == b"\x01\x02"
    at = answer.index(b"\x10" + struct.pack(">q", first))
    assert answer[at + 9 : at + 18] == b"\x11" + struct.pack(">q", last)
    (length,) = struct.unpack(">d", bytes.fromhex(ask(f"1906{hexed(0)}20"))[-8:])
    assert length == 1.0, "the evidence: so many bytes came"


def test_the_availability_mask_hides_bits_everywhere(make):
    rig, ask = make(uds="status_mask = 0x09", messages=1)
    rig.fail(0)
    assert ask("1902ff") == f"590209{hexed(0)}09"
    assert ask("190220") == "590209"
    assert ask("1901f6") == "590109000000"


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    steps=st.lists(st.tuples(st.integers(0, 4), st.sampled_from("fhc")), max_size=12),
    masks=st.lists(st.integers(0, 255), min_size=1, max_size=6),
)
def test_status_masks_find_what_a_model_finds(shared, steps, masks):
    rig, ask = shared
    ask("14ffffff")
    for k, what in steps:
        {"f": rig.fail, "h": rig.heal, "c": lambda _: rig.cycle()}[what](k)
    model = sorted((hexed(k), rig.status(k)) for k in range(5))
    for mask in masks:
        found = [(dtc, status) for dtc, status in model if status & mask]
        listed = "".join(f"{dtc}{status:02x}" for dtc, status in found)
        assert ask(f"1902{mask:02x}") == f"5902ff{listed}"
        assert ask(f"1901{mask:02x}") == f"5901ff00{len(found):04x}"


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    rig = Rig(write_config(tmp_path_factory.mktemp("rig"), 5, extra=EXTRA.format(uds="")))
    yield rig, Asked(rig)
    rig.close()


def test_more_than_fifty_dtcs_in_one_answer(make):
    rig, ask = make(messages=120)
    for k in range(120):
        rig.fail(k)
    answer = bytes.fromhex(ask("190208", patience=400))
    assert len(answer) == 3 + 4 * 120
    assert answer[3:] == b"".join(
        sorted(bytes(Dtc.parse(dtc_text(k))) + b"\x2f" for k in range(120))
    )


# 0x86


def test_responses_on_status_changes(make):
    rig, ask = make()
    assert ask("860502") == "7f8624", "nothing is set up"
    assert ask("86010208190208").startswith("c60100"), "when bit 3 changes: 19 02 08"
    assert ask("860402") == "c60400", "set up, not started"
    rig.fail(0)
    assert ask("3e00") == "7e00"
    assert ask("860502") == "c6050002"
    assert ask("860402") == "c604010102081902 08".replace(" ", "")
    ask.hear(rig.fail(1))
    told = "5902ff" + "".join(sorted(hexed(k) + "2f" for k in (0, 1)))
    assert [answer.hex() for answer in ask.listen()] == [told], "the answer comes by itself"
    assert ask("3e00") == "7e00"
    assert ask("860002") == "c6000002"
    assert [data for can_id, data in rig.fail(2) if can_id == 0x7E8] == []
    assert ask("860602") == "c6060002"
    assert ask("860502") == "7f8624"
    assert ask("864502") == "7f8612", "storing over a restart is not offered"
    assert ask("860102082708") == "7f8631", "only reading can be the answer"


def test_responses_on_events_end_with_the_session(make):
    rig, ask = make()
    assert ask("1003")
    assert ask("86010201190d").startswith("c601")
    assert ask("860502") == "c6050002"
    assert ask("1001")
    assert not any(can_id == 0x7E8 for can_id, _ in rig.fail(0))
    assert ask("860402") == "c60400"


def test_the_window_of_responses_on_events(make):
    rig, ask = make()
    assert ask("86010301190d").startswith("c601")
    assert ask("860503") == "c6050003"
    assert any(can_id == 0x7E8 for can_id, _ in rig.fail(0))
    rig.wait(30_001, step=1000)
    assert not any(can_id == 0x7E8 for can_id, _ in rig.fail(1)), "three times 10 s are over"


# The whole


def test_each_service_is_named_by_its_file():
    for sid, service in SERVICES.items():
        module = service.handle.__module__.rpartition(".")[2]
        assert module.startswith(f"x{sid:02x}_")
        words = module.partition("_")[2].replace("_", "")
        assert words == service.name.lower()


def test_p2_is_told_as_configured(make):
    _, ask = make(uds="p2_ms = 25\np2_star_ms = 2000")
    assert ask("1001") == "5001001900c8"


def test_answers_leave_at_the_time_of_the_request(make):
    """No timer, no sleep: the answer is among the frames returned for the request's own frame."""
    rig, _ = make()
    (frame,) = rig.feed((0x7E0, bytes.fromhex("023e000000000000")))
    assert frame == (0x7E8, bytes.fromhex("027e00cccccccccc"))
    assert rig.now == MS


# Transport


def test_can_fd_carries_an_answer_in_frames_of_64_bytes(make):
    rig, _ = make(messages=40, uds="fd = true")
    for k in range(40):
        rig.fail(k)
    tester = Tester(rig, can_fd=True, tx_data_length=64)
    answer = tester.ask("190208")
    assert len(answer) == 3 + 4 * 40
    lengths = [len(data) for can_id, data in rig.sent if can_id == 0x7E8]
    assert lengths == [64, 64, 48], (
        "first frame, one whole, the rest padded to a length that there is"
    )
    rig.sent.clear()
    assert tester.ask("22f190") == bytes.fromhex("62f190") + b"1HGCM82633A004352"
    ((_, data),) = [frame for frame in rig.sent if frame[0] == 0x7E8]
    assert data[:2] == bytes([0, 20]), "above 7 bytes a single frame has the escape form"


def test_a_classic_tester_is_answered_in_classic_frames(make):
    rig, ask = make()
    assert ask("22f190") == "62f190" + b"1HGCM82633A004352".hex()
    assert all(len(data) == 8 for can_id, data in rig.sent if can_id == 0x7E8)


def test_the_testers_separation_time_and_block_size_are_kept(make):
    rig, _ = make(messages=20)
    for k in range(20):
        rig.fail(k)
    rig.sent.clear()
    (first,) = rig.feed((0x7E0, bytes.fromhex("03190208")))
    assert first[1][:2] == bytes.fromhex("1053")
    assert rig.wait(100) == [], "nothing more before flow control"
    sent = rig.feed((0x7E0, bytes.fromhex("300305")))  # 3 frames, 5 ms apart
    times = []
    for _ in range(40):
        times += [(rig.now, data[0]) for _, data in rig.wait(1, step=1)]
    assert [number for _, number in times] == [0x21, 0x22, 0x23]
    assert sent == []
    assert all(b - a >= 5 * MS for (a, _), (b, _) in pairwise(times))
    assert rig.feed((0x7E0, bytes.fromhex("310000"))) == [], "wait"
    rest = rig.feed((0x7E0, bytes.fromhex("300000")))
    assert [data[0] for _, data in rest] == list(range(0x24, 0x2C))


def test_a_tester_that_falls_silent_blocks_the_server_for_a_second(make):
    rig, ask = make(messages=20)
    for k in range(20):
        rig.fail(k)
    rig.feed((0x7E0, bytes.fromhex("03190208")))
    assert rig.feed((0x7E0, bytes.fromhex("023e00"))) == [], "an answer is under way"
    assert rig.wait(1010) == [], "and what was asked meanwhile is not answered later"
    assert ask("3e00") == "7e00"


def test_a_long_request_is_put_together(make):
    rig, ask = make()
    assert ask("22" + "f190" * 5).count(b"1HGCM".hex()) == 5
    # A gap in its frames ends it; the next request is served.
    (flow,) = rig.feed((0x7E0, bytes.fromhex("100b22f190f190f1")))
    assert flow[1][0] == 0x30
    assert rig.feed((0x7E0, bytes.fromhex("22f190f190f190"))) == []
    assert ask("3e00") == "7e00"
    rig.feed((0x7E0, bytes.fromhex("100b22f190f190f1")))
    rig.wait(1100)
    assert rig.feed((0x7E0, bytes.fromhex("21f190f190f190"))) == [], "too late"
    assert ask("3e00") == "7e00"
