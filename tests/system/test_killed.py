"""kill -9 again and again, and a service manager that starts the daemon again: no death completes a cycle."""

import os
import re
import signal
import subprocess
import sys

import can
import pytest
import warm
from kernel_can import wait_for
from kill_storm import start, write_config
from processes import bus

from gateway.faults import service
from gateway.faults.records import Changes, Cycle
from gateway.faults.restarts import COUNT, ROW
from gateway.faults.store import Store

pytestmark = pytest.mark.system

FAULT = "b.M0.length"
DEATHS = 8
#: A gateway that would wait for an hour.
PATIENT = [
    sys.executable,
    "-c",
    "from gateway.faults import restarts; restarts.LONGEST_S = 3600.0; from gateway.cli import main; main()",
]


def configure(folder):
    config = write_config(folder)
    rules = "indicator = true\naging_cycles = 4\nhealing_cycles = 3\n"
    config.write_text(config.read_text().replace(f'[fault."{FAULT}"]\n', f'[fault."{FAULT}"]\n{rules}'))
    return config


def entry(memory):
    """The entry as the file has it; None: there is none."""
    return next((each for each in service.list_entries(memory) if each["fault"] == FAULT), None)


def test_eight_deaths_while_the_test_passes_leave_a_confirmed_dtc_and_its_lamp(tmp_path):
    config, memory = configure(tmp_path), tmp_path / "f.sqlite"
    with bus(tmp_path) as uri:
        host, port = re.match(r"loopback:(.+):(\d+)", uri).groups()

        def run(payload, how, until):
            """Start, send a frame until the file says what is wanted, end."""
            started = start(config, uri, memory, tmp_path)
            counts = iter(range(10**6))
            with can.Bus(interface="socketcand", host=host, port=int(port), channel="can0") as car:

                def told():
                    data = bytes([next(counts) % 256, *payload])
                    car.send(can.Message(arbitration_id=0x300, data=data, is_extended_id=False))
                    return until(entry(memory))

                wait_for(told)
            os.kill(started.pid, how)
            started.wait(60)
            started.stderr.close()

        run(b"\x00", signal.SIGTERM, lambda found: found is not None and found["confirmed"])
        assert entry(memory)["status"] & 0x89 == 0x89, "confirmed, failing, asks for the lamp"
        for _ in range(DEATHS):
            run(bytes(7), signal.SIGKILL, lambda found: not found["status"] & 0x41)
        kept = entry(memory)
        assert kept["status"] == 0xAC, "confirmed, pending, failed since the clear; the lamp is on"
        assert (kept["aged_cycles"], kept["failed_cycles"]) == (0, 1)
        assert service.restarts(memory)["count"] == DEATHS - 1, "the first of the dead had been started after a stop"
        assert service.verify(memory)["whole"]
        run(bytes(7), signal.SIGTERM, lambda found: not found["status"] & 0x41)
        kept = entry(memory)
        assert kept["status"] == 0xA8, "the stop completes the cycle that goes on since: pending no more"
        assert service.restarts(memory)["count"] == DEATHS


def test_a_daemon_that_waits_after_deaths_ends_at_once_when_asked(tmp_path):
    config, memory = configure(tmp_path), tmp_path / "f.sqlite"
    store = Store(memory)
    store.save(Changes(facts={COUNT: 20, ROW: 20}, cycles={"power": Cycle(1, True, 0)}))
    store.close()
    with bus(tmp_path) as uri:
        command = [*PATIENT, "run", str(config), "--bus", uri, "--memory", str(memory)]
        started = warm.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        line = ""
        while "21 restarts in a row without a stop: buses are opened in 3600 s" not in line:
            line = started.stderr.readline()
            assert line, started.wait(60)
        started.send_signal(signal.SIGTERM)
        _, rest = started.communicate(timeout=300)
    assert started.returncode == 0, rest
    store = Store(memory, write=False)
    assert not store.cycles()["power"].open, "it ended in order"
    store.close()
