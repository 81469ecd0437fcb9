"""Who may intervene, and when: each rule of access by the way that must not work, whichever protocol it comes by."""

import pytest
from rig import FUNCTIONAL, Rig, Tester, write_config
from test_j1939 import pgn_id
from uds_tester import EXTRA, Asked, hexed

from gateway.bus.conditions import LOST
from gateway.bus.frames import ERROR
from gateway.config.load import load_config
from gateway.servers.uds.security import hmac_sha256
from gateway_commands.check import _ways_around, secrets_shown
from gateway_fdi.errors import InputErrors

SECRET = "00112233"
LEVEL = f'security = [{{ level = 1, secret = "{SECRET}" }}]\n'
STANDS = '[access]\nunprotected = ["M1.Value"]\nwhen = [{ signal = "M1.Value", max = 1.0 }]\n'
#: What blinds the gateway, clears it or changes it, each with its good answer in the extended session.
GUARDED = {
    "1101": "5101",
    "14ffffff": "54",
    "280101": "6801",
    "280301": "6803",
    "2e01240a0b": "6e0124",
    "31010201": "7101020100",
    "8502": "c502",
}


def unlock(ask):
    seed = bytes.fromhex(ask("2701")[4:])
    assert ask("2702" + hmac_sha256(seed, bytes.fromhex(SECRET), 1).hex()) == "6702"


@pytest.mark.evidence("ISO 14229-1: 0x10 03")
@pytest.mark.parametrize("request_", GUARDED)
def test_what_is_guarded_needs_the_extended_session(uds, request_):
    _, ask = uds()
    assert ask(request_) == f"7f{request_[:2]}7f"
    assert ask("1003")
    assert ask(request_) == GUARDED[request_]


@pytest.mark.evidence("ISO 14229-1: NRC 33")
@pytest.mark.parametrize("request_", GUARDED)
def test_what_is_guarded_needs_the_least_security_level_there_is(uds, request_):
    _, ask = uds(uds=LEVEL.replace(" }]", ' }, { level = 3, secret = "44556677" }]'))
    assert ask("1003")
    assert ask(request_) == f"7f{request_[:2]}33"
    unlock(ask)
    assert ask(request_) == GUARDED[request_]


@pytest.mark.parametrize("request_", GUARDED)
def test_what_is_guarded_needs_its_conditions(uds, request_):
    rig, ask = uds(more=STANDS)
    assert ask("1003")
    refused = f"7f{request_[:2]}22"
    assert ask(request_) == refused, "a speed that never came is not known to be low"
    rig.value(1, 50.0)
    assert ask(request_) == refused, "the vehicle moves"
    rig.value(1, 0.5)
    assert ask(request_) == GUARDED[request_]
    assert ask("1003")
    rig.wait(1100)
    if request_ != "280301":
        assert ask(request_) == refused, "a speed of long ago says nothing"


@pytest.mark.parametrize(("blinding", "undoing"), [("8502", "8501"), ("280101", "280001"), ("280301", "280001")])
def test_nobody_is_kept_from_undoing(uds, blinding, undoing):
    rig, ask = uds(more=STANDS)
    assert ask("1003")
    rig.value(1, 0.0)
    assert ask(blinding).startswith(f"{int(blinding[:2], 16) + 0x40:02x}")
    assert ask(undoing).startswith(f"{int(undoing[:2], 16) + 0x40:02x}")
    rig.fail(0)
    assert rig.status(0) == 0x2F
    assert ask("1001") == "5001003201f4"


@pytest.mark.parametrize("blinding", ["8502", "280301"])
def test_blinding_ends_when_its_condition_does(uds, blinding):
    """D4: for as long as tester present comes the vehicle could be driven blind."""
    rig, ask = uds(more=STANDS)
    assert ask("1003")
    rig.value(1, 0.0)
    assert not ask(blinding).startswith("7f")
    for _ in range(20):
        rig.value(1, 0.0)
        rig.wait(100)
        assert ask("3e80") == ""
    rig.fail(0)
    assert rig.status(0) == 0x50, "blind while it stands"
    rig.value(1, 30.0)
    rig.wait(150)
    rig.fail(0)
    assert rig.status(0) == 0x2F, "it moves: test results count again"
    assert ask("22f186") == "62f18603", "the session is as it was"


def test_reading_is_free(uds):
    rig, ask = uds(uds=LEVEL, more=STANDS)
    rig.fail(0)
    for request in ("1003", "1001", "1902ff", "22f190", "3e00", "86010208190208", "860602"):
        assert not ask(request).startswith("7f"), request


