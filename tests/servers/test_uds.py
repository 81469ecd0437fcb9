"""The UDS server, asked through can-isotp on the frames' own clock; every answer is read by py-uds too."""

import pytest
from rig import FUNCTIONAL, MS, Rig, write_config
from uds_tester import ANYBODY, EXTRA, Asked, hexed

from gateway.bus.frames import empty
from gateway.runtime.app import Gateway
from gateway.servers.uds.params import SecurityLevel
from gateway.servers.uds.security import Security, hmac_sha256
from gateway.servers.uds.services import SERVICES

SECRET = "00112233"
SECURE = f"""
clear = {{ sessions = ["extended"], security = 1 }}
write = {{ sessions = ["extended"], security = 1 }}
security = [{{ level = 1, secret = "{SECRET}", attempts = 2, delay_s = 3.0 }}]
"""


# The checks before a service, in the order of the standard


@pytest.mark.evidence(
    "ISO 14229-1: 0x3E",
    "ISO 14229-1: NRC order",
    "ISO 14229-1: NRC 11",
    "ISO 14229-1: NRC 12",
    "ISO 14229-1: NRC 13",
    "ISO 14229-1: NRC 31",
    "ISO 14229-1: NRC 7F",
)
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
        ("190f", "7f1912", "not offered"),
        ("198fff", "7f1912", "the sub-function comes before the length"),
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
        ("1101", "7f117f", "a reset is of the extended session"),
        ("14ffffff", "7f147f", "clearing is of the extended session"),
    ],
)
def test_refusals(uds, request_, expected, why):
    _, ask = uds()
    assert ask(request_) == expected, why


@pytest.mark.evidence("ISO 14229-1: 0x14 unknown")
@pytest.mark.parametrize(
    ("request_", "expected", "why"),
    [
        ("14ffff", "7f1413", "too short"),
        ("14123456", "7f1431", "no such DTC"),
        ("14000000", "7f1431", "reserved: clears nothing"),
        ("14fffffe", "7f1431", "a group that we do not have"),
    ],
)
def test_refusals_of_the_extended_session(uds, request_, expected, why):
    _, ask = uds()
    assert ask("1003")
    assert ask(request_) == expected, why


@pytest.mark.evidence("ISO 14229-1: functional")
def test_what_concerns_others_is_not_answered_to_a_functional_request(uds):
    rig, ask = uds()
    for request in ("ba00", "190f", "22beef", "2801", "14123456", "1002"):
        assert ask(request, functional=FUNCTIONAL) == "", request
    assert ask("3e00", functional=FUNCTIONAL) == "7e00"
    assert ask("10", functional=FUNCTIONAL) == "7f1013", "a wrong length is told to everybody"
    assert ask("1902", functional=FUNCTIONAL) == "7f1913"
    # A functional request is a single frame; a first frame gets no flow control.
    assert rig.feed((FUNCTIONAL, bytes.fromhex("100a190200000000"))) == []
    assert rig.gateway.summary(1.0)["counters"]["isotp_errors"] == 1


@pytest.mark.evidence("ISO 14229-1: suppress")
def test_the_suppress_bit_silences_the_good_answer_only(uds):
    _, ask = uds()
    assert ask("3e80") == ""
    assert ask("1083") == ""
    assert ask("22f186") == "62f18603"
    assert ask("3e81") == "7f3e12"
    assert ask("1982") == "7f1913"


# Sessions


@pytest.mark.evidence("ISO 14229-1: 0x10 01", "ISO 14229-2: S3")
def test_a_session_ends_after_s3_and_takes_everything_with_it(uds):
    rig, ask = uds()
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


@pytest.mark.evidence("ISO 14229-1: 0x10 01", "ISO 14229-1: 0x85", "AUTOSAR DEM: DTC setting")
def test_dtc_setting_off_freezes_and_default_session_switches_it_on(uds):
    rig, ask = uds()
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


