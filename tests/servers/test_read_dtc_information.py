"""0x19 and 0x86: what a tester reads of the fault memory, and what it is told by itself."""

import struct

import pytest
import udsoncan
from amount import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rig import Rig, dtc_text, write_config
from uds_tester import ANYBODY, EXTRA, Asked, hexed
from udsoncan.services import ReadDTCInformation

from gateway.faults.dtc import Dtc

# 0x19


FAULTS = {
    0: 'severity = "immediately"\nfunctional_unit = 7\nfreeze_frame = ["M1.Value", "volts", "M0.Value"]\n',
    1: 'severity = "maintenance"\nindicator = true\nconfirm_cycles = 2\nemission_related = true\n',
    2: "emission_related = false\n",
}


@pytest.mark.evidence(
    "ISO 14229-1: 0x19 01",
    "ISO 14229-1: 0x19 02",
    "ISO 14229-1: 0x19 03",
    "ISO 14229-1: 0x19 04",
    "ISO 14229-1: 0x19 06",
    "ISO 14229-1: 0x19 07",
    "ISO 14229-1: 0x19 08",
    "ISO 14229-1: 0x19 09",
    "ISO 14229-1: 0x19 0A",
    "ISO 14229-1: 0x19 0B",
    "ISO 14229-1: 0x19 0C",
    "ISO 14229-1: 0x19 0D",
    "ISO 14229-1: 0x19 0E",
    "ISO 14229-1: 0x19 14",
    "ISO 14229-1: 0x19 15",
    "ISO 14229-1: 0x19 42",
    "ISO 14229-1: 0x19 55",
)
def test_every_sub_function(uds):
    rig, ask = uds(faults=FAULTS, more=ANYBODY)
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
    assert ask("1903") == f"5903{a}01", "fault 1 has a freeze frame with nothing in it"
    assert ask(f"1904{a}01") == f"5904{a}2f" + "0102" + "4000" + struct.pack(">f", 4.0).hex() + "01230014"
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


@pytest.mark.evidence("ISO 14229-1: 0x19 03")
def test_a_record_without_content_is_not_listed(uds):
    """D15: 19 03 listed record 01 of a fault without freeze frame signals, 19 04 then had none."""
    rig, ask = uds(faults={0: 'freeze_frame = ["M1.Value"]\n'})
    rig.fail(0)
    rig.fail(1)
    assert ask("1903") == f"5903{hexed(0)}01"
    for k in (0, 1):
        listed = hexed(k) in ask("1903")
        assert listed == (len(ask(f"1904{hexed(k)}ff")) > len(f"5904{hexed(k)}2f"))


@pytest.mark.evidence("ISO 14229-1: 0x19 05")
def test_stored_data_by_record_number(uds):
    rig, ask = uds(faults=dict.fromkeys((0, 2), 'freeze_frame = ["volts"]\n'))
    assert ask("190501") == "590501", "none"
    rig.value(0, 5.0)
    for k in (2, 1, 0):
        rig.fail(k)
    first, second = (f"{n:02x}{hexed(k)}2f0101230014" for n, k in ((1, 2), (2, 0)))
    assert ask("190501") == f"5905{first}", "in the order of the failures"
    assert ask("190502") == f"5905{second}"
    assert ask("190503") == "590503"
    assert ask("1905ff") == f"5905{first}{second}"
    assert ask("190500") == "7f1931", "reserved for OBD"
    assert ask("1905") == "7f1913"


@pytest.mark.evidence("ISO 14229-1: 0x19 16", "ISO 14229-1: 0x19 1A")
def test_one_extended_data_record_of_every_dtc(uds):
    rig, ask = uds()
    for k in (1, 2):
        rig.fail(k)
    rig.heal(2)
    rig.fail(2)
    entries = "".join(sorted(f"{hexed(k)}2f{count:02x}" for k, count in ((1, 1), (2, 2))))
    assert ask("191601") == "591601" + entries
    assert ask("191a01") == "591aff01" + "".join(sorted(f"{hexed(k)}2f" for k in (1, 2)))
    assert ask("191677") == ask("191a77") == "7f1931"


