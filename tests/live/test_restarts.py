"""A daemon that died and is started again: counted, told, and it waits longer each time before it opens its buses."""

import pytest
from daemon_rig import World

from gateway.faults import service
from gateway.faults.hung_monitors import hung_beside
from gateway.faults.restarts import LONGEST_S, REPEATED, WELL_S
from gateway.live.notify import Notifier

CONFIG = """\
[[bus]]
name = "a"
uri = "virtual:a"
database = ["car.dbc"]
[[bus.check]]
message = "M"
timeout_ms = 100.0
"""
DBC = 'VERSION ""\nBU_: E\nBO_ 256 M: 8 E\n SG_ A : 0|8@1+ (1,0) [0|255] "" E\n'
RESTARTED = "U3000-47"


class Died(BaseException):
    """Nothing in the daemon catches it."""


class Service:
    """What a service manager does: it starts the daemon again and again on one memory."""

    def __init__(self, folder):
        (folder / "car.dbc").write_text(DBC)
        (folder / "g.toml").write_text(CONFIG)
        self.config, self.memory = folder / "g.toml", folder / "f.sqlite"
        self.world = World()

    def start(self, **options):
        self.world.events.clear()
        self.world.waits.clear()
        return self.world.daemon(self.config, self.memory, **options)

    def die(self, script=None):
        """Start, and die at the end of a script."""
        daemon = self.start()
        turns = iter(self.world.wait(0.05) if script is None else script)

        def stop():
            try:
                next(turns)
            except StopIteration:
                raise Died from None

        with pytest.raises(Died):
            daemon.run(stop)
        daemon.close()  # as the end of a process does: nothing is completed

    def run(self, script=None):
        """Start, and stop in order."""
        daemon = self.start()
        self.world.play(daemon, self.world.wait(0.05) if script is None else script)
        daemon.close()

    def later(self, seconds):
        """A script: much time passes at once."""
        yield from self.world.wait(0.02)
        self.world.now_ns += round(seconds * 1e9)
        yield from self.world.wait(0.05)

    @property
    def waited_s(self):
        return round(sum(seconds for _, seconds in self.world.waits), 6)

    @property
    def told(self):
        """The event of the last start; None: there was none."""
        events = self.world.told("restart")
        assert len(events) <= 1
        return events[0] if events else None

    @property
    def failing(self):
        """Whether the gateway's own DTC is there and fails."""
        found = {entry["dtc"]: entry["status"] for entry in service.list_entries(self.memory)}
        return bool(found.get(RESTARTED, 0) & 1)


@pytest.fixture
def served(tmp_path):
    return Service(tmp_path)


def test_restarts_are_counted_told_and_waited_for_longer_each_time(served):
    served.die()
    assert (served.told, served.waited_s) == (None, 0), "the first start"
    waits = []
    for count in range(1, 10):
        served.die()
        event = served.told
        assert (event["count"], event["in_a_row"], event["cycle"]) == (count, count, 1)
        assert event["reason"] == "the process ended without a stop"
        assert event["wait_s"] == served.waited_s
        assert served.failing == (count >= REPEATED)
        waits.append(served.waited_s)
    assert waits == [0, 0, 1, 2, 4, 8, LONGEST_S, LONGEST_S, LONGEST_S]
    found = service.restarts(served.memory)
    assert (found["count"], found["in_a_row"], found["t_ns"]) == (9, 9, event["t_ns"])
    served.run()
    assert served.told["count"] == 10
    served.run()
    assert (served.told, served.waited_s, served.failing) == (None, 0, False), "it was stopped in order"
    assert service.restarts(served.memory)["count"] == 10
    served.die()
    served.die()
    assert (served.told["count"], served.told["in_a_row"]) == (11, 1)


def test_a_wait_says_so_in_one_line_to_the_manager_too_and_ends_when_asked(served, monkeypatch):
    for _ in range(6):
        served.die()
    said = []
    monkeypatch.setattr(Notifier, "_send", lambda self, text: said.append(text))
    world = served.world
    world.leaving = lambda: len(world.waits) >= 3
    daemon = served.start()
    assert served.waited_s < 0.5, "not the whole 8 s"
    assert said == ["EXTEND_TIMEOUT_USEC=68000000\nSTATUS=6 restarts in a row without a stop: buses are opened in 8 s"]
    world.play(daemon, [])
    daemon.close()
    world.leaving = lambda: False
    served.run()
    assert served.told is None, "it ended in order"


def test_time_that_goes_well_halves_the_count(served):
    for _ in range(7):
        served.die()
    assert served.told["in_a_row"] == 6
    served.die(served.later(WELL_S + 1))
    assert (served.told["in_a_row"], served.failing) == (7, True)
    served.die(served.later(WELL_S + 1))
    assert (served.told["in_a_row"], served.failing) == (4, False), "7, halved: 3; and now 4, halved: 2"
    served.die()
    assert (served.told["in_a_row"], served.told["count"]) == (3, 9)


def test_deaths_far_from_each_other_make_no_start_wait(served):
    for _ in range(6):
        served.die(served.later(WELL_S + 1))
        assert served.waited_s == 0
    assert served.told["in_a_row"] == 1


def test_a_power_cut_is_told_and_is_no_repeated_failure(served):
    for k in range(6):
        served.world.boot = str(k)
        served.die()
        assert served.waited_s == 0
        assert not served.failing
    assert (served.told["reason"], served.told["count"]) == ("the machine was started again: power cut, or reboot", 5)
    served.die()
    assert served.told["reason"] == "the process ended without a stop"


def test_the_watchdog_is_named_once(served):
    served.die()
    hung_beside(served.memory).add("m", "digest", "its step did not return for 5 s")
    served.die()
    assert served.told["reason"] == "the watchdog ended the process: a monitor's step did not return"
    served.die()
    assert served.told["reason"] == "the process ended without a stop"


def test_a_start_that_dies_while_it_waits_or_opens_its_buses_counts_too(served, monkeypatch):
    for _ in range(4):
        served.die()

    def dies(seconds):
        raise Died

    monkeypatch.setattr(served.world, "sleep", dies)
    for count in (4, 5):
        with pytest.raises(Died):
            served.start()
        assert service.restarts(served.memory)["count"] == count
    assert service.daemon_state(served.memory)["restarts"]["in_a_row"] == 5


def test_a_reload_counts_nothing(served):
    served.die()
    served.die()
    daemon = served.start()
    world = served.world

    def script():
        yield from world.wait(0.02)
        daemon.reloader.request(0, None)
        while not world.told("config"):
            yield from world.wait(0.005)

    world.play(daemon, script())
    daemon.close()
    assert world.told("config")[0]["state"] == "reloaded"
    assert served.told["count"] == 2
