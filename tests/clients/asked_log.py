"""A log of answers that another tester asked for."""

import numpy as np
from asking_rig import BUS, DBC, Car, Ecu, write

from gateway.bus.frames import OWN
from gateway.bus.logs import open_writer

SEED = 3
#: An answer that does not come: DID 0x1092.
NEVER = 'BO_ 2149716114 Never: 2 A\n SG_ Never : 7|16@0+ (1,0) [0|9] "" A\n'
#: As gateway import writes it; nothing is asked by whoever only reads logs.
ECU = """
[[ecu]]
name = "battery"
bus = "obd"
request = 0x7E4
response = 0x7EC
signals = ["cells.dbc"]
read = [
    { did = 0x2101, every_ms = 100 },
    { did = 0x1091, every_ms = 100 },    # speed
]
"""


def recorded(tmp_path):
    """A file of an ECU, a log of its answers as another tester asked for them, and what it said."""
    file, rng, said = (
        write(tmp_path, BUS + "[bus.ask]\nrequests_per_s = 100\n" + ECU, DBC.replace("[0|65]", "[0|5]") + NEVER),
        np.random.default_rng(SEED),
        [],
    )
    print("seed", SEED)

    def answer(request):
        if request == b"\x22\x21\x01":
            data = bytearray(150)
            cell = round(3600 + 400 * np.sin(len(said) / 40) + rng.uniform(-9, 9))  # as a cell is: slow
            data[0:2] = cell.to_bytes(2, "big")
            data[55:63] = int(rng.integers(1 << 50)).to_bytes(8, "little")
            data[148:150] = (cell + int(rng.integers(-2, 3))).to_bytes(2, "big")
        else:
            data = int(rng.integers(0, 30_000)).to_bytes(2, "big")
        said.append((request[1:], bytes(data)))
        return [(3, b"\x62" + request[1:] + data)]

    made = Car(file, [Ecu(0x7E4, 0x7EC, answer)])
    made.run(20_000)
    made.close()
    frames = made.recording()
    frames["flags"] &= ~np.uint8(OWN)
    with open_writer(tmp_path / "drive.log") as log:
        log.write(frames)
    return file, tmp_path / "drive.log", said