@pytest.mark.parametrize(
    ("name", "request_"),
    [
        ("session", "1003"),
        ("read_dtcs", "1902ff"),
        ("read_data", "22f190"),
        ("events", "86010208190208"),
        ("unlock", "2701"),
    ],
)
def test_every_service_takes_a_rule(uds, name, request_):
    rule = f'[access]\nunprotected = ["M1.Value"]\n{name} = {{ when = [{{ signal = "M1.Value", max = 1.0 }}] }}\n'
    rig, ask = uds(uds=LEVEL, more=rule)
    if name == "unlock":
        assert ask("1003")
    assert ask(request_) == f"7f{request_[:2]}22"
    rig.value(1, 0.0)
    assert not ask(request_).startswith("7f")


def test_reading_can_be_of_a_session_and_of_a_level(uds):
    _, ask = uds(uds=LEVEL, more='[access]\nread_dtcs = { sessions = ["extended"], security = 1 }\n')
    assert ask("1902ff") == "7f197f"
    assert ask("1003")
    assert ask("1902ff") == "7f1933"
    unlock(ask)
    assert ask("1902ff").startswith("5902")


def test_a_response_on_an_event_goes_by_the_rule_of_what_it_reads(uds):
    rig, ask = uds(uds=LEVEL, more="[access]\nread_dtcs = { security = 1 }\n")
    assert ask("86010208190208").startswith("c601")
    assert ask("860502").startswith("c605")
    ask.hear(rig.fail(0))
    assert [answer.hex() for answer in ask.listen()] == ["7f1933"]


# Clearing by whoever knows no sessions (D5)

SERVERS = "[output.obd]\n[output.j1939]\n"
OPEN = 'clear = { sessions = ["extended"], security = 1 }\n' + LEVEL


def by_mode_04(rig):
    (answer,) = Tester(rig).exchange(b"\x04", functional=FUNCTIONAL)
    return answer.hex()


def by_j1939(rig, pgn):
    frames = rig.feed((pgn_id(0xEA00, 0x21, 0xF9), pgn.to_bytes(3, "little")))
    ((_, data),) = [frame for frame in frames if frame[0] >> 16 & 0xFF == 0xE8]
    return data[0]


def claimed(build, **options):
    rig, ask = build(**options)
    rig.wait(300)
    rig.fail(0)
    assert rig.status(0) == 0x2F
    return rig, ask


def test_what_needs_security_by_uds_is_not_cleared_by_others(uds):
    rig, ask = claimed(uds, uds=OPEN, more=SERVERS)
    assert ask("14ffffff") == "7f147f"
    assert by_mode_04(rig) == "7f0422"
    assert by_j1939(rig, 0xFED3) == 2, "access denied"
    assert by_j1939(rig, 0xFECC) == 2
    assert rig.status(0) == 0x2F
    assert ask("1003")
    unlock(ask)
    assert by_mode_04(rig) == "7f0422", "what one protocol has unlocked is not open to the others"


def test_others_clear_under_the_conditions_of_clearing(uds):
    rig, _ = claimed(uds, more=SERVERS + STANDS)
    assert by_mode_04(rig) == "7f0422"
    assert by_j1939(rig, 0xFED3) == 1
    assert rig.status(0) == 0x2F
    rig.value(1, 0.0)
    assert by_mode_04(rig) == "44"
    assert rig.status(0) == 0x50
    rig.fail(0)
    rig.value(1, 0.0)
    assert by_j1939(rig, 0xFED3) == 0
    assert rig.status(0) == 0x50


def test_others_clear_where_a_rule_says_so(uds):
    rig, _ = claimed(uds, uds=OPEN, more=SERVERS + "[access]\nobd_clear = { allowed = true }\n")
    assert by_j1939(rig, 0xFED3) == 2
    assert by_mode_04(rig) == "44"
    rig, _ = claimed(uds, uds=OPEN, more=SERVERS.replace("[output.j1939]", "[output.j1939]\nallow_clear = true"))
    assert by_mode_04(rig) == "7f0422"
    assert by_j1939(rig, 0xFED3) == 0


def test_a_server_of_its_own_goes_by_the_rule_too(tmp_path):
    """OBD on an address of its own, without any UDS server."""
    rig = Rig(write_config(tmp_path, extra="[output.obd]\n" + STANDS))
    rig.fail(0)
    assert by_mode_04(rig) == "7f0422"
    rig.value(1, 0.0)
    assert by_mode_04(rig) == "44"
    rig.close()


# The order of refusal (D16)


@pytest.mark.evidence("ISO 14229-1: 0x2E 31")
def test_an_identifier_comes_before_its_security(uds):
    _, ask = uds(uds=LEVEL + 'write = { sessions = ["default", "extended"], security = 1 }\n')
    assert ask("2e1234aa") == "7f2e31"
    assert ask("2e1234aa", functional=FUNCTIONAL) == "", "this is no server's that is meant"
    assert ask("2e0124aa") == "7f2e33"
    assert ask("2e0124") == "7f2e13"


