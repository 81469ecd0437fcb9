"""The responder's fault memory, read as testers read it, and the faults of its answers."""

import numpy as np
import pytest
from responder_bench import ECU, Client, write
from udsoncan import Response
from udsoncan.services import ReadDTCInformation

from gateway.bus.frames import payload
from gateway_bench.vecu.responder.memory import DtcMemory, StoredDtc
from gateway_fdi.errors import GatewayError

MEMORY = """
[[ecu.uds.dtc]]
code = "P0301-00"
status = 0x2F
snapshot = "01 F4 0C 1A F8"
extended = "05"
permanent = true
[[ecu.uds.dtc]]
code = "U0100-87"
status = 0x04
from_s = 2.0
"""
STUB = ECU.replace('"19 02*" = "59 02 FF C1 23 45 2F"\n', "").replace(
    "[ecu.uds.identifiers]", f"{MEMORY}[ecu.uds.identifiers]"
)


@pytest.fixture
def bench(tmp_path):
    def made(faults=""):
        return Client(write(tmp_path, STUB + faults))

    return made


def wait(tester, seconds):
    for _ in range(int(seconds * 100)):
        tester.step(10_000_000)


def test_its_memory_is_read_as_udsoncan_reads_it(bench):
    tester = bench()
    wait(tester, 2.1)
    answer = Response.from_payload(bytes.fromhex(tester.ask("19 02 FF")))
    found = ReadDTCInformation.interpret_response(answer, subfunction=2)
    read = [(dtc.id, dtc.status.get_byte_as_int()) for dtc in found.service_data.dtcs]
    assert read == [(0x030100, 0x2F), (0xC10087, 0x04)]
    assert tester.ask("19 02 08") == "59 02 FF 03 01 00 2F"
    assert tester.ask("19 01 FF") == "59 01 FF 00 00 02"
    assert tester.ask("19 04 03 01 00 FF") == "59 04 03 01 00 2F 01 01 F4 0C 1A F8"
    assert tester.ask("19 06 03 01 00 01") == "59 06 03 01 00 2F 01 05"
    assert [tester.ask(mode) for mode in ("03", "07", "0A")] == ["43 01 03 01", "47 02 03 01 C1 00", "4A 01 03 01"]


def test_what_it_does_not_have_is_refused(bench):
    tester = bench()
    asked = {
        "19": "7F 19 13",
        "19 02": "7F 19 13",
        "19 55 00": "7F 19 12",
        "19 04 12 34 56 FF": "7F 19 31",
        "19 04 C1 00 87 FF": "7F 19 31",  # not yet set
        "14 FF FF": "7F 14 13",
        "14 12 34 56": "7F 14 31",
        "03 01": "7F 03 13",
    }
    assert {request: tester.ask(request) for request in asked} == asked


def test_only_a_clear_empties_it(bench):
    tester = bench()
    tester.ask("14 C0 00 00")  # of networks: the other one stays
    assert tester.ask("19 02 2F") == "59 02 FF 03 01 00 2F"
    assert tester.ask("14 FF FF FF") == "54"
    assert tester.ask("19 02 2F") == "59 02 FF"
    assert tester.ask("19 04 03 01 00 FF") == "59 04 03 01 00 50"  # its snapshot is gone
    assert (tester.ask("03"), tester.ask("0A")) == ("43 00", "4A 01 03 01")
    wait(tester, 2.1)  # a fault that comes later is not cleared
    assert tester.ask("07") == "47 01 C1 00"
    assert (tester.ask("04"), tester.ask("07")) == ("44", "47 00")


def fault(kind, **keys):
    lines = "".join(f"{key} = {value}\n" for key, value in keys.items())
    return f'[[fault]]\necu = "abs"\nkind = "{kind}"\n{lines}'


def sent(tester, request, seconds):
    """Return time [ms] and bytes of the frames that answer a request of one frame."""
    tester.step()
    data = bytes.fromhex(request)
    tester.send(0x7E1, bytes([len(data)]) + data)
    begin, found = tester.now_ns, []
    for _ in range(int(seconds * 1000)):
        frames = tester.step()
        found += [
            (round((int(frame["t_ns"]) - begin) / 1e6), payload(frame)) for frame in frames[frames["can_id"] == 0x7E9]
        ]
    return found


