"""The rest bus of a database of others on the kernel's CAN: candump, cantools and python-can are there, too."""

import fcntl
import os
import pty
import shutil
import struct
import subprocess
import sys
import termios
import threading
from collections import Counter
from pathlib import Path

import can
import cantools
import numpy as np
import pyte
import pytest
from foreign_project import ROOT, run
from kernel_can import candump, daemon, wait_for
from opendbc import DBC_PATH
from processes import GATEWAY

from gateway.bus.frames import payload
from gateway.bus.logs import read_log

pytestmark = pytest.mark.vcan

#: Database -> nodes whose messages are all sent (none: all), a signal that rises from 50 to 100, how many messages
#: with a checksum are checked.
CARS = {
    "vw_mqb": ({"Gateway_MQB", "Motor_Diesel_MQB"}, "ESP_21.ESP_v_Signal", 10),
    "toyota_prius_2010_pt": (set(), "SPEED.SPEED", 10),
    "ford_lincoln_base_pt": ({"PCM_HEV"}, None, 0),
}


def file_of(car):
    return Path(DBC_PATH) / f"{car}.dbc"


def write(folder, car, database):
    """Write configuration and scenario; returns both, and the names of messages that are sent, and that are checked."""
    nodes, signal, _ = CARS[car]
    sent = [m.name for m in database.messages if not nodes or set(m.senders) & nodes]
    checked = [m.name for m in database.messages if m.name in sent and any(s.name == "CHECKSUM" for s in m.signals)]
    # No message is lost here because a machine is busy; a wrong checksum or counter is told all the same.
    checks = ", ".join(f'{{ message = "{name}", timeout_ms = 600000, protection = "auto" }}' for name in checked)
    config = folder / "gateway.toml"
    config.write_text(
        f'[[bus]]\nname = "can"\nuri = "socketcan:vcan0"\ndatabase = ["{file_of(car)}"]\ncodes = "own"\n'
        f"check = [{checks}]\n[output.dtc_frame]\n"
    )
    scenario = folder / "scenario.toml"
    rising = "" if signal is None else f'"{signal}" = {{ ramp = {{ start = 50, end = 100, in_s = 6 }} }}\n'
    scenario.write_text(
        'name = "rest"\nduration_s = 6.0\nseed = 31\nconfig = "gateway.toml"\n'
        f'[[ecu]]\ntype = "restbus"\nnodes = {sorted(nodes)}\ncycle_ms = 100\n[ecu.signals]\n{rising}'
        '[[ecu]]\ntype = "responder"\n[ecu.uds]\nrequest = 0x713\nresponse = 0x77D\n'
        'answers = { "22 F1 90" = "62 F1 90 41" }\n'
    )
    return config, scenario, sent, checked


class Monitor:
    """cantools' monitor, on a terminal of its own."""

    def __init__(self, database):
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 400, 160, 0, 0))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cantools", "monitor", "-i", "socketcan", "-c", "vcan0", "--fd", "--no-strict",
             str(database)],
            stdin=theirs, stdout=theirs, stderr=theirs, env=os.environ | {"TERM": "xterm"}, close_fds=True,
        )  # fmt: skip
        os.close(theirs)
        self.said = b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        try:
            while data := os.read(self._ours, 65536):
                self.said += data
        except OSError:
            pass  # its end is closed

    @property
    def screen(self):
        """What a terminal shows: only what changes is drawn anew."""
        shown = pyte.Screen(160, 400)
        pyte.ByteStream(shown).feed(self.said)
        return "\n".join(shown.display)

    def close(self):
        self._process.terminate()
        self._process.wait(60)
        self._thread.join(60)
        os.close(self._ours)


@pytest.mark.parametrize("car", CARS)
def test_a_rest_bus_of_others_and_its_readers(car, tmp_path):
    database = cantools.database.load_file(file_of(car), strict=False)
    config, scenario, sent, checked = write(tmp_path, car, database)
    _, rising, least = CARS[car]
    assert len(checked) >= least
    log = tmp_path / "all.log"
    monitor = Monitor(file_of(car))
    try:
        with candump("-L", "vcan0", log=log), daemon(config, cwd=tmp_path) as running:
            wait_for(lambda: "Received" in monitor.screen)
            played = subprocess.Popen(
                [*GATEWAY, "simulate", str(scenario), "--bus", "socketcan:vcan0"],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            )  # fmt: skip
            answer = None
            with can.Bus("vcan0", interface="socketcan", can_filters=[{"can_id": 0x77D, "can_mask": 0x7FF}]) as peer:
                while answer is None and played.poll() is None:
                    peer.send(can.Message(arbitration_id=0x713, data=bytes.fromhex("0322F190"), is_extended_id=False))
                    answer = peer.recv(1.0)
            said, _ = played.communicate(timeout=600)
            wait_for(lambda: any(one in monitor.screen for one in checked or sent))
            wait_for(lambda: rising is None or rising.rpartition(".")[2] in monitor.screen)
    finally:
        monitor.close()
    assert played.returncode == 0, said
    assert answer is not None, said
    assert bytes(answer.data)[:5] == bytes.fromhex("0462F19041")
    assert running.code == 0
    failed = {event["fault"] for event in running.events() if event["event"] == "dtc" and event["status"] & 1}
    assert failed == set(), "every protected message passes its check"
    frames = np.concatenate(list(read_log(log)))
    seen, values = Counter(), []
    name, _, signal = (rising or "..").rpartition(".")
    for frame in frames:
        try:
            message = database.get_message_by_frame_id(int(frame["can_id"]) & 0x1FFFFFFF)
        except KeyError:
            continue  # ours, and the tester's
        seen[message.name] += 1
        if message.name == name:
            values.append(message.decode(payload(frame), decode_choices=False)[signal])
    assert set(checked) <= seen.keys() <= set(sent)
    assert min((seen[one] for one in checked), default=50) >= 50
    assert max(seen.values()) >= 50
    if rising is not None:
        assert values == sorted(values)
        assert (values[0], values[-1]) == (pytest.approx(50, abs=2), pytest.approx(100, abs=2))
        assert signal in monitor.screen


def test_the_examples_tests_on_the_kernels_can(tmp_path):
    """--gateway-bus: what passes in one process passes here, a loop of a plant and its controller too."""
    folder = tmp_path / "bench"
    shutil.copytree(ROOT / "examples" / "bench", folder, ignore=shutil.ignore_patterns("__pycache__", "left"))
    config = (folder / "gateway.toml").read_text()
    assert "timeout_ms = 200.0" in config
    (folder / "gateway.toml").write_text(config.replace("timeout_ms = 200.0", "timeout_ms = 5000.0"))
    log = tmp_path / "all.log"
    with candump("-L", "vcan0", log=log):
        test = "test_fan.py::test_a_sensor_without_a_value_is_named"
        code, said = run(folder, "--gateway-bus", "socketcan:vcan0", "scenarios/blocked.toml", test)
    assert (code, "2 passed" in said) == (0, True), said
    seen = Counter(line.split()[2].partition("#")[0] for line in log.read_text().splitlines())
    assert min(seen["100"], seen["110"], seen["120"]) > 300, "50 a second, for seconds"
    assert min(seen["7E0"], seen["7E8"]) > 0, "udsoncan and its answers"
