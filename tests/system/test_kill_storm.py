"""kill -9 in a storm of DTCs, some of the time with a disk that fills up: what was told as stored is there.

``GATEWAY_TESTS=full`` kills a thousand times, a hundred of them with the full disk; ``GATEWAY_KILLS`` sets the number
of kills (a tenth of them with the full disk), of which each takes about as long as the daemon takes to start.
"""

import os
import random
import signal
import time
from contextlib import ExitStack

import can
import pytest
from amount import amount
from full_disk import small_disk
from kill_storm import Storm, Told, start, write_config
from processes import bus

from gateway.faults import service

pytestmark = pytest.mark.system

KILLS = int(os.environ.get("GATEWAY_KILLS", "0")) or amount(1000, 20)
FULL_DISK = max(KILLS // 10, 2)


def kill_9(tmp_path, memory, kills, rng, disk=None):
    """Start, let run, kill; returns what was told in all."""
    config = write_config(tmp_path)
    runs, worst = [], {}
    with ExitStack() as stack:
        uri = stack.enter_context(bus(tmp_path))
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        tester = stack.enter_context(can.Bus(interface="socketcand", host=host, port=int(port), channel="can0"))
        storm = stack.enter_context(Storm(host, int(port), rng.randrange(2**32)))
        while len(runs) < kills:
            started = start(config, uri, memory, tmp_path)
            told = Told()
            while (got := tester.recv(0)) is not None:
                told.note(got)  # that nothing can be written may be the first that it says
            for action in (None,) if disk is None else (disk.fill, disk.free, disk.fill):
                if action is not None and rng.random() < 0.8:
                    action(started)
                limit = time.monotonic() + rng.uniform(0.01, 0.35)
                while (rest := limit - time.monotonic()) > 0:
                    told.note(tester.recv(rest))
            os.kill(started.pid, signal.SIGKILL)
            started.wait(60)
            started.stderr.close()
            time.sleep(0.02)
            while (got := tester.recv(0)) is not None:
                told.note(got)
            if disk is not None:
                disk.free(started)
            runs.append(told)
            kept = {e["dtc"]: e for e in service.list_entries(memory)}
            for dtc, occurrence in told.promised.items():
                assert kept[dtc]["confirmed"], (len(runs), dtc)
                assert kept[dtc]["occurrence"] >= occurrence, (len(runs), dtc)
            for dtc, occurrence in worst.items():
                assert kept[dtc]["occurrence"] >= occurrence, (len(runs), dtc)
            worst = {dtc: entry["occurrence"] for dtc, entry in kept.items()}
        assert storm.is_alive(), "the storm must have lasted to the last kill"
    return runs


@pytest.mark.evidence("Durability: kill -9")
@pytest.mark.timeout(300 + 30 * KILLS)
def test_kill_9_while_dtcs_arrive_loses_none_that_was_sent_as_confirmed(tmp_path):
    """At random moments after the daemon is up, in a storm of DTCs."""
    seed = int(os.environ.get("GATEWAY_SEED", "50"))
    print("seed", seed)
    runs = kill_9(tmp_path, tmp_path / "f.sqlite", KILLS, random.Random(seed))
    promised = sum(len(told.promised) for told in runs)
    print(f"{len(runs)} kills, {promised} confirmed DTCs reported before them, none missing")
    assert promised >= 2 * KILLS
    assert not any(told.outages for told in runs)


@pytest.mark.evidence("Durability: kill -9 full disk")
@pytest.mark.timeout(300 + 60 * FULL_DISK)
def test_kill_9_with_a_disk_that_fills_up_loses_nothing_that_was_told_as_stored(tmp_path):
    seed = int(os.environ.get("GATEWAY_SEED", "51"))
    print("seed", seed)
    with small_disk(tmp_path / "disk") as disk:
        memory = tmp_path / "disk" / "f.sqlite"
        runs = kill_9(tmp_path, memory, FULL_DISK, random.Random(seed), disk)
    promised = sum(len(told.promised) for told in runs)
    outages, unstored = sum(t.outages for t in runs), sum(t.unstored for t in runs)
    print(
        f"{len(runs)} kills with a disk that fills up: {promised} confirmed DTCs reported as stored, none missing;"
        f" {outages} outages told, {unstored} reports in them"
    )
    assert promised > 0
    assert unstored > 0, "what could not be stored was told all the same"
