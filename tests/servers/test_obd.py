"""OBD on CAN, asked functionally and physically; expected bytes written by hand from SAE J1979."""

import struct

import pytest
from rig import FUNCTIONAL, Rig, Tester, write_config

from gateway.servers.tester_control import LatestResult
from gateway_ask.answers.decode import AnswerDecoder
from gateway_ask.answers.layout import j1979
from gateway_testers.obd.params import STANDARD, PidParams
from gateway_testers.obd.test_results import encode

EXTRA = """
[output.obd]
vin = "1HGCM82633A004352"
calibration = "GW-1"
calibration_check = 0x1234ABCD
ecu_name = "GATEWAY"
pid = [
    { id = 0x0C, signal = "M0.Value" },
    { id = 0x05, signal = "M1.Value" },
    { id = 0x0D, signal = "M2.Value" },
    { id = 0x2F, signal = "M2.Value" },
    { id = 0xA6, signal = "M2.Value", length = 4, scale = 0.1, offset = 0.0 },
]
"""

FAULTS = {
    0: "indicator = true\n",
    1: "confirm_cycles = 2\nemission_related = true\n",
    3: "emission_related = true\n",
}


@pytest.fixture
def rig(tmp_path):
    rig = Rig(write_config(tmp_path, 4, extra=EXTRA, faults=FAULTS))
    yield rig
    rig.close()


@pytest.fixture
def ask(rig):
    tester = Tester(rig)

    def send(request, functional=True):
        answers = tester.exchange(bytes.fromhex(request), functional=FUNCTIONAL if functional else None)
        return " ".join(answer.hex() for answer in answers)

    return send


@pytest.mark.evidence("SAE J1979: 01 00")
def test_mode_01_supported_pids(ask):
    def bits(answer):
        base = int(answer[2:4], 16)
        number = int(answer[4:12], 16)
        return [base + k + 1 for k in range(32) if number >> (31 - k) & 1]

    assert bits(ask("0100")) == [0x01, 0x05, 0x0C, 0x0D, 0x1C, 0x20]
    assert bits(ask("0120")) == [0x2F, 0x40]
    assert bits(ask("0140")) == [0x41, 0x60]
    assert bits(ask("0180")) == [0xA0]
    assert bits(ask("01a0")) == [0xA6]
    assert ask("01c0") == ""


@pytest.mark.evidence("SAE J1979: 01 values")
def test_mode_01_values(rig, ask):
    rig.value(0, 812.5)
    rig.value(1, 90)
    rig.value(2, 50)
    assert ask("010c") == "410c0cb2"
    assert ask("0105") == "410582"
    assert ask("010c050d") == "410c0cb205820d32", "several in the order asked"
    assert ask("012f") == "412f80"
    assert ask("01a6") == "41a6000001f4"
    assert ask("010b") == "", "not there: no answer"
    assert ask("010b", functional=False) == "7f0112"
    assert ask("010c0b") == "410c0cb2", "of several, those that are there"
    assert ask("011c") == "411c05"
    assert ask("01", functional=False) == "7f0112"


