"""`gateway run` with a monitor whose step loops for ever: it was deaf to SIGTERM, now the watchdog ends it."""

import os
import signal
import time
from pathlib import Path

import pytest
from processes import bus, gateway, process

from gateway.common.resources import shipped
from gateway.live.watchdog import HUNG_EXIT

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


@pytest.mark.long
@pytest.mark.parametrize("asked", [False, True])
def test_a_step_that_loops_for_ever_ends_the_process_and_stays_off_the_next_time(tmp_path, asked):
    example = shipped("examples/battery_voltage")
    for source in example.iterdir():
        if source.is_file():
            (tmp_path / source.name).write_text(source.read_text())
    file = tmp_path / "battery_voltage.py"
    file.write_text(file.read_text().replace(STEP, LOOPS + STEP))
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
