"""A monitor whose step loops for ever: the process was deaf to SIGTERM and Ctrl-C, now the watchdog ends it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from processes import bus, gateway, process

from gateway.live.watchdog import HUNG_EXIT
from gateway_fdi.common.resources import shipped

STEP = "    s.lowest = min(s.lowest, u.volts)\n"
LOOPS = f"    while u.volts > -1.0:\n    {STEP}"


def wait_until_busy(pid):
    """Wait until a process computes all the time: its step loops."""
    ticks = os.sysconf("SC_CLK_TCK")
    while True:
        before = used(pid)
        time.sleep(0.5)
        if used(pid) - before > 0.1 * ticks:
            return


def used(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11])


def looping(folder):
    """Write the example with a step that loops for ever; returns the monitor's file."""
    for source in shipped("examples/battery_voltage").iterdir():
        if source.is_file():
            (folder / source.name).write_text(source.read_text())
    file = folder / "battery_voltage.py"
    file.write_text(file.read_text().replace(STEP, LOOPS + STEP))
    return file


#: What a person starts; less patient, so that the test takes less.
COMMANDS = {
    "demo": ("demo", "drained.toml", "--speed", "0"),
    "simulate": ("simulate", "drained.toml", "--bus", "inside"),
    "replay": ("replay", "drive.log"),
}
HASTY = """
from gateway.cli import main
from gateway.live import watchdog
watchdog.LIMIT_S, watchdog.LOOK_S = 0.2, 0.02
main()
"""


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
def test_what_a_person_starts_ends_too_and_names_the_monitor(tmp_path, command):
    file = looping(tmp_path)
    (tmp_path / "drive.log").write_text("(1000.000000) vcan0 510#3831000000000000\n")
    asked = [sys.executable, "-c", HASTY, *COMMANDS[command]]
    ended = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False)
    assert ended.returncode == HUNG_EXIT
    assert f"monitor battery (type battery_voltage, {file}): its step did not return" in ended.stderr


@pytest.mark.long
@pytest.mark.parametrize("asked", [pytest.param(False, marks=pytest.mark.full("6 s")), True])
def test_a_step_that_loops_for_ever_ends_the_process_and_stays_off_the_next_time(tmp_path, asked):
    file = looping(tmp_path)
    with bus(tmp_path) as uri:
        run = ("run", "gateway.toml", "--bus", uri, "--memory", "faults.sqlite")
        simulate = ("simulate", "drained.toml", "--bus", uri)
        with (
            process(*run, cwd=tmp_path, ready="monitoring") as started,
            process(*simulate, cwd=tmp_path, ready=""),
        ):
            if asked:
                wait_until_busy(started.pid)
                started.send_signal(signal.SIGTERM)
            assert started.wait(60) == HUNG_EXIT
        said = "".join(started.log)
        assert f"monitor battery (type battery_voltage, {file}): its step did not return" in said
        again = gateway(*run, "--duration", "1", "--json", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert '"event":"monitor_off"' in again.stdout.replace(": ", ":")
    assert "U3000-48" in again.stdout
