"""MQTT, with Debian's mosquitto: retained states, last will, a broker that was away."""

import asyncio
import json
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager

import paho.mqtt.client as mqtt
import pytest
from debian import program
from kernel_can import wait_for
from paho.mqtt.enums import CallbackAPIVersion

from gateway_serve.broker import Broker
from gateway_serve.hub import Hub
from gateway_serve.mqtt import Published, Publisher, topic_part

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def _needs_broker():
    program("mosquitto")


@pytest.fixture
def port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def broker(folder, port):
    """A broker that keeps nothing when it ends."""
    config = folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
    started = subprocess.Popen(
        [program("mosquitto"), "-c", config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:

        def answers():
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", port)) == 0

        wait_for(answers)
        yield started
    finally:
        started.kill()
        started.wait()


@contextmanager
def subscriber(port):
    """What a subscriber that comes now is told: topic -> (payload, whether it was retained)."""
    told = {}
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.on_message = lambda c, d, m: told.__setitem__(m.topic, (m.payload.decode(), m.retain))
    client.connect("127.0.0.1", port)
    client.subscribe("#", qos=1)
    client.loop_start()
    try:
        yield told
    finally:
        client.disconnect()
        client.loop_stop()


def entry(fault="crank.missed_pulse", status=0x2F, **more):
    return {"dtc": "P0336-39", "fault": fault, "status": status, "occurrence": 1, "evidence": {"value": 1.5}, **more}


class Running:
    """A publisher of a hub that a test fills, in a thread with a loop of its own."""

    def __init__(self, folder, port, **more):
        self.hub = Hub(folder / "nobody")
        self.hub.connected = True
        self.hub.hello = {"name": "x", "faults": [{"id": "crank.missed_pulse"}, {"id": "crank.old"}]}
        self.publisher = Publisher(self.hub, Broker(host="127.0.0.1", port=port), Published(**more), "te/st")
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self):
        self.task = self.loop.create_task(self.publisher.run())
        try:
            self.loop.run_until_complete(self.task)
        except asyncio.CancelledError:
            pass

    def entries(self, *entries):
        self.hub.memory = {**self.hub.memory, "entries": list(entries)}

    def end(self):
        self.loop.call_soon_threadsafe(self.task.cancel)
        self.thread.join(60)


TOPIC, STATUS = "gateway/te_st/dtc/crank.missed_pulse", "gateway/te_st/status"


def test_states_are_retained_cleared_ones_go_and_a_broker_that_was_away_has_them_again(tmp_path, port):
    with broker(tmp_path, port):
        left = mqtt.Client(CallbackAPIVersion.VERSION2)
        left.connect("127.0.0.1", port)
        left.loop_start()
        left.publish("gateway/te_st/dtc/crank.old", "of another day", qos=1, retain=True).wait_for_publish(60)
        left.disconnect()
        left.loop_stop()
        running = Running(tmp_path, port)
        running.entries(entry())
        with subscriber(port) as told:
            wait_for(lambda: told.get(TOPIC, ("",))[0] and told.get(STATUS, ("",))[0] == "online")
            assert json.loads(told[TOPIC][0])["failed"] is True
            running.entries(entry(status=0x2E))
            wait_for(lambda: json.loads(told[TOPIC][0])["failed"] is False)
        with subscriber(port) as told:
            wait_for(lambda: STATUS in told and TOPIC in told)
            assert told[TOPIC][1], "retained"
            assert told[STATUS] == ("online", True)
            assert "gateway/te_st/dtc/crank.old" not in told, "what nobody knows of any more is gone"
            running.entries()
            wait_for(lambda: told[TOPIC][0] == "")
        running.entries(entry())
    with broker(tmp_path, port), subscriber(port) as told:
        wait_for(lambda: told.get(TOPIC, ("",))[0] and told.get(STATUS, ("",))[0] == "online")
        running.hub.connected = False
        wait_for(lambda: told[STATUS][0] == "offline")
        running.hub.connected = True
        wait_for(lambda: told[STATUS][0] == "online")
        running.end()
        wait_for(lambda: told[STATUS][0] == "offline")


def test_chosen_signals_are_told_and_one_without_a_value_is_null(tmp_path, port):
    async def ask(do, *, signals):
        assert (do, signals) == ("values", ["A.x", "A.y"])
        return {"values": {"A.x": 2.5, "A.y": float("nan")}}

    with broker(tmp_path, port), subscriber(port) as told:
        running = Running(tmp_path, port, signals=("A.x", "A.y"), rate_hz=20.0)
        running.hub.link.ask = ask
        wait_for(lambda: "gateway/te_st/signal/A.y" in told)
        assert told["gateway/te_st/signal/A.x"] == ('{"value": 2.5}', False)
        assert told["gateway/te_st/signal/A.y"] == ('{"value": null}', False)
        running.end()


def test_one_that_is_killed_is_offline(tmp_path, port):
    program = f"""
import sys, asyncio
from pathlib import Path
from gateway_serve.hub import Hub
from gateway_serve.broker import Broker
from gateway_serve.mqtt import Publisher, Published
hub = Hub(Path("nobody"))
hub.connected = True
asyncio.run(Publisher(hub, Broker(host="127.0.0.1", port={port}), Published(), "te/st").run())
"""
    with broker(tmp_path, port), subscriber(port) as told:
        started = subprocess.Popen([sys.executable, "-c", program], cwd=tmp_path)
        wait_for(lambda: told.get(STATUS, ("",))[0] == "online")
        started.send_signal(signal.SIGKILL)
        started.wait()
        wait_for(lambda: told[STATUS][0] == "offline")


def test_names_are_one_part_of_a_topic():
    assert [topic_part(name) for name in ("a.b", "a/b", "+", "#x", "", "a\nb")] == ["a.b", "a_b", "_", "_x", "_", "a_b"]
