"""A bench of one ECU that answers, and can-isotp on the other end."""

import cantools
import isotp
import numpy as np

from gateway.bus.frames import empty, payload, put
from gateway.config.load import load_config
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario

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