def test_slow_and_mute_and_refusing(bench):
    ((ms, data),) = sent(bench(fault("slow", by_ms=300)), "3E 00", 0.5)
    assert (ms, data[:3]) == (305, b"\x02\x7e\x00")
    assert sent(bench(fault("mute")), "3E 00", 0.5) == []
    ((_, data),) = sent(bench(fault("refuse", code=0x21)), "22 F1 87", 0.1)
    assert data[:4] == b"\x03\x7f\x22\x21"


def test_announced_for_ever_and_answered_when_the_fault_is_over(bench):
    found = sent(bench(fault("pending", by_ms=100, to_s=0.35)), "3E 00", 1.0)
    assert [data[1] for _, data in found] == [0x7F, 0x7F, 0x7F, 0x7F, 0x7E]
    assert np.diff([ms for ms, _ in found]).tolist() == [100] * 4
    found = sent(bench(fault("pending", by_ms=100)), "3E 00", 3.0)
    assert {data[1:4] for _, data in found} == {b"\x7f\x3e\x78"}
    assert len(found) == 30


def test_the_answer_of_another_request(bench):
    tester = bench(fault("echo"))
    assert tester.ask("22 F1 87") == "62 F1 86 01 02 FF"
    assert tester.ask("3E 00") == "7E 01"
    assert tester.ask("22 12 34") == "7F 22 31"  # a refusal stays what it is


def test_wrong_sequence_numbers_and_a_reset_in_the_middle(bench):
    tester = bench(fault("sequence", to_s=1.0))
    assert tester.ask("22 F1 90") is None
    wait(tester, 1)
    tester.layer.reset()
    assert tester.ask("22 F1 90").startswith("62 F1 90")
    tester = bench(fault("reset", by_ms=500, to_s=0.05))
    assert tester.ask("22 F1 90", 0.1) is None  # the first frame came, and no other
    tester.layer.reset()
    assert tester.ask("3E 00", 0.1) is None  # it is off
    wait(tester, 0.6)
    assert tester.ask("3E 00") == "7E 00"


def test_a_share_of_the_requests_by_the_seed(bench):
    runs = []
    for _ in range(2):
        tester = bench(fault("mute", probability=0.5))
        runs.append([tester.ask("3E 00", 0.05) for _ in range(60)])
    assert runs[0] == runs[1]  # the scenario's seed
    assert 15 < runs[0].count(None) < 45


def test_mistakes_are_told(tmp_path):
    for text, said in (
        (fault("slow", by_ms=-1), "by_ms"),
        (fault("mute", from_s=2, to_s=1), "after from_s"),
        (fault("mute", code='"x"'), "code"),
        (fault("dumb"), "slow, pending, sequence, reset, mute, echo, refuse"),
    ):
        with pytest.raises(GatewayError) as told:
            write(tmp_path, STUB + text)
        assert said in str(told.value)
    with pytest.raises(GatewayError, match="a DTC is a letter"):
        write(tmp_path, STUB.replace("P0301-00", "X0301"))
    only = '[[ecu]]\ntype = "responder"\nname = "abs"\n[[ecu.reply]]\non = "Ask"\nsend = "Answer"\n'
    with pytest.raises(GatewayError, match=r"no \[ecu.uds\]"):
        write(tmp_path, only + fault("mute"))


def test_a_memory_of_obd_on_uds_tells_the_emission_system_alone():
    stored = [StoredDtc(code="P0301-00", permanent=True, severity=0x04), StoredDtc(code="U0100-87", status=0x08)]
    newer, older = (DtcMemory(stored, protocol) for protocol in ("obd_on_uds", "obd"))
    for memory, request, answer in (
        (newer, "194233AFFF", "594233FFFF040403010 02F"),
        (newer, "1942FF0802", "5942FFFFFF0402C1008708"),
        (newer, "195533", "595533FF040301002F"),
        (newer, "1942D0AFFF", "7F1931"),
        (newer, "1902AF", "7F1912"),
        (newer, "194233AF", "7F1913"),
        (older, "194233AFFF", "7F1912"),
    ):
        assert memory.answer(bytes.fromhex(request), 0) == bytes.fromhex(answer.replace(" ", "")), request
    assert (0x03 in newer.services, 0x03 in older.services) == (False, True)
