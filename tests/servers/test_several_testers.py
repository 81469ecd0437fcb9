"""Several testers at several addresses of one server: each has its session, and what blinds ends with the last one."""

import pytest
from rig import Tester, write_config
from test_access import LEVEL, unlock
from uds_tester import Asked

from gateway.config.load import load_config
from gateway_fdi.errors import InputErrors

FURTHER = "further = [{ request = 0x7E4, response = 0x7EC }, { request = 0x18DA10F1, response = 0x18DAF110 }]\n"


@pytest.fixture
def three(uds):
    def build(uds_lines="", **options):
        rig, first = uds(uds=uds_lines + FURTHER, **options)
        return rig, first, Asked(rig, 0x7E4, 0x7EC), Asked(rig, 0x18DA10F1, 0x18DAF110)

    return build


@pytest.mark.evidence("ISO 14229-1: 0x22 F186", "ISO 14229-2: testers")
def test_each_has_its_own_session_and_security(three):
    _, a, b, c = three(LEVEL)
    assert a("1003")
    unlock(a)
    assert (a("22f186"), b("22f186"), c("22f186")) == ("62f18603", "62f18601", "62f18601")
    assert b("1003")
    assert b("14ffffff") == "7f1433", "what one has unlocked is locked to the others"
    assert c("14ffffff") == "7f147f"
    assert a("14ffffff") == "54"
    assert b("1001")
    assert a("22f186") == "62f18603"


@pytest.mark.evidence("ISO 14229-1: 0x27 all")
def test_wrong_keys_count_for_all_of_them(three):
    _, a, b, c = three(LEVEL.replace(" }", ", attempts = 3 }"))
    for ask in (a, b, c):
        assert ask("1003")
    for ask, answer in ((a, "7f2735"), (b, "7f2735"), (c, "7f2736")):
        assert ask("2701")
        assert ask("270200000000") == answer
    assert a("2701") == "7f2737"


@pytest.mark.evidence("ISO 14229-2: last one")
def test_what_two_have_switched_off_is_on_when_both_have_ended(three):
    rig, a, b, _ = three()
    assert a("1003")
    assert b("1003")
    assert a("8502") == b("8502") == "c502"
    assert a("1001")
    rig.fail(0)
    assert rig.status(0) == 0x50, "one has it off still"
    assert b("8501") == "c501"
    rig.fail(0)
    assert rig.status(0) == 0x2F


def test_an_idle_one_ends_by_itself(three):
    rig, a, b, _ = three()
    assert a("1003")
    assert b("1003")
    for _ in range(3):
        rig.wait(2000)
        assert b("3e80") == ""
    assert (a("22f186"), b("22f186")) == ("62f18601", "62f18603")


@pytest.mark.evidence("ISO 15765-2: interleaved")
def test_long_answers_go_to_all_of_them_at_once(three):
    rig, _, b, _ = three(messages=40)
    for k in range(40):
        rig.fail(k)
    rig.feed((0x7E0, bytes.fromhex("03190208")))
    assert len(bytes.fromhex(b("190208", patience=100))) == 3 + 4 * 40
    assert len(rig.feed((0x7E0, bytes.fromhex("300000")))) == 23


@pytest.mark.evidence("ISO 14229-1: 0x11 sessions")
def test_a_reset_by_one_ends_the_sessions_of_all(three):
    _, a, b, c = three()
    for ask in (a, b, c):
        assert ask("1003")
    assert b("1101") == "5101"
    assert (a("22f186"), c("22f186")) == ("62f18601", "62f18601")


def test_who_it_was_is_in_the_trace(three):
    rig, _, b, _ = three()
    assert b("1003")
    assert b("1101")
    rig.wait(1)
    assert [each.address for each in rig.gateway.memory.interventions()] == [0x7E4]


def test_obd_is_behind_the_first_address_only(three):
    rig, *_ = three(more="[output.obd]\n")
    assert Tester(rig).ask("0101").hex().startswith("4101")
    assert Tester(rig, 0x7E4, 0x7EC).ask("0101").hex() == "7f0111"


@pytest.mark.parametrize(
    ("further", "key"),
    [
        ("{ request = 0x7E0, response = 0x7EC }", "further[0].request"),
        ("{ request = 0x7E4, response = 0x7E8 }", "further[0].response"),
        ("{ request = 0x7E4, response = 0x7EC, functional = 0x7DF }", "further[0].functional"),
        ("{ request = 0x7E4, response = 0x7EC, bus = 'c' }", "further[0].bus"),
        ("{ request = 1, response = 2 }, { request = 3, response = 1 }", "further[1].response"),
    ],
)
def test_addresses_that_are_taken_are_refused(tmp_path, further, key):
    with pytest.raises(InputErrors) as raised:
        load_config(write_config(tmp_path, extra=f"[output.uds]\nfurther = [{further}]\n"))
    assert key in str(raised.value)
