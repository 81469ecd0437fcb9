"""What comes between two steps of a reload is lost to nobody: failures, testers' requests, losses of buses."""

import pytest
from amount import amount
from bench_config import beat, write_config
from daemon_rig import World

from gateway.faults.service import list_entries
from gateway.live.daemon import Daemon
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.runtime.app import Gateway

GW_DTC = 0x6F0
BEFORE = {"chassis": "virtual:a", "body": "virtual:b", "gone": "virtual:d"}
AFTER = {"body": "virtual:b", "chassis": "virtual:a", "third": "virtual:c"}
MORE = """
[output.uds]
bus = "chassis"
[memory.recording]
before_ms = 100.0
after_ms = 100.0
"""


def write(folder, buses, more=MORE):
    """Write a configuration whose outputs are on the bus "chassis", wherever that is in the order."""
    path = write_config(folder, buses=list(buses.items()), timeout_ms=60_000.0, more=more)
    head, *parts = path.read_text().split("[[bus]]\n")
    for k, part in enumerate(parts):
        if not part.startswith('name = "body"'):  # DTCs of their own
            part = part.replace("U0140", "U0146").replace("U0422", "U0423")
        parts[k] = part.replace('[output.dtc_frame]\nbus = "body"', '[output.dtc_frame]\nbus = "chassis"')
    path.write_text("[[bus]]\n".join([head, *parts]))
    return path


#: The steps of a reload, in their order: where they are done, and how often in this one.
PLACES = {
    "a ring is made": (Daemon, "_new_ring"),
    "a link is made": (Daemon, "_new_link"),
    "a link is opened": (Link, "start"),
    "waiting frames are fed": (Live, "drain"),
    "the old gateway finishes": (Live, "finish"),
    "it puts down what it has": (Gateway, "finish"),
    "the new gateway reads the memory": (Gateway, "__init__"),
    "the new gateway takes over": (Gateway, "succeed"),
    "the loop goes over to it": (Live, "replace"),
    "filters are set": (Link, "listen_to"),
    "a link is closed": (Link, "close"),
}


