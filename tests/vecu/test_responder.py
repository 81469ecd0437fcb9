"""Stubs of ECUs that answer: UDS to can-isotp and udsoncan, messages to messages."""

import struct

import cantools
import isotp
import numpy as np
import pytest

from gateway.bus.frames import empty, payload, put
from gateway.config.load import load_config
from gateway_bench.playing import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.errors import GatewayError

DBC = """VERSION ""
BU_: A B
BO_ 256 Ask: 8 A
 SG_ Page : 0|8@1+ (1,0) [0|255] "" B
 SG_ Token : 8|16@1+ (1,0) [0|65535] "" B
BO_ 257 Answer: 8 B
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" A
 SG_ Serial m1 : 8|32@1+ (1,0) [0|0] "" A
 SG_ Token m2 : 8|16@1+ (1,0) [0|65535] "" A
 SG_ COUNTER : 56|4@1+ (1,0) [0|15] "" A
BO_ 258 State: 8 B
 SG_ Volts : 0|16@1+ (0.01,0) [0|60] "V" A
 SG_ Depth : 16|16@1- (1,0) [-32768|32767] "m" A
 SG_ Share : 32|32@1- (1,0) [0|0] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
SIG_VALTYPE_ 258 Share : 1;
"""
ECU = """
[[ecu]]
type = "responder"
name = "abs"
[ecu.uds]
request = 0x7E1
response = 0x7E9
functional = 0x7DF
[ecu.uds.identifiers]
F190 = "WVWZZZ1JZXW000001"
F187 = "0x0102FF"
0100 = "State.Volts"
0101 = "State.Depth"
0102 = "State.Share"
[ecu.uds.answers]
"3E 00" = "7E 00"
"10 03" = "50 03 00 32 01 F4"
"19 02*" = "59 02 FF C1 23 45 2F"
"22 00 01" = "62 00 01 07"
[[ecu.reply]]
on = "Ask"
when = "Ask.Page == 1"
send = "Answer"
signals = { Page = 1, Serial = 305419896 }
[[ecu.reply]]
on = "Ask"
when = "Ask.Page == 2"
send = "Answer"
signals = { Page = 2 }
echo = { Token = "Ask.Token" }
delay_ms = 20
"""
DATABASE = cantools.database.load_string(DBC, strict=False)


def write(folder, ecu):
    (folder / "a.dbc").write_text(DBC)
    (folder / "gateway.toml").write_text('[[bus]]\nname = "can"\nuri = "virtual:x"\ndatabase = ["a.dbc"]\n')
    file = folder / "s.toml"
    file.write_text('name = "s"\nduration_s = 60\nconfig = "gateway.toml"\n' + ecu)
    scenario = load_scenario(file)
    return player_of(scenario, load_config(scenario.config))


class Client:
    """can-isotp on the other end, by the scenario's clock."""

    def __init__(self, player):
        self.player, self.now_ns, self.said, self.heard = player, 0, [], []
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7E1, rxid=0x7E9)
        self.layer = isotp.TransportLayerLogic(
            lambda _: self.heard.pop(0) if self.heard else None,
            lambda message: self.send(message.arbitration_id, bytes(message.data)),
            address,
        )

    def send(self, can_id, data):
        frame = empty(1)
        put(frame, 0, self.now_ns, can_id, data)
        self.said.append(frame)

    def step(self, ns=1_000_000):
        for frame in self.said:
            self.player.hear(frame)
        self.said = []
        self.now_ns += ns
        frames = self.player.take(self.now_ns)
        assert (np.diff(frames["t_ns"]) >= 0).all()
        for frame in frames:
            if frame["can_id"] == 0x7E9:
                self.heard.append(isotp.CanMessage(arbitration_id=0x7E9, data=payload(frame)))
        return frames

    def ask(self, request, seconds=0.5):
        self.layer.send(bytes.fromhex(request))
        end = self.now_ns + seconds * 1e9
        while self.now_ns < end:
            self.layer.process()
            if self.layer.available():
                return bytes(self.layer.recv()).hex(" ").upper()
            self.step()
        return None


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
