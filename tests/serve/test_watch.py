"""What the terminal shows, of a hub that has heard a gateway."""

import json

import numpy as np
import pytest
from rich.console import Console

from gateway.config.load import load_config
from gateway.engine.buckets import TickRow
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError
from gateway_serve.cli.watch import as_json, drawn, watch
from gateway_serve.hello import described
from gateway_serve.hub import Hub


@pytest.fixture
def hub(tmp_path):
    gateway = Gateway(load_config(shipped("gateway.toml")))
    made = Hub(tmp_path / "nobody")
    made._on_link(True, "")
    made._on_hello(json.loads(json.dumps(described(gateway))), b"")
    gateway.close()
    rows = np.zeros(3, TickRow.dtype)
    rows["fault"], rows["count"], rows["numbers"] = (0, 1, 2), 1, 1
    rows["ratio"], rows["last"], rows["limit"] = (0.25, 1.5, 0.9), (1, 2, 3), (4, 5, 6)
    made._on_tick({"t_ns": 10**9}, rows.tobytes())
    return made


def text_of(hub):
    console = Console(width=120, record=True)
    with console.capture() as captured:
        console.print(drawn(hub))
    return captured.get()


def test_the_nearest_to_a_fault_comes_first(hub):
    names = [fault["id"] for fault in hub.hello["faults"]]
    assert [row["fault"] for row in as_json(hub)["nearest"]] == [names[1], names[2], names[0]]
    said = text_of(hub)
    assert said.index(names[1]) < said.index(names[2]) < said.index(names[0])
    assert "1.50" in said
    assert "no faults now" in said


def test_a_dtc_that_fails_is_what_is_said_first(hub):
    fault = hub.hello["faults"][0]
    entry = {"dtc": fault["dtc"], "fault": fault["id"], "status": 0x2F, "occurrence": 3, "last_ns": 4_020_000_000}
    hub.memory = {**hub.memory, "entries": [entry]}
    said = text_of(hub)
    assert f"1 now: {fault['dtc']}" in said.splitlines()[0]
    assert "failing" in said
    assert "4.020 s" in said
    hub._on_link(False, "gone")
    assert "not reached: gone" in text_of(hub)


def test_a_demo_that_is_over_says_so(hub):
    assert as_json(hub)["ended"] == ""
    hub._on_hello({**hub.hello, "kind": "hello", "protocol": 1, "ended": "The scenario x has ended after 8 s."}, b"")
    assert as_json(hub)["ended"] in text_of(hub).splitlines()[0]
    assert as_json(hub)["nearest"], "what it showed is still there"


def test_without_a_gateway_it_says_so(tmp_path):
    with pytest.raises(GatewayError, match="no gateway runs here .*; start one: gateway run"):
        watch(None, status=tmp_path / "nobody", once=True, json=False)
