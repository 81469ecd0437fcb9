"""Databases of others as rest buses, the daemon that checks them, and cantools' monitor on a terminal of its own."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
import threading
from pathlib import Path

import cantools
import pyte
import pytest

#: Database -> nodes whose messages are all sent (none: all), a signal that rises from 50 to 100, how many messages
#: with a checksum are checked at least.
CARS = {
    "vw_mqb": ({"Gateway_MQB", "Motor_Diesel_MQB"}, "ESP_21.ESP_v_Signal", 10),
    "toyota_prius_2010_pt": (set(), "SPEED.SPEED", 10),
    "ford_lincoln_base_pt": ({"PCM_HEV"}, None, 0),  # CAN FD: not for clients of socketcand
    "tesla_model3_party": (set(), None, 10),
}
#: A tester asks the ECU that answers.
REQUEST, RESPONSE = (0x713, bytes.fromhex("0322F190")), (0x77D, bytes.fromhex("0462F19041"))


def file_of(car):
    return Path(pytest.importorskip("opendbc").DBC_PATH) / f"{car}.dbc"


def load(car):
    return cantools.database.load_file(file_of(car), strict=False)


def write(folder, car, database, *, seconds=6.0, more=""):
    """Write configuration and scenario; returns both, and the names of messages that are sent, and that are checked."""
    nodes, signal, _ = CARS[car]
    sent = [m.name for m in database.messages if not nodes or set(m.senders) & nodes]
    checked = [
        m.name for m in database.messages if m.name in sent and any("CHECKSUM" in s.name.upper() for s in m.signals)
    ]
    # No message is lost here because a machine is busy; a wrong checksum, counter or length is told all the same.
    rule = ', protection = "auto"' if checked else ""
    checks = ", ".join(f'{{ message = "{name}", timeout_ms = 600000{rule} }}' for name in checked or sent[:10])
    config = folder / "gateway.toml"
    config.write_text(
        f'[[bus]]\nname = "can"\nuri = "socketcan:vcan0"\ndatabase = ["{file_of(car)}"]\ncodes = "own"\n'
        f"check = [{checks}]\n[output.dtc_frame]\n"
    )
    scenario = folder / "scenario.toml"
    rising = "" if signal is None else f'"{signal}" = {{ ramp = {{ start = 50, end = 100, in_s = {seconds} }} }}\n'
    scenario.write_text(
        f'name = "rest"\nduration_s = {seconds}\nseed = 31\nconfig = "gateway.toml"\n'
        f'[[ecu]]\ntype = "restbus"\nnodes = {sorted(nodes)}\ncycle_ms = 100\n[ecu.signals]\n{rising}'
        '[[ecu]]\ntype = "responder"\n[ecu.uds]\nrequest = 0x713\nresponse = 0x77D\n'
        f'answers = {{ "22 F1 90" = "62 F1 90 41" }}\n{more}'
    )
    return config, scenario, sent, checked


class Monitor:
    """cantools' monitor, on a terminal of its own.

    Args:
        database: file.
        interface: arguments for python-can's interface.
        settings: in python-can's configuration, as JSON (CAN_CONFIG).
    """

    def __init__(self, database, interface=("-i", "socketcan", "-c", "vcan0"), settings="{}"):
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 400, 160, 0, 0))
        # Who starts the tests may have a smaller terminal, and say so: xdist does.
        others = {name: value for name, value in os.environ.items() if name not in ("LINES", "COLUMNS")}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cantools", "monitor", *interface, "--no-strict", str(database)],
            # python-can warns of each message that comes in two parts: on the terminal that would scroll away what
            # curses takes to be there, and does not draw again.
            stdin=theirs, stdout=theirs, stderr=subprocess.DEVNULL, close_fds=True,
            env=others | {"TERM": "xterm", "CAN_CONFIG": settings},
        )  # fmt: skip
        os.close(theirs)
        self._said = []
        self._shown = pyte.Screen(160, 400)
        self._stream = pyte.ByteStream(self._shown)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        try:
            while data := os.read(self._ours, 65536):
                self._said.append(data)
        except OSError:
            pass  # its end is closed

    @property
    def screen(self):
        """What a terminal shows: only what changes is drawn anew."""
        while self._said:
            self._stream.feed(self._said.pop(0))
        return "\n".join(self._shown.display)

    def close(self):
        self._process.terminate()
        self._process.wait(60)
        self._thread.join(60)
        os.close(self._ours)
