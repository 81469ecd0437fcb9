"""MQTT: the gateway's data, as retained states of a broker.

| topic | retained | what |
|---|---|---|
| ``BASE/status`` | yes | ``online`` or ``offline``, which the broker says when this process dies (last will) |
| ``BASE/monitoring`` | yes | ``on``, or ``off`` while it is switched off |
| ``BASE/causes`` | yes | causes of the faults that are there now: a list, the most important first |
| ``BASE/dtc/FAULT`` | yes | an entry of the fault memory as JSON; gone when it is cleared |
| ``BASE/ecu/NAME/dtc/DTC`` | yes | a DTC of another ECU as JSON; gone when it went |
| ``BASE/security/SENSOR/KIND`` | yes | the last security event of a sensor and kind as JSON |
| ``BASE/signal/NAME`` | no | a chosen signal, at a limited rate |

It only tells: there is no topic by which a broker could ask for anything.

Nothing is queued while the broker is away: only the state is told, all of it again when the broker is back. So memory
stays flat however many events there are.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from paho.mqtt.client import MQTTMessageInfo

from gateway.common.jsonlines import line
from gateway.faults.status import Status
from gateway_fdi.common.log import get_logger
from gateway_serve.broker import Broker, client_of
from gateway_serve.hub import Hub
from gateway_serve.link import Refused
from gateway_serve.works import work_until

#: Pace of looking for changes, and rest after an exception [s].
LOOK_S, REST_S = 0.1, 1.0
ONLINE, OFFLINE = "online", "offline"
#: Keys of an entry that are told.
_TOLD = (
    "dtc", "fault", "status", "occurrence", "first_ns", "last_ns", "cause", "hold", "evidence", "description",
    "severity", "remedy",
)  # fmt: skip

log = get_logger(__name__)


@dataclass(frozen=True)
class Published:
    """Which data a broker gets.

    Attributes:
        base: first part of all topics; "": ``gateway/NAME``.
        signals: full names of signals.
        rate_hz: how often each of them is told at most.
    """

    base: str = ""
    signals: Sequence[str] = ()
    rate_hz: float = 1.0


class Publisher:
    """Tells a broker what a hub knows.

    Args:
        hub: that listens to a gateway.
        broker: the broker.
        told: what it gets.
        name: of the gateway, for the topics.
    """

    def __init__(self, hub: Hub, broker: Broker, told: Published, name: str) -> None:
        self._hub, self._broker, self._settings = hub, broker, told
        self._wall = hub.fence.wall("mqtt")
        self.base = told.base.strip("/") or f"gateway/{topic_part(name)}"
        self._told: dict[str, str] = {}  # topic -> retained state that the broker has
        self._anew = True
        self._next_s = 0.0
        client = client_of(broker, f"gateway-{topic_part(name)}")
        client.will_set(f"{self.base}/status", OFFLINE, qos=1, retain=True)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        self._client = client

    async def run(self) -> None:
        """Tell until cancelled."""
        self._client.connect_async(self._broker.host, self._broker.port, keepalive=10)
        self._client.loop_start()
        try:
            while True:
                try:
                    if self._client.is_connected():
                        self._publish_states()
                        await self._publish_signals()
                except Exception as error:  # of one look; the next one tells it all
                    self._wall.caught(error, "a look")
                    await asyncio.sleep(REST_S)
                await asyncio.sleep(LOOK_S)
        finally:
            await asyncio.to_thread(self._end)

    def _end(self) -> None:
        if self._client.is_connected():
            self._publish(f"{self.base}/status", OFFLINE).wait_for_publish(2.0)
            self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        """Note that all is to be told again; called in the client's thread."""
        if reason.is_failure:
            log.warning("the broker refuses", broker=self._broker.host, reason=str(reason))
            return
        log.info("broker reached", broker=self._broker.host)
        self._anew = True

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            log.warning("broker gone; it is tried again", broker=self._broker.host, reason=str(reason))

    def states(self) -> dict[str, str]:
        """Return what the broker is to have: topic -> payload."""
        made = {f"{self.base}/status": ONLINE if self._hub.connected else OFFLINE}
        made[f"{self.base}/monitoring"] = "on" if self._hub.monitoring["on"] else "off"
        made[f"{self.base}/causes"] = line([case for case in self._hub.memory["cases"] if case["failing"]])
        for entry in self._hub.memory["entries"]:
            told = {name: entry.get(name) for name in _TOLD}
            status = Status(entry["status"])
            told["failed"] = bool(status & Status.TEST_FAILED)
            told["confirmed"] = bool(status & Status.CONFIRMED_DTC)
            made[f"{self.base}/dtc/{topic_part(entry['fault'])}"] = line(told)
        for each in self._hub.memory["ecu_dtcs"]:
            if each["there"]:
                made[f"{self.base}/ecu/{topic_part(each['ecu'])}/dtc/{topic_part(each['dtc'])}"] = line(each)
        for event in self._hub.security.values():
            made[f"{self.base}/security/{topic_part(event['sensor'])}/{topic_part(event['kind'])}"] = line(event)
        return made

    def _publish_states(self) -> None:
        if self._anew:
            self._anew = False
            # Topics that an earlier process left of faults without an entry go, too.
            known = [f"{self.base}/dtc/{topic_part(fault['id'])}" for fault in self._hub.hello["faults"]]
            self._told = dict.fromkeys(known, "?")
        states = self.states()
        for topic, payload in states.items():
            if self._told.get(topic) != payload:
                self._told[topic] = payload  # before: one that cannot be told is not tried for ever
                self._wall.keep(self._publish, topic, payload, of=topic)
        for topic in [topic for topic in self._told if topic not in states]:
            del self._told[topic]
            self._wall.keep(self._publish, topic, "", of=topic)

    async def _publish_signals(self) -> None:
        now = asyncio.get_running_loop().time()
        if not self._settings.signals or now < self._next_s or not self._hub.connected:
            return
        self._next_s = now + 1.0 / self._settings.rate_hz
        try:
            answer = await self._hub.link.ask("values", signals=list(self._settings.signals))
        except Refused as error:
            log.warning("signals cannot be read", reason=str(error))
            self._next_s = now + 10.0
            return
        for name, value in answer["values"].items():
            self._client.publish(f"{self.base}/signal/{topic_part(name)}", line({"value": value}), qos=0)

    def _publish(self, topic: str, payload: str) -> MQTTMessageInfo:
        return self._client.publish(topic, payload, qos=1, retain=True)


def topic_part(name: str) -> str:
    """Return a name as one part of a topic."""
    return re.sub(r"[/+#\x00-\x1f]", "_", name) or "_"


async def publish(socket: Path, broker: Broker, told: Published, name: str, stop: asyncio.Event) -> None:
    """Tell a broker what the gateway of a status socket knows, until told to stop.

    Raises:
        GatewayError: it cannot be told: a certificate that is none, ...
    """
    hub = Hub(socket)
    publisher = Publisher(hub, broker, told, name)
    await work_until(stop, [hub.run, publisher.run], broker.host)