class Intruder:
    """Does something once, at a place of a reload: before it, or after it."""

    def __init__(self, monkeypatch, place, when, act):
        owner, name = PLACES[place]
        original = getattr(owner, name)
        self.armed, self.done = False, 0

        def wrapped(*arguments, **options):
            if when == "before":
                self._act(act)
            try:
                return original(*arguments, **options)
            finally:
                if when == "after":
                    self._act(act)

        monkeypatch.setattr(owner, name, wrapped)

    def _act(self, act):
        if self.armed and not self.done:
            self.done += 1
            act()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A daemon whose changed configuration has its buses in another order, another third one, and a recording."""

    def make(place, when, act, then=lambda _: None):
        world = World()
        path = write(tmp_path, BEFORE)
        counts = {"virtual:a": 0, "virtual:b": 0}

        def traffic(turn):
            if turn % 4 == 0:
                for uri, count in counts.items():
                    counts[uri] = count + 1
                    world.put(0x300, beat(count + 1), uri)

        daemon = world.daemon(path, tmp_path / "f.sqlite")
        intruder = Intruder(monkeypatch, place, when, lambda: act(world, counts))

        def script():
            yield from world.wait(0.2, traffic)
            write(tmp_path, AFTER, MORE + f'[record]\nfolder = "{tmp_path}/ring"\n')
            intruder.armed = True
            daemon.reloader.request()
            while not world.told("config"):
                yield from world.wait(0.02, traffic)
            then(world)
            yield from world.wait(1.4, traffic)
            world.entries = daemon.gateway.memory.entries()

        try:
            world.play(daemon, script())
        finally:
            daemon.close()
        assert [e["state"] for e in world.told("config")] == ["reloaded"]
        assert intruder.done == 1, "or the test shows nothing"
        world.stored = {e["dtc"]: e for e in list_entries(tmp_path / "f.sqlite")}
        return world

    return make


#: After one step is before the next one, but for what either of them does around it: that is GATEWAY_TESTS=full.
GAPS = [(place, "before") for place in PLACES]
GAPS += [(place, "after") for place in list(PLACES)[amount(0, len(PLACES) - 1) :]]
every_gap = pytest.mark.parametrize(("place", "when"), GAPS)


@every_gap
def test_a_failure_between_two_steps_is_kept_and_told(place, when, bench):
    """The counter jumps three times, and that is all: nothing repeats what was lost."""

    def act(world, counts):
        for _ in range(3):
            counts["virtual:a"] += 7
            world.put(0x300, beat(counts["virtual:a"]))

    world = bench(place, when, act)
    assert world.dtcs() == [("U0401-82", 1), ("U0401-82", 0)]
    (entry,) = world.entries
    assert (str(entry.dtc), entry.record.occurrence) == ("U0401-82", 1)
    assert world.stored["U0401-82"]["occurrence"] == 1
    told = [data for _, _, can_id, data in world.sent if can_id == GW_DTC and data[5] == 0]
    changes = [data[3] & 1 for data in told if data[:3].hex() == "c40182"]
    assert changes == [1, 0], "set and healed, on the bus"


@every_gap
def test_a_request_between_two_steps_is_answered_once(place, when, bench):
    world = bench(place, when, lambda world, _: world.put(0x7E0, bytes.fromhex("023e000000000000")))
    answers = [data.hex() for _, _, can_id, data in world.sent if can_id == 0x7E8]
    assert answers == ["027e00cccccccccc"]


def answered_in_a_slow_reload(bench, *requests, then=lambda _: None):
    """Return what a tester gets who asks while the new gateway is made, which takes 30 ms."""

    def act(world, counts):
        for data in requests:
            world.put(0x7E0, bytes.fromhex(data))
        for _ in range(3):
            counts["virtual:a"] += 7
            world.put(0x300, beat(counts["virtual:a"]))
        world.now_ns += 30_000_000

    world = bench("the new gateway reads the memory", "after", act, then)
    assert world.dtcs() == [("U0401-82", 1), ("U0401-82", 0)], "what came meanwhile is fed in its order"
    return [data.hex() for _, _, can_id, data in world.sent if can_id == 0x7E8]


def test_who_asks_in_a_reload_that_takes_its_time_is_told_to_wait(bench):
    told = answered_in_a_slow_reload(bench, "023e000000000000")
    assert told == ["037f3e78cccccccc", "027e00cccccccccc"]


def test_who_wants_no_answer_is_told_nothing(bench):
    """After 0x78 the answer must not be suppressed (ISO 14229-1, 8.7)."""
    assert answered_in_a_slow_reload(bench, "023e800000000000") == []


def test_a_request_of_several_frames_goes_on_over_a_slow_reload(bench):
    told = answered_in_a_slow_reload(
        bench, "100922f186f186f1", "2186f186cccccccc", then=lambda world: world.put(0x7E0, bytes.fromhex("300000"))
    )
    assert told == ["300000cccccccccc", "100d62f18601f186", "2101f18601f18601"]


@every_gap
def test_requests_and_answers_under_way_are_carried_over(place, when, bench):
    """The first frame of a request comes between two steps, the rest after the reload; its answer has two frames."""

    def rest(world):
        world.put(0x7E0, bytes.fromhex("2186f186cccccccc"))
        world.put(0x7E0, bytes.fromhex("300000cccccccccc"))

    first = bytes.fromhex("100922f186f186f1")
    world = bench(place, when, lambda world, _: world.put(0x7E0, first), rest)
    answers = [data.hex() for _, _, can_id, data in world.sent if can_id == 0x7E8]
    assert answers == ["300000cccccccccc", "100d62f18601f186", "2101f18601f18601"]


def test_an_answer_under_way_is_carried_over(bench):
    """Its first frame left before the reload, the flow control comes between two steps of it."""

    def act(world, _):
        world.put(0x7E0, bytes.fromhex("100922f186f186f1"))
        world.put(0x7E0, bytes.fromhex("2186f186cccccccc"))

    world = bench(
        "waiting frames are fed",
        "before",
        act,
        lambda world: world.put(0x7E0, bytes.fromhex("300000cccccccccc")),
    )
    answers = [data.hex() for _, _, can_id, data in world.sent if can_id == 0x7E8]
    assert answers == ["300000cccccccccc", "100d62f18601f186", "2101f18601f18601"]


@every_gap
@pytest.mark.parametrize("uri", ["virtual:a", "virtual:b"])
def test_a_bus_that_goes_between_two_steps_is_told_as_that_bus(place, when, uri, bench):
    world = bench(place, when, lambda world, _: world.cut.add(uri))
    name = {"virtual:a": "chassis", "virtual:b": "body"}[uri]
    lost = [e for e in world.told("bus") if e["state"] == "lost"]
    assert [(e["bus"], e["uri"]) for e in lost] == [(name, uri)]
    failed = [e["fault"] for e in world.told("dtc") if e["status"] & 1]
    assert failed == [f"{name}.bus_lost"]
    assert [e.fault for e in world.entries] == failed


def test_what_the_old_gateway_held_back_is_told_by_the_new_one(bench):
    """A change within 10 ms of the last one of its DTC waits; it is not given up with the output that held it."""

    def act(world, counts):
        for _ in range(3):
            counts["virtual:a"] += 7
            world.put(0x300, beat(counts["virtual:a"]))
        world.now_ns += 1_000_000  # until no other bus can have earlier ones
        world.running._live.turn()
        for _ in range(60):
            counts["virtual:a"] += 1
            world.put(0x300, beat(counts["virtual:a"]))

    world = bench("waiting frames are fed", "before", act)
    assert world.dtcs() == [("U0401-82", 1), ("U0401-82", 0)]
    told = [data for _, _, can_id, data in world.sent if can_id == GW_DTC and data[5] == 0]
    assert [data[3] & 1 for data in told if data[:3].hex() == "c40182"] == [1, 0]


def test_a_bus_lost_in_sending_before_the_order_changes_is_told_as_that_bus(bench):
    """The last frames come, and the answer to them finds the bus gone: known before, told after the reload."""

    def act(world, counts):
        for _ in range(3):
            counts["virtual:a"] += 7
            world.put(0x300, beat(counts["virtual:a"]))
        world.cut.add("virtual:a")

    world = bench("waiting frames are fed", "before", act)
    assert [e["bus"] for e in world.told("bus") if e["state"] == "lost"] == ["chassis"]
    failed = [e["fault"] for e in world.told("dtc") if e["status"] & 1]
    assert failed == ["chassis.Beat.counter", "chassis.bus_lost"]