def test_a_routine_comes_before_its_sub_function(uds):
    _, ask = uds(uds=LEVEL + "routine = { security = 1 }\n")
    assert ask("31021234") == "7f3131"
    assert ask("31020201") == "7f3133", "then the security"
    assert ask("1003")
    unlock(ask)
    assert ask("31020201") == "7f3112"
    assert ask("3101020100") == "7f3113"


@pytest.mark.evidence("ISO 14229-1: NRC order", "ISO 14229-1: NRC 22")
def test_conditions_come_last(uds):
    _, ask = uds(uds=LEVEL, more=STANDS)
    assert ask("1003")
    unlock(ask)
    for request, expected in {
        "14123456": "7f1431", "280100": "7f2831", "2e0124aa": "7f2e13", "85020000": "7f8513", "850212": "7f8513",
        "310102": "7f3113", "11": "7f1113", "14ffffff": "7f1422",
    }.items():  # fmt: skip
        assert ask(request) == expected


# What the configuration says


def refusal(tmp_path, extra):
    with pytest.raises(InputErrors) as raised:
        load_config(write_config(tmp_path, extra=extra))
    return str(raised.value)


def test_rules_that_nobody_can_meet_are_refused(tmp_path):
    head = f"[output.uds]\n{LEVEL}[access]\n"
    said = refusal(tmp_path, head + "reset = { security = 2 }\n")
    assert "access.reset.security" in said
    assert "1)" in said, "which levels there are"
    said = refusal(tmp_path, head + "session = { security = 1 }\n")
    assert "never be met" in said
    said = refusal(tmp_path, head.replace("[access]", "clear = { security = 1 }\n[access]") + "clear = {}\n")
    assert "output.uds.clear says this already" in said
    said = refusal(tmp_path, "[output.j1939]\nallow_clear = true\n[access]\nj1939_clear = { allowed = false }\n")
    assert "allow_clear" in said
    said = refusal(tmp_path, '[access]\nwhen = [{ signal = "M1.Value", max = 1.0, rise = 2.0 }]\n')
    assert "rise" in said
    assert "reset" in refusal(tmp_path, "[access]\nrest = {}\n"), "the nearest name"


def test_a_signal_of_a_condition_must_be_there(tmp_path):
    config = write_config(tmp_path, extra='[access.reset]\nwhen = [{ signal = "M9.Value", max = 1.0 }]\n')
    with pytest.raises(Exception, match=r"access.reset.when\[0\].signal"):
        Rig(config)


def protected(tmp_path, keys, rest=""):
    """Write a configuration with a condition on M1, which is checked by keys."""
    dbc = (
        'BO_ 257 M1: 8 A\n SG_ Value : 0|16@1+ (0.5,0) [0|32767] "V" B\n SG_ Check : 16|8@1+ (1,0) [0|255] "" B\n'
        ' SG_ Count : 24|4@1+ (1,0) [0|15] "" B\n'
    )
    condition = STANDS.replace('unprotected = ["M1.Value"]\n', rest)
    path = write_config(tmp_path, extra=f"[output.uds]\n{condition}")
    text = (tmp_path / "rig.dbc").read_text()
    old = 'BO_ 257 M1: 8 A\n SG_ Value : 0|16@1+ (0.5,0) [0|32767] "V" B\n'
    assert old in text
    (tmp_path / "rig.dbc").write_text(text.replace(old, dbc))
    path.write_text(path.read_text().replace('message = "M1"\n', f'message = "M1"\n{keys}'))
    return path


CRC = 'crc = { signal = "Check" }\n'
COUNTER = 'counter = { signal = "Count" }\n'
OPENS = "opens reset, clear, communication, write, routine, dtc_setting, obd_clear, j1939_clear"


def test_a_condition_is_as_safe_as_its_signal(tmp_path):
    with pytest.raises(InputErrors) as wrong:
        Rig(protected(tmp_path, ""))
    (error,) = wrong.value.errors
    assert (error.key, error.value) == ("access.when[0].signal", "M1.Value")
    assert (
        f"b.M1 has no checksum, no counter and no SecOC here: one forged frame meets it and {OPENS};" in error.message
    )
    assert '[access] unprotected = ["M1.Value"]' in error.message


@pytest.mark.parametrize(
    ("keys", "rest", "said"),
    [
        ("", 'unprotected = ["M1.Value"]\n', "has no checksum and no counter: one forged frame meets it and "),
        (CRC, "", "has a checksum and no counter: a frame of before, sent again, meets it and "),
        (COUNTER, "", "has a counter and no checksum: a forged frame that counts on meets it and "),
        (CRC + COUNTER, "", None),
    ],
)
def test_what_a_frame_of_others_opens_is_told(tmp_path, keys, rest, said):
    rig = Rig(protected(tmp_path, keys, rest))
    told = rig.gateway.parts.forgeable
    rig.close()
    assert len(told) == (said is not None)
    for line in told:
        assert said in line
        assert OPENS in line


