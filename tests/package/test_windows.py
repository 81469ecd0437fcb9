"""Where no bus of Linux is asked for, the gateway needs nothing that Windows' Python lacks (support/windows.py)."""

import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from processes import bus, process
from windows import BREAK

WINDOWS = Path(__file__).parents[1] / "support" / "windows.py"
MASKED = [sys.executable, str(WINDOWS)]

SCENARIO = """
name = "drained"
description = "A signal leaves its range."
duration_s = 3.0
config = "gateway.toml"
[[ecu]]
type = "restbus"
messages = ["BATT"]
cycle_ms = 100
[ecu.signals]
"BATT.Voltage" = [[0, 12], [1, 12], [1.1, 5]]
[[expect]]
dtc = "U0FF0-84"
after_s = 1.0
by_s = 3.0
"""
CONFIG = """
[[bus]]
name = "can"
uri = "virtual:windows"
database = ["examples/battery_voltage/battery.dbc"]
[[monitor]]
name = "limits"
type = "signal"
signal = [{ signal = "BATT.Voltage", plausible = [10.0, 16.0], code = "U0FF0" }]
[memory]
path = "faults.sqlite"
"""
#: Two locks and a socket, as the host's room makes them without fcntl and unix sockets.
ROOM = """
import os, socket, sys, threading
from pathlib import Path
from windows import become_windows
become_windows()
from gateway.faults import lock
from gateway.host import locks, sockets
from gateway.host.waker import Waker
from gateway_fdi.errors import InputError

memory = Path("m.sqlite")
kept = lock.take_lock(memory)
assert lock.is_kept(memory) and not lock.is_unsaved(memory)
locks.mark_unsaved(kept, True)
assert lock.is_unsaved(memory)
locks.mark_unsaved(kept, False)
assert not lock.is_unsaved(memory)
try:
    lock.take_lock(memory)
    raise SystemExit("taken twice")
except lock.InUseError:
    pass
os.close(kept)
assert not lock.is_kept(memory)

path = Path("status")
listener = sockets.listen_at(path)
assert listener.getsockname()[0] == "127.0.0.1"
_, port, token = path.read_text().split()
stranger = socket.create_connection(("127.0.0.1", int(port)))
stranger.sendall(b"0" * len(token))
try:
    listener.accept()
    raise SystemExit("a stranger is in")
except BlockingIOError:
    pass
client = sockets.connect(path, patience_s=1.0)
made, _ = listener.accept()
client.sendall(b"hello")
assert made.recv(5) == b"hello"
try:
    sockets.listen_at(path)
    raise SystemExit("two listen")
except InputError:
    pass
listener.close()
sockets.listen_at(path).close()

waker = Waker()
waker.wake()
waker.rest()
waker.close()
print("done")
"""


def python(folder, *arguments):
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.skipif(sys.platform == "darwin", reason="it has unix sockets, and no mask")
def test_locks_and_sockets_without_linux(tmp_path):
    assert python(tmp_path, "-c", f"import sys; sys.path.insert(0, {str(WINDOWS.parent)!r}){ROOM}") == "done\n"


@pytest.mark.full("7 s")
def test_a_gateway_without_linux(tmp_path):
    (tmp_path / "gateway.toml").write_text(CONFIG)
    (tmp_path / "drained.toml").write_text(SCENARIO)
    python(tmp_path, WINDOWS, "simulate", "drained.toml", "--bus", "inside", "--check", "--record", "drained.log")
    said = python(tmp_path, WINDOWS, "replay", "drained.log", "--memory", "faults.sqlite")
    assert "DTC U0FF0-84 SET  limits.Voltage.low" in said
    assert "U0FF0-84" in python(tmp_path, WINDOWS, "faults", "list")
    assert python(tmp_path, WINDOWS, "faults", "verify").startswith("whole: ")


@pytest.mark.long
def test_a_live_gateway_without_linux(tmp_path):
    """Faults, requests and the page of a running gateway; a console's Ctrl-Break ends each process in good order."""
    (tmp_path / "drained.toml").write_text(SCENARIO.replace("duration_s = 3.0", "duration_s = 1.5"))
    with bus(tmp_path, program=MASKED) as uri:
        config = CONFIG.replace("virtual:windows", uri) + '[status]\nsocket = "status"\n[output.uds]\n'
        (tmp_path / "gateway.toml").write_text(config)
        with (
            process("run", cwd=tmp_path, ready="monitoring", program=MASKED) as daemon,
            process("serve", "--port", "0", cwd=tmp_path, ready="page:", program=MASKED) as page,
        ):
            python(tmp_path, WINDOWS, "simulate", "drained.toml", "--bus", uri)
            said = python(tmp_path, WINDOWS, "request", "1902FF")
            assert said.startswith("1902FF  5902FFCFF0842F"), "others may not be tested yet"
            assert "U0FF0-84" in python(tmp_path, WINDOWS, "faults", "list")
            place = page.said.split()[1].split("#")[0]
            with urllib.request.urlopen(f"{place}metrics") as answer:
                assert b"gateway_up 1" in answer.read()
            page.send_signal(BREAK)
            daemon.send_signal(BREAK)
            assert page.wait(60) == 0
            assert daemon.wait(60) == 0
    assert "\nDTCs: U0FF0-84\n" in (tmp_path / "run.out").read_text()
    assert not (tmp_path / "status").exists()
