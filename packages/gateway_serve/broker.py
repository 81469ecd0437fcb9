"""A broker of MQTT, and the connection to it: version 5, or 3.1.1 where the broker has no more."""

from __future__ import annotations

import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any

from paho.mqtt.client import Client, MQTTMessage, MQTTMessageInfo
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError

#: Reason of a broker that does not know this version of MQTT.
_OTHER_VERSION = 0x84
#: How long a broker keeps what comes for one who is away [s].
KEPT_S = 7 * 86400
#: Messages that wait in this process, and bytes of one that is taken, at most.
MOST_WAITING, MOST_BYTES = 1000, 1 << 20

log = get_logger(__name__)


@dataclass(frozen=True, kw_only=True)
class Broker:
    """Where a broker is, and how it is reached.

    Attributes:
        host, port: of the broker.
        user, password: for the broker.
        tls: whether by TLS, and ``ca``: by whose certificates.
        certificate, key: by which the client shows who it is.
    """

    host: str
    port: int = 1883
    user: str = ""
    password: str = ""
    tls: bool = False
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None


def client_of(
    broker: Broker,
    name: str,
    protocol: MQTTProtocolVersion = MQTTProtocolVersion.MQTTv311,
    *,
    lasting: bool = False,
) -> Client:
    """Return a client that is not connected.

    Args:
        broker: the broker.
        name: by which it knows this client.
        protocol: version of MQTT.
        lasting: whether the broker keeps messages while this client is away.

    Raises:
        GatewayError: a certificate that is none, ...
    """
    clean = None if protocol == MQTTProtocolVersion.MQTTv5 else not lasting
    client = Client(CallbackAPIVersion.VERSION2, client_id=name, protocol=protocol, clean_session=clean)
    client.reconnect_delay_set(1, 10)
    client.max_queued_messages_set(MOST_WAITING)
    client.suppress_exceptions = True  # of ours, in its thread: it goes on
    if broker.user:
        client.username_pw_set(broker.user, broker.password or None)
    if broker.tls:
        ca, certificate, key = (
            None if each is None else str(each) for each in (broker.ca, broker.certificate, broker.key)
        )
        try:
            client.tls_set(ca, certificate, key, tls_version=ssl.PROTOCOL_TLS_CLIENT)
        except (OSError, ValueError) as error:
            raise GatewayError(f"{broker.host}: {error}") from error
    return client


class BrokerLink:
    """A connection that comes back by itself, in a thread of its own.

    Args:
        broker: the broker.
        name: by which it knows this client.
        topics: that are subscribed.
        take: takes topic and bytes of a message, in that thread.
        connected: told in that thread that there is a connection.
        lasting: whether the broker keeps messages while this client is away.

    Raises:
        GatewayError: a certificate that is none, ...
    """

    def __init__(
        self,
        broker: Broker,
        name: str,
        topics: Sequence[str],
        take: Callable[[str, bytes], None],
        connected: Callable[[], None] = lambda: None,
        *,
        lasting: bool = False,
    ) -> None:
        self._broker, self._name, self._topics, self._lasting = broker, name, topics, lasting
        self._take, self._connected = take, connected
        self._client = self._made(MQTTProtocolVersion.MQTTv5)

    def _made(self, protocol: MQTTProtocolVersion) -> Client:
        client = client_of(self._broker, self._name, protocol, lasting=self._lasting)
        client.on_connect, client.on_message = self._on_connect, self._on_message
        client.on_disconnect = self._on_disconnect
        return client

    def begin(self) -> None:
        """Connect, and again whenever the connection has gone."""
        self._connect(MQTTProtocolVersion.MQTTv5)

    def _connect(self, protocol: MQTTProtocolVersion) -> None:
        properties = None
        more: dict[str, Any] = {}
        if protocol == MQTTProtocolVersion.MQTTv5:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.SessionExpiryInterval = KEPT_S if self._lasting else 0
            more = {"clean_start": not self._lasting, "properties": properties}
        self._client.connect_async(self._broker.host, self._broker.port, keepalive=10, **more)
        self._client.loop_start()

    def end(self) -> None:
        """Take leave."""
        self._client.disconnect()
        self._client.loop_stop()

    @property
    def is_there(self) -> bool:
        """Whether there is a connection."""
        return self._client.is_connected()

    def publish(self, topic: str, payload: bytes, *, retain: bool = False) -> MQTTMessageInfo:
        """Send a message, at least once."""
        return self._client.publish(topic, payload, qos=1, retain=retain)

    def _fall_back(self) -> None:
        """Go on with MQTT 3.1.1."""
        self._client.loop_stop()
        self._client = self._made(MQTTProtocolVersion.MQTTv311)
        self._connect(MQTTProtocolVersion.MQTTv311)

    def _on_connect(self, client: Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.value == _OTHER_VERSION and client.protocol == MQTTProtocolVersion.MQTTv5:
            log.info("the broker has no MQTT 5; 3.1.1 is taken", broker=self._broker.host)
            client.disconnect()  # it does not come again by itself
            Thread(target=self._fall_back, name="mqtt-3", daemon=True).start()  # not in its own thread
            return
        if reason.is_failure:
            log.warning("the broker refuses", broker=self._broker.host, reason=str(reason))
            return
        log.info("broker reached", broker=self._broker.host)
        if self._topics:
            client.subscribe([(topic, 1) for topic in self._topics])
        self._connected()

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        if len(message.payload) > MOST_BYTES:
            log.warning("a message that is too long is not read", topic=message.topic, bytes=len(message.payload))
            return
        self._take(message.topic, bytes(message.payload))

    def _on_disconnect(self, client: Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure and client is self._client:
            log.warning("broker gone; it is tried again", broker=self._broker.host, reason=str(reason))
