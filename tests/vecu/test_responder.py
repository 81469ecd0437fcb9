"""Stubs of ECUs that answer: UDS to can-isotp and udsoncan, messages to messages."""

import struct

import numpy as np
import pytest
from responder_bench import DATABASE, ECU, Client, write

from gateway.bus.frames import payload
from gateway_fdi.errors import GatewayError

ANSWERS = {
    "3E 00": "7E 00",
    "3E 80": None,  # no positive answer is wanted
    "10 03": "50 03 00 32 01 F4",
    "19 02 0D": "59 02 FF C1 23 45 2F",
    "22 F1 90": "62 F1 90 " + b"WVWZZZ1JZXW000001".hex(" ").upper(),  # several frames, and flow control
    "22 F1 87": "62 F1 87 01 02 FF",
    "22 F1 87 01 00": "62 F1 87 01 02 FF 01 00 00 00",  # two at once; nobody has sent the voltage yet
    "22 00 01": "62 00 01 07",
    "22 12 34": "7F 22 31",
    "31 01 FF 00": "7F 31 11",
    "19 01 FF": "7F 19 31",
}


@pytest.fixture
def tester(tmp_path):
    return Client(write(tmp_path, ECU))


def test_uds(tester):
    assert {request: tester.ask(request) for request in ANSWERS} == ANSWERS


def test_an_identifier_that_is_a_signal_follows_it(tester):
    tester.send(258, DATABASE.encode_message("State", {"Volts": 12.34, "Depth": -2, "Share": 0.1}))
    tester.step()
    assert tester.ask("22 01 00") == "62 01 00 04 D2"
    assert tester.ask("22 01 01") == "62 01 01 FF FE"
    assert tester.ask("22 01 02") == f"62 01 02 {struct.pack('>f', 0.1).hex(' ').upper()}"


def test_a_request_to_all_is_answered_and_what_is_not_known_is_not(tester):
    for request, wanted in (("3E 00", 1), ("31 01", 0)):
        data = bytes.fromhex(request)
        tester.send(0x7DF, bytes([len(data)]) + data)
        frames = np.concatenate([tester.step() for _ in range(20)])
        assert int((frames["can_id"] == 0x7E9).sum()) == wanted


def test_its_answer_takes_as_long_as_it_says(tester):
    tester.step()
    tester.send(0x7E1, bytes.fromhex("023E00"))
    asked = tester.now_ns
    frames = np.concatenate([tester.step() for _ in range(10)])
    assert [int(t) - asked for t in frames["t_ns"]] == pytest.approx([5e6], abs=1e6)


def test_messages_answer_messages(tester):
    seen = []
    for page, token in ((1, 7), (2, 4711), (3, 5), (2, 12)):
        tester.send(256, DATABASE.encode_message("Ask", {"Page": page, "Token": token}))
        for frame in np.concatenate([tester.step() for _ in range(40)]):
            seen.append(DATABASE.decode_message(int(frame["can_id"]), payload(frame)))
    assert seen == [
        {"Page": 1, "Serial": 305419896, "COUNTER": 0},
        {"Page": 2, "Token": 4711, "COUNTER": 1},
        {"Page": 2, "Token": 12, "COUNTER": 2},
    ]


WRONG = {
    'on = "Ask"': ('on = "Aks"', "ecu[0].reply[0].on", "did you mean Ask?"),
    'send = "Answer"': ('send = "Answr"', "ecu[0].reply[0].send", "did you mean Answer"),
    "Ask.Page == 1": ("Ask.Pge == 1", "ecu[0].reply[0].when", "did you mean Page?"),
    "Serial = 305419896": ("Serial = 3e10", "ecu[0].reply[0].signals.Serial", "it can carry"),
    "Serial = 305": ("COUNTER = 305", "ecu[0].reply[0].signals.COUNTER", "protection makes"),
    '"Ask.Token"': ('"Ask.Tken"', "ecu[0].reply[1].echo.Token", "did you mean Token?"),
    '"7E 00"': ('"7E 0"', "ecu[0].uds.answers", "bytes in hex"),
    "0x7E1": ("0x7E10", "ecu[0].uds", "extended = true"),
    "F190 =": ("F19 =", "ecu[0].uds", "four digits in hex"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_mistakes_are_told(wrong, tmp_path):
    text, place, why = WRONG[wrong]
    assert wrong in ECU
    with pytest.raises(GatewayError) as told:
        write(tmp_path, ECU.replace(wrong, text, 1))
    assert place in str(told.value)
    assert why in str(told.value)
