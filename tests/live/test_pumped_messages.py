"""Messages of several frames, and PDUs of containers, live: the pump gives their frames to Python, and no others."""

import time

from long_messages import batch, fast, transported

from gateway.live import fast_path_kernel
from tests.clients.test_woven_commands import CONFIG, DBC
from tests.live.test_pump import Rig, compiled


@compiled
def test_the_pump_leaves_for_parts_of_messages_that_are_wanted_and_for_no_others(tmp_path):
    (tmp_path / "long.dbc").write_text(DBC)
    (tmp_path / "gateway.toml").write_text(CONFIG)
    rig = Rig(tmp_path / "gateway.toml")
    try:
        data = bytes(102) + (1234).to_bytes(2, "little") + bytes(16)
        far = rig.gateway.engine.plan.slot(0, "Long", "Far")
        began = len(rig.why)
        rig.send(0, *batch(fast(0x1F805, 0x35, 0xFF, bytes(43), 0)))  # no signal of it is wanted
        rig.turn()
        assert fast_path_kernel.WANTED not in rig.why[began:]
        rig.send(0, *batch(transported(0xFEE3, 0x21, 0xFF, data)))
        until_s = time.monotonic() + 5
        while not rig.gateway.asking.counters()["long_whole"] and time.monotonic() < until_s:
            rig.turn()
        assert rig.gateway.engine.tables.mailbox[far] == 123.4
        assert fast_path_kernel.WANTED in rig.why[began:]
        assert rig.gateway.asking.counters()["long_parts"] == 19
    finally:
        rig.close()