@pytest.mark.evidence("ISO 14229-1: 0x28")
def test_communication_control(uds):
    rig, ask = uds(uds="", messages=2)
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


@pytest.mark.evidence("ISO 14229-1: 0x28")
def test_communication_off_silences_what_the_gateway_says_by_itself(uds):
    rig, ask = uds(
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
    assert {can_id for can_id, _ in rig.sent} == {0x6F0, 0x98FECAF9}, "the end of the session ends it"


@pytest.mark.evidence("ISO 14229-1: 0x11 01", "ISO 14229-1: 0x11 02", "ISO 14229-1: 0x11 03")
@pytest.mark.parametrize("kind", ["01", "02", "03"])
def test_ecu_reset_starts_the_next_operation_cycle(uds, kind):
    rig, ask = uds()
    rig.fail(0)
    assert ask("1003")
    number = rig.gateway.memory.cycle_number()
    assert ask(f"11{kind}") == f"51{kind}"
    assert rig.gateway.memory.cycle_number() == number + 1
    assert ask("22f186") == "62f18601"
    assert rig.status(0) == 0x6D
    assert ask("1003")
    assert ask("1104") == "7f1112"


# Security


@pytest.mark.evidence("ISO 14229-1: 0x27 seed", "ISO 14229-1: 0x27 key")
def test_security_access(uds):
    rig, ask = uds(uds=SECURE)
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
    assert ask("2701") == "6701" + "00" * 8, "unlocked already"
    assert ask("14ffffff") == "54"
    assert ask("2e01240a0b") == "6e0124"
    assert ask("1003")
    assert ask("14ffffff") == "7f1433", "a change of session locks again"
    assert ask("1001")
    assert ask("14ffffff") == "7f147f", "clearing is of the extended session here"


@pytest.mark.evidence("ISO 14229-1: 0x27 seed")
def test_a_seed_is_never_all_zero():
    """Zeros would say that the level is unlocked already."""
    drawn = iter([bytes(8), bytes(8), bytes(7) + b"\x01"])
    security = Security([SecurityLevel(level=1, secret="00")], random=lambda n: next(drawn))
    assert security.seed(1, 0) == bytes(7) + b"\x01"


def wrong_key(ask):
    assert ask("1003")
    asked = ask("2701")
    return asked if asked.startswith("7f") else ask("2702" + "00" * 8)


@pytest.mark.evidence("ISO 14229-1: 0x27 35", "ISO 14229-1: 0x27 36", "ISO 14229-1: 0x27 37")
def test_attempts_and_delay_survive_restarts(uds, tmp_path):
    """D12: kill -9, or SIGHUP, and the attempts began anew."""
    memory = tmp_path / "m.sqlite"
    level = f'security = [{{ level = 1, secret = "{SECRET}", attempts = 3, delay_s = 4.0 }}]'

    def restarted(rig=None):
        if rig is not None:
            rig.gateway.store.close()  # as kill -9: nothing is ended, nothing written any more
        return uds(uds=level, memory=memory)

    rig, ask = restarted()
    assert wrong_key(ask) == "7f2735"
    rig, ask = restarted(rig)
    assert wrong_key(ask) == "7f2735"
    rig, ask = restarted(rig)
    assert wrong_key(ask) == "7f2736", "the third, over two restarts"
    rig, ask = restarted(rig)
    assert wrong_key(ask) == "7f2737", "the whole delay again"
    rig.wait(3500)
    assert wrong_key(ask) == "7f2737"
    rig.wait(500)
    assert wrong_key(ask) == "7f2736", "one attempt after each delay"
    rig.wait(4100)
    assert ask("1003")
    seed = bytes.fromhex(ask("2701")[4:])
    assert ask("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == "6702"
    rig, ask = restarted(rig)
    assert wrong_key(ask) == "7f2735", "a right key forgives"


@pytest.mark.evidence("ISO 14229-1: 0x27 count")
def test_a_key_is_counted_before_it_is_looked_at(uds, tmp_path):
    """Who cuts the power at the answer has used an attempt up all the same."""
    rig, ask = uds(uds=SECURE, memory=tmp_path / "m.sqlite")
    seen = []
    level = rig.gateway.servers.all[0].uds.context.security._levels[1]

    def key(seed, secret, number):
        seen.append(rig.gateway.store.facts().get("attempts.1"))
        return b"no"

    level.key = key
    assert wrong_key(ask) == "7f2735"
    assert seen == [1]


@pytest.mark.evidence("ISO 14229-1: 0x27 37")
def test_seeds_that_were_asked_for_before_a_delay_are_no_way_around_it(uds):
    rig, a = uds(uds=SECURE + "further = [{ request = 0x7E4, response = 0x7EC }]\n")
    b = Asked(rig, 0x7E4, 0x7EC)
    assert b("1003")
    seed = bytes.fromhex(b("2701")[4:])
    assert (wrong_key(a), wrong_key(a)) == ("7f2735", "7f2736")
    assert b("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == "7f2737"


def test_a_reload_forgives_nothing(uds, tmp_path):
    memory = tmp_path / "m.sqlite"
    rig, ask = uds(uds=SECURE, memory=memory)
    for expected in ("7f2735", "7f2736"):
        assert wrong_key(ask) == expected
    old = rig.gateway
    old.finish(rig.now)
    rig.gateway = Gateway(old.config, None, file=tmp_path / "rig.toml", store=old.store)
    rig.gateway.succeed(old)
    assert wrong_key(ask) == "7f2737"


@pytest.mark.evidence("ISO 14229-1: 0x27 start delay")
def test_a_delay_after_each_start(uds):
    rig, ask = uds(uds=f'security = [{{ level = 1, secret = "{SECRET}", start_delay_s = 2.0 }}]')
    assert ask("1003")
    assert ask("2701") == "7f2737"
    rig.wait(2000)
    assert ask("2701").startswith("6701")


def test_seeds_may_be_long(uds):
    _, ask = uds(uds=f'security = [{{ level = 1, secret = "{SECRET}", seed_length = 32 }}]')
    assert ask("1003")
    seed = bytes.fromhex(ask("2701")[4:])
    assert len(seed) == 32
    assert ask("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == "6702"


def test_a_key_function_of_the_user(tmp_path, monkeypatch):
    (tmp_path / "my_keys.py").write_text("def key(seed, secret, level): return seed[::-1] + secret\n")
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


@pytest.mark.evidence("ISO 14229-1: 0x22 one", "ISO 14229-1: 0x22 several")
def test_identifiers_are_served_live(uds):
    rig, ask = uds()
    assert ask("22f190") == "62f190" + b"1HGCM82633A004352".hex()
    assert ask("220123") == "620123ffff", "never received: not available"
    rig.value(0, 3.5)
    assert ask("220123") == "620123000e"
    assert ask("220123beef0124") == "620123000e01240102", "of several, those that there are"


@pytest.mark.evidence("ISO 14229-1: 0x2E")
def test_writing_is_kept_over_a_restart(uds, tmp_path):
    rig, ask = uds(memory=tmp_path / "m.sqlite")
    assert ask("1003")
    assert ask("2e01240a0b") == "6e0124"
    assert ask("2e01240a") == "7f2e13", "another length"
    assert ask("2ef19041") == "7f2e31", "not writable"
    assert ask("2ebeef41") == "7f2e31"
    rig.close()
    _, ask = uds(memory=tmp_path / "m.sqlite")
    assert ask("220124") == "6201240a0b"


@pytest.mark.evidence("ISO 14229-1: 0x31")
def test_routines(uds, tmp_path):
    rig, ask = uds(memory=tmp_path / "m.sqlite")
    assert ask("1003")
    assert ask("31010203") == "7f3131"
    assert ask("31020201") == "7f3112"
    assert ask("31030202") == "7f3124", "results before a start"
    assert ask("310102") == "7f3113"
    assert ask("31010202") == "7f3178 7101020200", "it takes its time, and says so"
    assert ask("31810202") == "7f3178 7181020200"[:6] + " 7101020200", "after 0x78 the end is always told"
    assert ask("31030202") == "7103020200"
    number = rig.gateway.memory.cycle_number()
    assert ask("31010201") == "7101020100"
    assert rig.gateway.memory.cycle_number() == number + 1


@pytest.mark.evidence("ISO 14229-1: 0x31 78")
def test_a_request_before_a_late_answer_loses_neither(uds):
    rig, ask = uds()
    assert ask("1003")
    (pending,) = rig.feed((0x7E0, bytes.fromhex("0431010202")))
    assert pending[1][:4] == bytes.fromhex("037f3178")
    both = rig.feed((0x7E0, bytes.fromhex("023e00")))
    assert [data[: data[0] + 1].hex() for _, data in both] == ["057101020200", "027e00"]


@pytest.mark.evidence("ISO 14229-1: NRC 14")
def test_an_answer_that_does_not_fit_is_refused(uds):
    _, ask = uds()
    assert len(ask("22" + "f190" * 215, patience=200)) == 2 * (1 + 215 * 19), "4086 bytes"
    assert ask("22" + "f190" * 216, patience=200) == "7f2214", "4105 bytes"


@pytest.mark.evidence("ISO 14229-1: 0x31 78")
def test_the_session_is_counted_from_the_late_answer(uds):
    rig, ask = uds()
    assert ask("1003")
    rig.feed((0x7E0, bytes.fromhex("0431010202")))
    ask.hear(rig.wait(4900, step=4900))
    assert [answer.hex() for answer in ask.listen()] == ["7101020200"]
    rig.wait(4900)
    assert ask("22f186") == "62f18603"
    rig.wait(5100)
    assert ask("22f186") == "62f18601"


@pytest.mark.evidence("ISO 14229-1: 0x14 all")
def test_a_clear_of_one_and_of_all(uds):
    rig, ask = uds(more=ANYBODY)
    for k in range(3):
        rig.fail(k)
    assert ask("14" + hexed(1)) == "54"
    assert [rig.status(k) for k in range(3)] == [0x2F, 0x50, 0x2F]
    assert ask("14ffffff") == "54"
    assert [rig.status(k) for k in range(3)] == [0x50, 0x50, 0x50]


@pytest.mark.evidence("ISO 14229-1: 0x14 groups")
def test_a_clear_by_letter(uds):
    rig, ask = uds(messages=5, more=ANYBODY)
    for k in range(5):
        rig.fail(k)
    assert ask("14400000") == "54"
    assert [rig.status(k) for k in range(5)] == [0x2F, 0x50, 0x2F, 0x2F, 0x2F]


# The whole


def test_each_service_is_named_by_its_file():
    for sid, service in SERVICES.items():
        module = service.handle.__module__.rpartition(".")[2]
        assert module.startswith(f"x{sid:02x}_")
        words = module.partition("_")[2].replace("_", "")
        assert words == service.name.lower()


@pytest.mark.evidence("ISO 14229-1: 0x10 P2")
def test_p2_is_told_as_configured(uds):
    _, ask = uds(uds="p2_ms = 25\np2_star_ms = 2000")
    assert ask("1001") == "5001001900c8"


@pytest.mark.evidence("ISO 14229-2: P2")
def test_answers_leave_at_the_time_of_the_request(uds):
    """No timer, no sleep: the answer is among the frames returned for the request's own frame."""
    rig, _ = uds()
    (frame,) = rig.feed((0x7E0, bytes.fromhex("023e000000000000")))
    assert frame == (0x7E8, bytes.fromhex("027e00cccccccccc"))
    assert rig.now == MS