def test_usual_pids_are_coded_as_the_clients_layouts_read_them():
    """The layouts of the client are those that scripts/judge-j1979 compares with public readers."""
    layouts = {layout.identifier: AnswerDecoder(layout) for layout in j1979()}
    for pid, (length, *_) in STANDARD.items():
        coded = [raw.to_bytes(length, "big") for raw in (0, 1, (1 << 8 * length) // 3, (1 << 8 * length) - 1)]
        coding = PidParams(id=pid, signal="a.b")
        (values,) = layouts[pid].decode(coded).values
        assert [coding.encode(value) for value in values] == coded, hex(pid)
        assert [coding.encode(values[-1] + 1e9), coding.encode(values[0] - 1e9)] == [coded[-1], coded[0]], "clipped"


@pytest.mark.evidence("SAE J1979: 01 01")
def test_mode_01_mil_count_and_readiness(rig, ask):
    assert ask("0101") == "410100440000"
    rig.fail(0)
    rig.fail(2)
    rig.heal(1)
    assert ask("0101") == "410181440000", "the lamp is on, one DTC that OBD knows, one test to go"
    rig.heal(3)
    rig.heal(0)
    assert ask("0101") == "410181040000"
    rig.cycle()
    assert ask("0101") == "410181040000"
    assert ask("0141") == "414100440000", "in this cycle none has run"


@pytest.mark.evidence("SAE J1979: MIL")
def test_the_mil_is_that_of_mil_lamps_only(tmp_path):
    """D9: another lamp, on a dashboard's other side, is no MIL; and its DTC is no permanent one."""
    faults = {0: 'indicator = true\nlamp = "warning"\n', 3: "indicator = true\nemission_related = true\n"}
    rig = Rig(write_config(tmp_path, 4, extra=EXTRA, faults=faults))
    tester = Tester(rig)
    rig.fail(0)
    assert rig.status(0) == 0xAF
    assert tester.ask("0101").hex()[4:6] == "01", "one DTC, and the MIL is off"
    assert tester.ask("0a").hex() == "4a00"
    rig.fail(3)
    assert tester.ask("0101").hex()[4:6] == "82"
    assert tester.ask("0a").hex() == "4a01d003"
    rig.close()


def test_only_powertrain_codes_are_emission_related_by_themselves(tmp_path):
    """D5: mode 03 showed, and mode 04 cleared, brake, steering and network DTCs."""
    rig = Rig(write_config(tmp_path, 4, extra=EXTRA))
    tester = Tester(rig)
    for k in range(4):
        rig.fail(k)
    assert tester.ask("03").hex() == "43011000"
    assert tester.ask("04").hex() == "44"
    assert [rig.status(k) for k in range(4)] == [0x50, 0x2F, 0x2F, 0x2F]
    rig.close()


@pytest.mark.evidence("SAE J1979: 03", "SAE J1979: 04", "SAE J1979: 07", "SAE J1979: 0A")
def test_modes_03_07_0a_and_04(rig, ask):
    assert (ask("03"), ask("07"), ask("0a")) == ("4300", "4700", "4a00")
    for k in range(4):
        rig.fail(k)
    assert ask("03") == "4302" + "1000" + "d003", "confirmed and emission related"
    assert ask("07") == "4703" + "1000" + "5001" + "d003"
    assert ask("0a") == "4a01" + "1000", "only one asks for the indicator"
    assert ask("04") == "44"
    assert (ask("03"), ask("07")) == ("4300", "4700")
    assert ask("0a") == "4a011000"
    assert rig.status(2) == 0x2F, "what is not emission related is not cleared by OBD"
    assert ask("0300") == ""


@pytest.mark.evidence("SAE J1979: several frames")
def test_many_dtcs_come_in_several_frames(tmp_path):
    related = dict.fromkeys(range(130), "emission_related = true\n")
    rig = Rig(write_config(tmp_path, 130, extra=EXTRA, faults=related))
    tester = Tester(rig)
    for k in range(130):
        rig.fail(k)
    (answer,) = tester.exchange(b"\x03", functional=FUNCTIONAL)
    assert answer[:2] == b"\x43\x82"
    codes = [answer[k : k + 2].hex() for k in range(2, len(answer), 2)]
    assert len(codes) == 130
    assert tester.ask("0101").hex()[4:6] == "7f", "the most that its seven bits can say"
    assert codes == sorted(codes)
    rig.close()


@pytest.mark.evidence("SAE J1979: 02")
def test_mode_02_shows_the_frame_of_the_first_failure(rig, ask):
    assert ask("020200") == "4202000000", "no freeze frame"
    rig.value(0, 800)
    rig.value(2, 33)
    rig.fail(1)  # pending: shown, as it is all there is
    rig.value(0, 900)
    rig.fail(0)
    assert ask("020200") == "4202005001"
    assert ask("020c00") == "420c000c80", "as it was then"
    assert ask("020d00") == "420d0021"
    assert ask("020d01") == "", "there is one frame, number 0"
    assert ask("020000") == "420000" + "48180001"
    rig.gateway.controls.clear(0xFFFF33)
    assert ask("020200") == "4202000000"
    rig.fail(1)
    rig.cycle()
    rig.heal(1)
    assert ask("020200") == "4202005001", "pending until a cycle has passed without it"
    rig.cycle()
    rig.heal(1)
    assert rig.gateway.memory.entry("b.M1.length").freeze_frames, "it is kept, but neither pending nor confirmed"
    assert ask("020200") == "4202000000"


@pytest.mark.evidence("SAE J1979: 09 02", "SAE J1979: 09 04, 06", "SAE J1979: 09 0A")
def test_mode_09(ask):
    assert ask("0900") == "490054400000"
    assert ask("0902") == "490201" + b"1HGCM82633A004352".hex()
    assert ask("0904") == "490401" + b"GW-1".ljust(16, b"\0").hex()
    assert ask("0906") == "4906011234abcd"
    assert ask("090a") == "490a01" + b"GATEWAY".ljust(20, b"\0").hex()
    assert ask("0908") == ""


@pytest.mark.evidence("SAE J1979: 09 several")
def test_mode_09_takes_several_infotypes(ask):
    vin, name = b"1HGCM82633A004352".hex(), b"GATEWAY".ljust(20, b"\0").hex()
    assert ask("09020a08") == f"490201{vin}0a01{name}"
    assert ask("090020") == "490054400000"
    assert ask("0920") == ""
    assert ask("09" + "02" * 7) == "", "more than six"


# Mode 06: test results with their limits


def results(answer):
    """Return (monitor, test, scaling, value, minimum, maximum) of each result, as J1979 has them."""
    data = bytes.fromhex(answer)[1:]
    return [struct.unpack(">BBBhhh", data[k : k + 9]) for k in range(0, len(data), 9)]


@pytest.mark.evidence("SAE J1979: 06 00")
def test_mode_06_supported_monitors(ask):
    number = int(ask("06e0")[4:], 16)
    assert [0xE1 + k for k in range(32) if number >> (31 - k) & 1] == [0xE1, 0xE2, 0xE3], "the emission related ones"
    assert ask("0600") == "460000000001"
    assert ask("0600e0") == "460000000001" + ask("06e0")[2:]
    assert ask("0601") == "", "an oxygen sensor's"
    assert ask("0601", functional=False) == "7f0612"
    assert ask("06e1e2") == "", "results come one monitor at a time"


@pytest.mark.evidence("SAE J1979: 06")
def test_mode_06_gives_the_residual_and_its_threshold(rig, ask):
    assert results(ask("06e1")) == [(0xE1, 0x80, 0x81, 0, 0, 0)], "not tested yet"
    rig.fail(0)
    ((monitor, test, scaling, value, low, high),) = results(ask("06e1"))
    assert (monitor, test) == (0xE1, 0x80)
    step = {0x81: 1, 0x82: 0.1, 0x83: 0.01, 0x84: 0.001, 0x85: 0.0000305, 0x86: 0.000305}[scaling]
    entry = rig.gateway.memory.entry("b.M0.length")
    assert value * step == pytest.approx(entry.record.evidence["value"], abs=step)
    assert low * step == pytest.approx(entry.record.evidence["threshold"], abs=step), "bytes: at least so many"
    assert high == 0x7FFF
    assert value < low, "failed: outside"
    rig.heal(0)
    ((*_, value, low, high),) = results(ask("06e1"))
    assert low <= value <= high, "passed: within"
    assert ask("04") == "44"
    assert results(ask("06e1"))[0][3:] == (0, 0, 0), "cleared"


@pytest.mark.evidence("SAE J1979: 06")
@pytest.mark.parametrize(
    ("value", "limit", "failed", "wanted"),
    [
        (0.5, 0.25, True, (0x85, 16393, -0x8000, 8197)),
        (0.1, 0.25, False, (0x85, 3279, -0x8000, 8197)),
        (10.5, 11.0, True, (0x84, 10500, 11000, 0x7FFF)),
        (12.5, 11.0, False, (0x84, 12500, 11000, 0x7FFF)),
        (5.0, 3.0, True, (0x86, 16393, -0x8000, 9836)),
        (250.0, 3.0, True, (0x83, 25000, -0x8000, 300)),
        (-2000.0, 3000.0, False, (0x82, -20000, -0x8000, 30000)),
        (1e9, 30000.0, True, (0x81, 0x7FFF, -0x8000, 30000)),
        (float("nan"), 1.0, True, (0x81, 0, 0, 0)),
    ],
)
def test_results_are_scaled_so_that_they_fit(value, limit, failed, wanted):
    assert struct.unpack(">Bhhh", encode(LatestResult(value, limit, failed))) == wanted


# OBD on UDS (SAE J1979-2)


@pytest.mark.evidence("SAE J1979: OBDonUDS")
def test_obd_on_uds(tmp_path):
    rig = Rig(write_config(tmp_path, 4, extra=EXTRA + "[output.uds]\n", faults=FAULTS))
    tester = Tester(rig)
    rig.value(0, 812.5)
    rig.fail(0)

    def ask(request):
        return tester.ask(request).hex()

    def other(mode, number):
        return tester.ask(bytes([mode, number])).hex()

    assert ask("22f40c") == "62f40c" + other(1, 0x0C)[4:]
    assert ask("22f401") == "62f401" + other(1, 0x01)[4:]
    assert ask("22f400") == "62f400" + other(1, 0x00)[4:]
    assert ask("22f6e0") == "62f6e0" + other(6, 0xE0)[4:]
    assert ask("22f6e1") == "62f6e1" + other(6, 0xE1)[4:], "the number of the monitor is in the identifier"
    assert ask("22f802") == "62f802" + b"1HGCM82633A004352".hex()
    assert ask("22f800") == "62f800" + other(9, 0x00)[4:]
    assert ask("22f40cf802beef").startswith("62f40c0cb2f802")
    for missing in ("22f40b", "22f601", "22f808", "22f501"):
        assert ask(missing) == "7f2231"
    assert ask("195533").startswith("595533ff04")
    assert ask("194233ff00") == "594233ffff04", "an empty mask finds none"
    rig.close()


@pytest.mark.evidence("SAE J1979: unknown")
def test_modes_that_there_are_not(ask):
    assert ask("05") == ""
    assert ask("0501", functional=False) == "7f0511"
    assert ask("22f190", functional=False) == "7f2211", "there is no UDS server behind this address"


@pytest.mark.evidence("SAE J1979: 29 bit")
def test_29_bit_identifiers(tmp_path):
    ids = "request = 0x18DA10F1\nfunctional = 0x18DB33F1\nresponse = 0x18DAF110\n"
    rig = Rig(write_config(tmp_path, extra=EXTRA.replace("[output.obd]\n", f"[output.obd]\n{ids}")))
    tester = Tester(rig, 0x18DA10F1, 0x18DAF110)
    (answer,) = tester.exchange(b"\x09\x02", functional=0x18DB33F1)
    assert answer == b"\x49\x02\x011HGCM82633A004352"
    rig.close()