@pytest.mark.evidence("ISO 14229-1: 0x19 17", "ISO 14229-1: 0x19 18", "ISO 14229-1: 0x19 19")
def test_what_testers_did_is_the_user_defined_memory(uds):
    rig, ask = uds()
    assert ask("1917ff01") == "591701ff"
    assert ask("1003")
    assert ask("1101")
    assert ask("1101") == "7f117f"
    assert ask("8502") == "7f857f"
    rig.wait(1)
    reset, setting = "df1168", "df8568"
    assert ask("1917ff01") == f"591701ff{reset}08{setting}04", "done, or only refused"
    assert ask("19170801") == f"591701ff{reset}08"
    assert ask("1917ff02") == "7f1931", "there is one such memory"
    answer = ask(f"1918{reset}0101")
    assert answer.startswith(f"591801{reset}0801" + "01fd10")
    assert answer.endswith("11010000000000" + "7f"), "the latest: refused"
    assert ask(f"1918{reset}ff01").count("fd10") == 2
    assert ask(f"1919{reset}0101") == f"591901{reset}080102"
    assert ask(f"1919{setting}ff01").startswith(f"591901{setting}040101" + "10")
    assert ask("1918abcdefff01") == ask(f"1919{reset}9901") == ask(f"1918{reset}0001") == "7f1931"


@pytest.mark.evidence("ISO 14229-1: 0x19 56")
def test_dtcs_by_readiness_group(uds):
    rig, ask = uds(faults={0: 'readiness = "egr"\n', 1: 'readiness = "egr"\n'})
    rig.fail(0)
    egr = 11
    assert ask(f"195633{egr:02x}") == f"595633ff04{egr:02x}{hexed(0)}2f", "only what is emission related"
    assert ask(f"1956ff{egr:02x}") == f"5956ffff04{egr:02x}" + "".join(sorted((hexed(0) + "2f", hexed(1) + "50")))
    assert ask("19563399") == ask("19561203") == "7f1931"


@pytest.mark.evidence("ISO 14229-1: 0x19 06", "AUTOSAR DEM: extended data")
def test_extended_data_is_what_the_memory_knows(uds):
    rig, ask = uds()
    rig.fail(0)
    rig.heal(0)
    rig.fail(0)
    first, last = rig.gateway.memory.entry("b.M0.length").record.first_ns, rig.now
    answer = bytes.fromhex(ask(f"1906{hexed(0)}ff"))
    assert answer[6:8] == b"\x01\x02"
    at = answer.index(b"\x10" + struct.pack(">q", first))
    assert answer[at + 9 : at + 18] == b"\x11" + struct.pack(">q", last)
    (length,) = struct.unpack(">d", bytes.fromhex(ask(f"1906{hexed(0)}20"))[-8:])
    assert length == 1.0, "the evidence: so many bytes came"


def causes_of(record):
    """Decode record 30 by docs/diagnostics.md: role, confirmation, lead, and what is left over; causes with names."""
    role, hold, lead, count = record[0], record[1], record[2:5].hex(), record[5]
    rest, causes = record[6:], []
    for _ in range(count):
        probability, components = struct.unpack(">HB", rest[:3])
        rest, names = rest[3:], []
        for _ in range(components):
            names.append(rest[1 : 1 + rest[0]].decode())
            rest = rest[1 + rest[0] :]
        causes.append((names, probability / 1e4))
    return role, hold, lead, causes, rest


