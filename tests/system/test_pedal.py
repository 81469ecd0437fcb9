"""A pedal's faults over the loopback bus: daemon, virtual ECU and tester as processes of their own."""

import json
import re
import threading
from contextlib import ExitStack

import can
import cantools
import pytest
from kernel_can import events_in
from processes import bus, gateway, process
from scenario_runs import patient, unexpected, unhurried

from gateway_fdi.common.resources import shipped

pytestmark = pytest.mark.system

SCENARIO = shipped("scenarios/pedal_faults.toml")

#: DTC -> a part of the evidence that it must have been kept with.
EVIDENCE = {
    "P057A-14": ("reading", lambda v: v == 0),
    "P157A-15": ("reading", lambda v: v > 4.9),
    "P057A-2A": ("repeated [samples]", lambda v: v >= 4),
    "P157A-64": ("innovation [%]", lambda v: 5 < v < 7.5),
    "P057A-2F": ("position [%]", lambda v: v != 0),
    "P157C-28": ("mismatch [%]", lambda v: 1.6 <= v < 3),  # begins at 2, and may be 1.6 where it is confirmed
    "P157C-62": ("without agreement [share]", lambda v: v > 0.5),
    "P157A-14": ("reading", lambda v: v == 0),
    "P157C-29": ("channel 1 [%]", lambda v: v == -12.5),
}

#: What is said of a pair that disagreed before the scenario made it.
NOT_ISOLATED = re.compile(r"P157C-62 set at \S+ s, before 30\.0 s")


def driven(folder):
    """Return what `simulate` said, the qualities that the voted brake had, the daemon's exit code, and its events."""
    voted = cantools.database.load_file(shipped("dbc/pedal.dbc")).get_message_by_name("GW_BrakePedal")
    config = patient(shipped("configs/pedal.toml"), folder)
    with ExitStack() as stack:
        uri = stack.enter_context(bus(folder))
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        daemon = stack.enter_context(
            process("run", config, "--bus", uri, "--json",
                    "--memory", "f.sqlite", cwd=folder, ready="monitoring")
        )  # fmt: skip
        tester = stack.enter_context(
            can.Bus(
                interface="socketcand",
                host=host,
                port=int(port),
                channel="can0",
                can_filters=[{"can_id": voted.frame_id, "can_mask": 0x7FF}],
            )
        )
        qualities, stop = set(), threading.Event()

        def read():
            while not stop.is_set():
                if (message := tester.recv(0.2)) is not None:
                    qualities.add(str(voted.decode(message.data)["Quality"]))

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        drive = gateway("simulate", unhurried(SCENARIO, folder), "--check", "--json", "--bus", uri, cwd=folder)
        stop.set()
        reader.join(10)
    return drive, qualities, daemon.code, events_in(folder)


@pytest.mark.full("15 s: runtime/test_gateway.py has its scenarios, test_processes.py the processes")
def test_each_fault_has_its_dtc_with_evidence_and_heals(tmp_path):
    """Driven again, at most twice, where the machine was so busy that the scenario stood still.

    An offset that begins in a gap of 20 ms or more has no step that could name its channel: the pair disagrees, which
    is P157C-62 long before the scenario makes it. That is the right verdict of another drive, which is driven again.
    """
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        drive, qualities, code, events = driven(folder)
        said = drive.stdout + drive.stderr
        if drive.returncode == 0 or not ("stood still" in said or NOT_ISOLATED.search(said)):
            break
    assert drive.returncode == 0, drive.stdout + drive.stderr
    assert drive.stdout.count("healed at") == len(EVIDENCE)
    assert {"agreed", "one channel", "degraded", "estimated", "invalid"} <= qualities
    assert code == 0
    assert not unexpected(SCENARIO, events)
    for dtc, (name, good) in EVIDENCE.items():
        shown = gateway("faults", "show", dtc, "--memory", "f.sqlite", "--json", cwd=folder)
        entry = json.loads(shown.stdout)
        entry = entry[0] if isinstance(entry, list) else entry
        assert good(entry["evidence"][name]), (dtc, entry["evidence"])
