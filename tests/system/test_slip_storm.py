"""kill -9 in a storm of DTCs, with 32 monitors beside that misbehave on a schedule: what was told as stored is there.

Each slip that can be made while a gateway runs (tests/support/slips.py) is a monitor of its own, and comes at a voltage
of its own. ``GATEWAY_TESTS=full`` kills a thousand times, and has a step not return in every fiftieth run;
``GATEWAY_KILLS`` sets the number.
"""

import json
import os
import random
import signal
import time
from contextlib import ExitStack
from itertools import cycle

import pytest
import warm
from amount import amount
from kill_storm import Storm, write_config
from processes import TIRELESS, bus
from slips import RUNNING, running_source

from gateway.faults import service
from gateway.faults.hung_monitors import file_beside
from gateway.live.watchdog import HUNG_EXIT
from gateway_fdi.common.resources import shipped

pytestmark = pytest.mark.system

KILLS = int(os.environ.get("GATEWAY_KILLS", "0")) or amount(1000, 4)
#: Every so many runs are killed once all slips were made and the healthy monitor has gone on; all others at random.
WHOLE, HANGS = 4, 50
#: Runs without a failure after which an entry goes (FaultOverride.aging_cycles).
AGING = 40
MODULE, HEALTHY = "slips_in_a_storm", "made_well_in_a_storm"
EXAMPLE = shipped("examples/battery_voltage")
BATT = 0x510
#: The least voltage at which the first, and at which all of them slip, and beyond which a step does not return [V].
FIRST, ALL, LOOPS = 20.0, 39.0, 40.0


class Voltages(Storm):
    """Sends a voltage beside each other frame: low and good in turn, and now and then one at which some slip."""

    loops = False

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self._course = cycle([10.5] * 8 + [12.6] * 12)

    def next_frame(self):
        if self._rng.random() < 0.5:
            return super().next_frame()
        volts = next(self._course)
        if self._rng.random() < 0.1:
            volts = 45.0 if self.loops else self._rng.choice([self._rng.uniform(FIRST, ALL), ALL + 0.5])
        return BATT, round(1000 * volts).to_bytes(2, "little") + bytes(6)


def configure(folder):
    """Write the storm's configuration with all slips, and healthy monitors before and after them."""
    path = write_config(folder)
    (folder / f"{MODULE}.py").write_text(running_source(MODULE, loops=True))
    (folder / f"{HEALTHY}.py").write_text((EXAMPLE / "battery_voltage.py").read_text())
    monitors = [("healthy_first", HEALTHY, "")]
    for k in range(len(RUNNING)):
        above = FIRST + k * (ALL - FIRST) / len(RUNNING)
        monitors.append((f"slip{k}", MODULE, f"slip = {k}\nabove = {above}\n"))
    monitors.append(("healthy_last", HEALTHY, ""))
    text = path.read_text().replace('storm.dbc"]', f'storm.dbc", "{EXAMPLE}/battery.dbc"]', 1)
    for k, (name, module, more) in enumerate(monitors):
        text += f'[[monitor]]\nname = "{name}"\ntype = "{module}:MONITOR"\n{more}'
        text += "".join(
            f'[fault."{name}.{what}"]\ndtc = "P1{k:02X}{at}-16"\n' for at, what in enumerate(("low", "high"))
        )
    path.write_text(text)
    return path


class Run:
    """A daemon, and what it says: events as JSON, and its log."""

    def __init__(self, config, uri, memory, folder):
        self._events, self._log = folder / "events", folder / "log"
        with self._events.open("w") as events, self._log.open("w") as log:
            command = [*TIRELESS, "run", str(config), "--bus", uri, "--memory", str(memory), "--json"]
            self.process = warm.Popen(command, cwd=folder, stdout=events, stderr=log)
        self.wait_for(lambda: "monitoring" in self._log.read_text())

    def wait_for(self, come):
        until = time.monotonic() + 300
        while not come():
            assert self.process.poll() is None, (self.process.poll(), self._log.read_text()[-2000:])
            assert time.monotonic() < until, self._log.read_text()[-2000:]
            time.sleep(0.01)

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait(60)

    @property
    def events(self):
        return _documents(self._events.read_text())

    @property
    def lines(self):
        """Lines of the log about monitors."""
        return [line for line in _documents(self._log.read_text()) if "monitor" in line]

    @property
    def said(self):
        return self._log.read_text()


def _documents(text):
    """Return the JSON documents of whole lines; what is no JSON is for people."""
    return [json.loads(line) for line in text.split("\n")[:-1] if line.startswith("{")]


