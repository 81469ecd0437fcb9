"""An ECU that is asked in CAN FD; can-isotp is its transport."""

import isotp
import numpy as np
import pytest
from asking_rig import BUS, DBC, MS, Car, settled, write

from gateway.bus.frames import BRS, FD, empty, joined, payload, put

CELLS, SPEED = bytes([0x10, 0x20]) + bytes(range(148)), bytes.fromhex("1388")
ECU = """
[[ecu]]
name = "battery"
request = 0x7E4
response = 0x7EC
fd = {fd}
signals = ["cells.dbc"]
read = [{{ did = 0x2101, every_ms = 100 }}, {{ did = 0x1091, every_ms = 100 }}]
[[monitor]]
name = "values"
type = "signal"
bus = "answers:obd"
signal = [
    {{ signal = "Cells.First", plausible = [0, 65] }},
    {{ signal = "Cells_3.Last", plausible = [0, 65] }},
    {{ signal = "Speed.Speed", plausible = [0, 200] }},
]
[clock]
watched = false
"""


class FdEcu:
    """An ECU of can-isotp's own state machine, which takes frames of CAN FD only."""

    def __init__(self, answers):
        self.answers, self.came, self.sent, self.heard = answers, [], [], []
        self.layer = isotp.TransportLayerLogic(
            lambda _: self.came.pop(0) if self.came else None,
            self.sent.append,
            isotp.Address(isotp.AddressingMode.Normal_11bits, txid=0x7EC, rxid=0x7E4),
            params={"can_fd": True, "tx_data_length": 64, "stmin": 0, "tx_padding": 0xCC},
        )

    next_ns = 0

    def take(self, frames):
        for frame in frames[(frames["can_id"] == 0x7E4) & (frames["flags"] & FD > 0)]:
            assert frame["flags"] & BRS
            self.came.append(isotp.CanMessage(arbitration_id=0x7E4, data=payload(frame), is_fd=True))
        return self.step(0)

    def step(self, _):
        self.layer.process()
        while (request := self.layer.recv()) is not None:
            self.heard.append(bytes(request))
            self.layer.send(self.answers[bytes(request)])
        self.layer.process()
        made = empty(len(self.sent))
        for k, message in enumerate(self.sent):
            assert message.is_fd
            put(made, k, 0, message.arbitration_id, bytes(message.data), flags=FD | BRS)
        self.sent.clear()
        return made


@pytest.mark.parametrize("fd", [True, False])
def test_answers_of_any_length_come_in_can_fd(tmp_path, fd):
    answers = {b"\x22\x21\x01": b"\x62\x21\x01" + CELLS, b"\x22\x10\x91": b"\x62\x10\x91" + SPEED}
    ecu = FdEcu(answers)
    found = Car(write(tmp_path, BUS + ECU.format(fd=str(fd).lower()), DBC), [ecu]).run(1500)
    if not fd:  # it hears nothing that is classic
        assert (ecu.heard, found.state()["answers"]) == ([], 0)
        return
    assert found.value("answers:obd.Cells.First") == pytest.approx(0x1020 * 0.001)
    assert found.value("answers:obd.Cells_3.Last") == pytest.approx(int.from_bytes(CELLS[-2:], "big") * 0.001)
    assert found.value("answers:obd.Speed.Speed") == 50
    assert found.state()["answers"] > 10
    assert found.state()["absent"] == 0
    assert settled(found.state())
    long = [f for f in joined(found.log) if f["can_id"] == 0x7EC and f["length"] > 8]
    assert long
    assert all(int(f["length"]) in (12, 16, 20, 24, 32, 48, 64) for f in long)


@pytest.mark.parametrize("length", [5, 8, 40, 62, 63, 500])
def test_a_testers_request_of_any_length_goes_on_in_can_fd(tmp_path, length):
    request = b"\x2e\xf1\x90" + bytes(np.arange(length - 3, dtype=np.uint8))
    ecu, answers = FdEcu({request: b"\x6e\xf1\x90"}), []
    read = ECU.format(fd="true").replace("every_ms = 100", "every_ms = 86400000")
    found = Car(write(tmp_path, BUS + read, DBC), [ecu])
    ecu.answers |= {b"\x22\x21\x01": b"\x7f\x22\x31", b"\x22\x10\x91": b"\x7f\x22\x31"}
    found.run(500)
    assert found.gateway.asking.line("battery").ask(request, "tester", answers.append)
    found.run(500)
    assert ecu.heard[-1] == request
    assert answers == [b"\x6e\xf1\x90"]
    assert found.now > 900 * MS
