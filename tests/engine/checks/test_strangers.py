"""Identifiers that nobody of a bus has: told with their first payload and count, known ones never, floods in bounds."""

from typing import Any

import numpy as np
import pytest

from gateway.bus.frames import EXTENDED, empty, put
from gateway.config.load import load_config
from gateway.engine.checks.unknown_ids import MOST
from gateway.runtime.app import Gateway

MS = 1_000_000
CONFIG = """
[[bus]]
name = "a"
uri = "virtual:a"
database = ["dbc/crank.dbc", "dbc/gateway.dbc"]
health = {{ unknown = "{mode}", known = [0x123, 0x18FEF100] }}
check = [{{ message = "CTW_PT4" }}]

[[bus]]
name = "b"
uri = "virtual:b"
database = ["dbc/vehicle.dbc"]
match = "pgn"
health = {{ unknown = "{mode}" }}

[output.uds]
bus = "a"
request = 0x610
response = 0x611
[output.j1939]
bus = "b"
name = {{ manufacturer = 1, identity = 5, function = 3 }}
"""


@pytest.fixture
def gateway(tmp_path, request):
    mode = getattr(request, "param", "fault")
    path = tmp_path / "gateway.toml"
    path.write_text(CONFIG.format(mode=mode))
    made = Gateway(load_config(path))
    made.events = []
    made.listen(made.events.append)
    made.start(0)
    yield made
    made.close()


def feed(gateway, rows):
    frames = empty(len(rows))
    for k, (t_ms, bus, can_id, data) in enumerate(rows):
        put(frames, k, round(t_ms * MS), can_id, data, bus=bus)
    gateway.feed(frames)


def security(gateway) -> list[dict[str, Any]]:
    return [event for event in gateway.events if event["event"] == "security"]


def test_what_belongs_to_a_bus_is_never_told(gateway):
    """Messages that are decoded or not, servers, testers, known ones, and groups of J1939."""
    mine = [message.frame_id for message in gateway.databases[0]]
    rows = [(1.0 * k, 0, can_id | (EXTENDED if can_id > 0x7FF else 0), bytes(8)) for k, can_id in enumerate(mine)]
    others = [0x123, EXTENDED | 0x18FEF100, 0x610, 0x611, 0x7DF, 0x7E8, 0x77A, EXTENDED | 0x18DA10F1]
    rows += [(500.0 + k, 0, can_id, bytes(8)) for k, can_id in enumerate(others)]
    j1939 = [0x18EEFF21, 0x18EAFF00, 0x18ECFF33, 0x1CEBFF33, 0x18FECA44, 0x18FEEC00]
    rows += [(700.0 + k, 1, EXTENDED | can_id, bytes(8)) for k, can_id in enumerate(j1939)]
    feed(gateway, rows)
    gateway.stop(10_000 * MS)
    assert security(gateway) == []
    assert not any(event["event"] == "dtc" for event in gateway.events)


@pytest.mark.evidence("Nothing is silent: strangers")
@pytest.mark.parametrize("gateway", ["tell", "fault", "none"], indirect=True)
def test_an_unknown_identifier_is_told_with_its_first_payload_and_count(gateway):
    mode = gateway.config.bus[0].health.unknown
    feed(gateway, [(25.0 * k, 0, 0x3A1, bytes([k, 2, 3])) for k in range(200)])
    told, dtcs = security(gateway), [event for event in gateway.events if event["event"] == "dtc"]
    if mode == "none":
        assert told == dtcs == []
        assert gateway.identifiers_on(0) is not None
        return
    assert gateway.identifiers_on(0) is None, "the kernel's filter would keep it from us"
    assert (told[0]["sensor"], told[0]["kind"], told[0]["t_ns"]) == ("a.3A1", "unknown", 0)
    assert told[0]["context"] == {"frames": 1, "first_payload": "000203", "length": 3}
    assert [event["context"]["frames"] for event in told] == [1, 100], "10 came in the same second"
    gateway.advance(8_000 * MS)
    gateway.stop(8_000 * MS)
    assert sum(event["count"] for event in security(gateway)) == 200
    if mode == "tell":
        assert dtcs == []
        return
    dtcs = [event for event in gateway.events if event["event"] == "dtc"]
    assert [(event["dtc"], event["status"] & 1) for event in dtcs] == [("U0001-55", 1), ("U0001-55", 0)]
    assert dtcs[0]["t_ns"] == 50 * MS
    assert dtcs[0]["evidence"]["identifier"] == 0x3A1
    assert dtcs[0]["evidence"]["bytes 0 to 3"] == 0x030202, "of the frame that failed"


def test_a_frame_of_another_bus_names_that_bus(gateway):
    can_id = next(message.frame_id for message in gateway.databases[0] if not 0x700 <= message.frame_id <= 0x7FF)
    can_id |= EXTENDED if can_id > 0x7FF else 0
    feed(gateway, [(10.0 * k, 1, can_id, bytes(8)) for k in range(5)])
    assert [(event["kind"], event["context"]["of_bus"]) for event in security(gateway)] == [("wrong_bus", "a")]


def test_a_flood_of_identifiers_is_a_bounded_number_of_events(gateway):
    seed = 5307
    rng = np.random.default_rng(seed)
    count = 50_000
    ids = EXTENDED | rng.integers(0x0100_0000, 0x0200_0000, count)
    feed(gateway, [(0.05 * k, 0, int(can_id), bytes(8)) for k, can_id in enumerate(ids)])
    told = security(gateway)
    assert MOST < len(told) < MOST + 10, f"seed {seed}"
    assert told[-1]["sensor"] == "a.others"
    gateway.stop(10_000 * MS)
    assert sum(event["count"] for event in security(gateway)) == count, f"seed {seed}: none is lost"