#: What each of these monitors is to be called, by name; nothing: its slip harms nobody.
EXPECTED = {f"slip{k}": slip.off or slip.said for k, slip in enumerate(RUNNING.values()) if slip.off or slip.said}
OFF = {f"slip{k}" for k, slip in enumerate(RUNNING.values()) if slip.off}


def is_whole(run):
    """Return whether each slip was named, and the healthy monitors were heard of after that."""
    named, heard = {line["monitor"] for line in run.lines}, {"healthy_first": 0, "healthy_last": 0}
    off = {event["monitor"] for event in run.events if event["event"] == "monitor_off"}
    last = max((event["t_ns"] for event in run.events if event["event"] == "monitor_off"), default=0)
    for event in run.events:
        name = event.get("fault", "").partition(".")[0]
        if event["event"] == "dtc" and name in heard and event["t_ns"] > last:
            heard[name] += 1
    return named >= EXPECTED.keys() and off >= OFF and min(heard.values()) >= 2


def assert_each_is_named_once(run, hung=()):
    """Assert that a log has a line for each slip that was made, with its file, and none for a healthy monitor."""
    found = [line["monitor"] for line in run.lines]
    assert len(found) == len(set(found)), run.said
    for line in run.lines:
        if line["monitor"] not in hung:
            assert EXPECTED[line["monitor"]] in line["reason"]
        assert line["file"].endswith(f"/{MODULE}.py")
    told = [event["monitor"] for event in run.events if event["event"] == "monitor_off"]
    assert len(told) == len(set(told))
    assert set(told) <= OFF.union(hung)
    assert "Traceback" not in run.said
    assert "bug of the gateway" not in run.said


def promised(run):
    """Return the confirmed DTCs that were told as stored: DTC -> how often it occurred."""
    told = [e for e in run.events if e["event"] == "dtc" and e["stored"] and e["status"] & 0x08]
    return {event["dtc"]: event["occurrence"] for event in told}


def hang(run, storm):
    """Have a step not return; returns the monitor that stays off until its file is deleted."""
    storm.loops = True
    assert run.process.wait(120) == HUNG_EXIT
    storm.loops = False
    (line,) = [line for line in run.said.splitlines() if "its step did not return" in line]
    assert f"{MODULE}.py" in line
    return line.split()[1]


@pytest.mark.evidence("Durability: monitors that misbehave")
@pytest.mark.timeout(300 + 30 * KILLS)
def test_kill_9_beside_monitors_that_misbehave_loses_nothing_that_was_told(tmp_path):
    seed = int(os.environ.get("GATEWAY_SEED", "52"))
    print("seed", seed)
    rng, memory = random.Random(seed), tmp_path / "f.sqlite"
    config, worst, last, count, hung = configure(tmp_path), {}, {}, 0, None
    with ExitStack() as stack:
        uri = stack.enter_context(bus(tmp_path))
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        storm = stack.enter_context(Voltages(host, int(port), rng.randrange(2**32)))
        for k in range(KILLS):
            run = Run(config, uri, memory, tmp_path)
            if hung is not None:
                (off,) = [line for line in run.lines if line["monitor"] == hung]
                assert "its step did not return" in off["reason"]
            if k % 100 == 99:
                print(f"{k + 1} runs, {count} DTCs told as stored", flush=True)
            if k % HANGS == HANGS - 1:
                hung = hang(run, storm)
                continue
            if k % WHOLE == WHOLE - 1 and hung is None:
                run.wait_for(lambda run=run: is_whole(run))
            else:
                time.sleep(rng.uniform(0.01, 0.5))
            run.kill()
            assert_each_is_named_once(run, {hung} - {None})
            told = promised(run)
            count += len(told)
            kept = {entry["dtc"]: entry for entry in service.list_entries(memory)}
            assert all(kept[dtc]["confirmed"] for dtc in told), (k, told, kept)
            for dtc, occurrence in [*told.items(), *worst.items()]:
                if dtc in kept or dtc in told or k - last[dtc] < AGING:
                    assert kept[dtc]["occurrence"] >= occurrence, (k, dtc)
            last |= {dtc: k for dtc, entry in kept.items() if entry["occurrence"] > worst.get(dtc, 0)}
            worst = {dtc: entry["occurrence"] for dtc, entry in kept.items()}
            assert service.verify(memory)["broken"] == [], k
            if hung is not None:
                file_beside(memory).unlink()
                hung = None
        assert storm.is_alive(), "the storm must have lasted to the last kill"
    print(f"{KILLS} kills, {count} confirmed DTCs told as stored before them, none missing")
    assert count >= 2 * KILLS
