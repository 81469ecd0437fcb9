"""The encoder of the plants makes the bytes that cantools makes."""

import cantools
import numpy as np
import pytest

from gateway.bus.frames import payload
from gateway.signals.frame_encoding import frames_of
from gateway.signals.protection.default_profile import prepared
from gateway.signals.protection.protection import protect_all
from gateway_fdi.common.resources import shipped

CRCS = {"PED_Brake": "Crc", "PED_Brake3": "Crc", "PED_Accelerator": "Crc"}
CRCS |= {"AFS_MotCur": "CRC_cur", "AFS_MotVol": "CRC_vol", "AFS_Angle": "CRC_ang", "SAS_Angle": "CRC_sas"}


@pytest.mark.parametrize("name", CRCS)
def test_the_same_bytes_as_cantools(name):
    file = "dbc/pedal.dbc" if name.startswith("PED") else "dbc/steering.dbc"
    message = cantools.database.load_file(shipped(file)).get_message_by_name(name)
    rng = np.random.default_rng(4)
    columns = {
        s.name: np.round(rng.uniform(s.minimum, s.maximum, 200) / s.scale) * s.scale + (s.offset % s.scale)
        for s in message.signals
        if s.name != CRCS[name]
    }
    frames = frames_of(message, columns, np.arange(200), CRCS[name])
    for k, frame in enumerate(frames):
        values = {signal: float(column[k]) for signal, column in columns.items()}
        plain = message.encode({**values, CRCS[name]: 0}, strict=False)
        carried = message.decode(payload(frame), decode_choices=False)
        assert payload(frame) == message.encode({**values, CRCS[name]: carried[CRCS[name]]}, strict=False)
        data = np.zeros((1, 8), np.uint64)
        data[0, 0] = np.frombuffer(plain, np.uint64)[0]
        row, tables = prepared(message, CRCS[name], None)
        protect_all(data, np.full(1, 8), row, tables, 0)
        assert data.view(np.uint8)[0, :8].tobytes() == payload(frame), "and the gateway's CRC"
