"""What a tester reads of a fault that a model's monitor has named: its size, in the freeze frame and the evidence."""

import struct

import motor_data
import pytest
from rig import Rig
from structural_config import configuration
from uds_tester import Asked

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.errors import GatewayError
from gateway_fdi.jit import COMPILED

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="thousands of samples")]

TURNS = 'active = "omega > 20"\nsettle_s = 3\ncodes = { f_R = "P1B10" }\n'
TESTER = """
[[did]]
id = 0x2100
name = "resistance"
signal = "motor:size_f_R"
type = "i16"
scale = 0.001
[fault."motor.f_R"]
freeze_frame = ["resistance", "Sensors.Speed", "motor:size_f_b"]
[output.uds]
"""
SIZE, DTC = 0.3, "1b1064"


def test_the_size_in_freeze_frame_evidence_and_identifier(tmp_path):
    rig = Rig(configuration(tmp_path, TURNS + TESTER), tmp_path / "memory.sqlite")
    frames = motor_data.frames_of(motor_data.drive(16, seed=7, onset=10.0, f_R=SIZE), begin_ns=10**6)
    for k in range(0, len(frames), 40):
        rig.gateway.feed(frames[k : k + 40])
    rig.now = int(frames[-1]["t_ns"])
    ask = Asked(rig)
    entry = rig.gateway.memory.entry("motor.f_R")
    (told,) = [v for name, v in entry.record.evidence.items() if name.startswith("size of the fault: the winding")]
    assert told == pytest.approx(SIZE, rel=0.2)

    frame = ask(f"1904{DTC}01")
    assert frame.startswith(f"5904{DTC}")
    content = bytes.fromhex(frame)[6:]
    assert content[:4] == bytes([1, 3]) + bytes.fromhex("2100")
    assert int.from_bytes(content[4:6], "big", signed=True) * 0.001 == pytest.approx(told, rel=0.05)
    numbers = {content[k : k + 2].hex(): content[k + 2 : k + 6] for k in (6, 12)}
    tables = {int(d["id"], 16): d for d in rig.gateway.identifiers.describe()}
    signals = {tables[int(number, 16)]["signal"]: struct.unpack(">f", data)[0] for number, data in numbers.items()}
    assert set(signals) == {"Sensors.Speed", "motor:size_f_b"}
    assert signals["Sensors.Speed"] > 20

    extended = bytes.fromhex(ask(f"1906{DTC}20"))
    values = struct.unpack(f">{len(entry.record.evidence)}d", extended[7:])
    names = list(entry.record.evidence)
    assert values[names.index(next(n for n in names if n.startswith("size of the fault: the winding")))] == told

    now = bytes.fromhex(ask("222100"))[3:]
    assert int.from_bytes(now, "big", signed=True) * 0.001 == pytest.approx(SIZE, rel=0.1)
    rig.close()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("motor:size_f_r", r'fault."motor.f_R".freeze_frame\[0\] = .motor:size_f_r.*did you mean size_f_R'),
        ("moter:size_f_R", "the monitors are motor; did you mean motor"),
    ],
)
def test_a_live_value_that_is_not_there(tmp_path, wrong, said):
    path = configuration(tmp_path, TURNS + f'[fault."motor.f_R"]\nfreeze_frame = ["{wrong}"]\n')
    with pytest.raises(GatewayError, match=said):
        Gateway(load_config(path), None, file=path)