def test_what_explains_a_fault_is_an_extended_data_record(uds):
    """Read by udsoncan; the memory says the same."""
    rig, ask = uds()
    rig.fail(0)
    assert ask(f"1906{hexed(0)}30") == f"5906{hexed(0)}2f", "not known yet"
    rig.wait(200)
    answer = bytes.fromhex(ask(f"1906{hexed(0)}30"))
    kind = ReadDTCInformation.Subfunction.reportDTCExtendedDataRecordByDTCNumber
    response = udsoncan.Response.from_payload(answer)
    read = ReadDTCInformation.interpret_response(response, kind, extended_data_size=len(answer) - 7)
    (record,) = read.service_data.dtcs[0].extended_data
    assert record.record_number == 0x30
    role, hold, lead, causes, rest = causes_of(record.raw_data)
    cause = rig.gateway.memory.entry(rig.fault(0)).record.cause
    assert (role, hold, rest) == (["open", "cause", "symptom"].index(cause.role), 0, b"")
    assert lead == (hexed(0) if cause.proven else "000000")
    assert causes == [(list(one.components), pytest.approx(one.probability, abs=1e-4)) for one in cause.ranked]
    assert causes[0][0]
    assert ask("191a30") == f"591aff30{hexed(0)}2f"


@pytest.mark.evidence("ISO 14229-1: 0x19 mask")
def test_the_availability_mask_hides_bits_everywhere(uds):
    rig, ask = uds(uds="status_mask = 0x09", messages=1)
    rig.fail(0)
    assert ask("1902ff") == f"590209{hexed(0)}09"
    assert ask("190220") == "590209"
    assert ask("1901f6") == "590109000000"


@pytest.mark.evidence("ISO 14229-1: 0x19 02")
@settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
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
    rig = Rig(write_config(tmp_path_factory.mktemp("rig"), 5, extra=EXTRA.format(uds="") + ANYBODY))
    yield rig, Asked(rig)
    rig.close()


@pytest.mark.evidence("ISO 14229-1: 0x19 long")
def test_more_than_fifty_dtcs_in_one_answer(uds):
    rig, ask = uds(messages=120)
    for k in range(120):
        rig.fail(k)
    answer = bytes.fromhex(ask("190208", patience=400))
    assert len(answer) == 3 + 4 * 120
    assert answer[3:] == b"".join(sorted(bytes(Dtc.parse(dtc_text(k))) + b"\x2f" for k in range(120)))


# 0x86


@pytest.mark.evidence("ISO 14229-1: 0x86 01")
def test_responses_on_status_changes(uds):
    rig, ask = uds()
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


@pytest.mark.evidence("ISO 14229-1: 0x86 session")
def test_responses_on_events_end_with_the_session(uds):
    rig, ask = uds()
    assert ask("1003")
    assert ask("86010201190d").startswith("c601")
    assert ask("860502") == "c6050002"
    assert ask("1001")
    assert not any(can_id == 0x7E8 for can_id, _ in rig.fail(0))
    assert ask("860402") == "c60400"


@pytest.mark.evidence("ISO 14229-1: 0x86 window")
def test_the_window_of_responses_on_events(uds):
    rig, ask = uds()
    assert ask("86010301190d").startswith("c601")
    assert ask("860503") == "c6050003"
    assert any(can_id == 0x7E8 for can_id, _ in rig.fail(0))
    rig.wait(30_001, step=1000)
    assert not any(can_id == 0x7E8 for can_id, _ in rig.fail(1)), "three times 10 s are over"


def test_the_severity_byte_is_severity_and_class(uds):
    """ISO 14229-1, annex D.3: three bits; global technical regulation 5: the other five."""
    both = [("none", "c"), ("maintenance", "a"), ("immediately", "b2")]
    faults = {k: f'severity = "{one}"\ndtc_class = "{other}"\n' for k, (one, other) in enumerate(both)}
    for asked, wanted in ((faults, "10 22 88"), ({0: 'severity = "next_halt"\ndtc_class = "b1"\n'}, "44 01 01")):
        _, ask = uds(faults=asked)
        assert " ".join(ask(f"1909{hexed(k)}")[6:8] for k in range(3)) == wanted