def test_a_signal_that_is_accepted_in_vain_is_refused(tmp_path):
    path = protected(tmp_path, CRC, 'unprotected = ["M1.Valeu"]\n')
    with pytest.raises(InputErrors, match=r"access\.unprotected\[0\] = 'M1.Valeu': no condition .*mean M1\.Value"):
        Rig(path)


def test_a_frame_with_a_wrong_checksum_opens_nothing(tmp_path):
    rig = Rig(protected(tmp_path, CRC))
    ask = Asked(rig)
    assert ask("1003")
    rig.value(1, 0.5)
    assert ask("1101") == "7f1122"
    rig.close()


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ("[output.uds]\n", ["anybody who begins the extended session"]),
        (f"[output.uds]\n{LEVEL}", []),
        ("[output.uds]\n" + STANDS, []),
        ("[output.uds]\n[output.obd]\n" + STANDS, []),
        (f"[output.uds]\n{LEVEL}clear = {{}}\n", ["access.clear: anybody"]),
        (f"[output.uds]\n{LEVEL}[access]\nroutine = {{}}\n", ["access.routine: anybody", "routine 0x0201"]),
        (f"[output.uds]\n{OPEN}[output.obd]\n[access]\nobd_clear = {{ allowed = true }}\n", ["obd_clear: OBD mode 04"]),
        (f"[output.uds]\n{OPEN}[output.j1939]\nallow_clear = true\n", ["j1939_clear: DM3 and DM11"]),
        ("[output.obd]\n", ["obd_clear: anybody on the bus can clear by OBD mode 04"]),
        (f"[output.uds]\n{LEVEL}[access]\nlocal_unlocked = true\n", ["local_unlocked: every user"]),
        (f"[output.uds]\n{LEVEL.replace(' }', ', seed_length = 2 }')}", ["seed_length"]),
    ],
)
def test_ways_around_are_told(tmp_path, extra, said):
    warnings = _ways_around(load_config(write_config(tmp_path, extra=extra)))
    assert len(warnings) == len(said), warnings
    for text, warning in zip(said, warnings, strict=True):
        assert text in warning


def test_secrets_that_anybody_can_read_are_told(tmp_path):
    path = write_config(tmp_path, extra=f"[output.uds]\n{LEVEL}")
    path.chmod(0o644)
    assert "chmod 600" in secrets_shown(load_config(path), path)[0]
    path.chmod(0o600)
    assert secrets_shown(load_config(path), path) == []
    bare = write_config(tmp_path, extra="[output.uds]\n")
    bare.chmod(0o644)
    assert secrets_shown(load_config(bare), bare) == []


def test_keys_of_before_mean_what_they_meant(uds):
    """``clear``, ``write`` and ``routine`` of the UDS server's own table; anyone may clear where it says so."""
    rig, ask = uds(uds='clear = { sessions = ["default", "extended"] }\n' + LEVEL)
    rig.fail(1)
    assert ask("14" + hexed(1)) == "54"
    _, ask = uds(uds='write = { sessions = ["extended"] }\n' + LEVEL)
    assert ask("1003")
    assert ask("2e01240a0b") == "6e0124"
    _, ask = uds(uds='routine = { sessions = ["default"] }\n' + LEVEL)
    assert ask("31010201") == "7101020100"


def test_the_condition_of_a_bus_is_the_gateways_own_to_tell(tmp_path):
    """A client of the hub could say that the bus is lost, and nothing would be overdue any more."""
    from gateway.bus.conditions import are_conditions
    from gateway.bus.frames import empty, put

    frames = empty(2)
    put(frames, 0, 0, ERROR, bytes([LOST, 0, 0, 0]))
    put(frames, 1, 0, 0x123, bytes(8))
    assert are_conditions(frames).tolist() == [True, False]


def test_everything_guarded_is_answered_by_its_rule(tmp_path):
    """Another rig, its rules all closed: nothing of what is guarded gets through by any protocol."""
    more = "".join(
        f"{name} = {{ security = 1 }}\n"
        for name in ("reset", "clear", "communication", "write", "routine", "dtc_setting")
    )
    rig = Rig(write_config(tmp_path, extra=EXTRA.format(uds=LEVEL) + SERVERS + "[access]\n" + more))
    ask = Asked(rig)
    rig.wait(300)
    rig.fail(0)
    assert ask("1003")
    for request in GUARDED:
        assert ask(request) == f"7f{request[:2]}33"
    assert by_mode_04(rig) == "7f0422"
    assert by_j1939(rig, 0xFED3) == by_j1939(rig, 0xFECC) == 2
    assert rig.status(0) == 0x2F
    rig.close()
