"""Logs: what testers did to the gateway (``gateway faults interventions``)."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from gateway_serve.sovd.components import OWN, place
from gateway_serve.sovd.faults import instant
from gateway_serve.sovd.model import Model
from gateway_serve.sovd.table import Call, Endpoint


class Context(Model):
    """Where an entry comes from."""

    type: Literal["x-gateway-intervention"] = "x-gateway-intervention"
    protocol: str
    bus: str


class LogEntry(Model):
    """An intervention."""

    timestamp: datetime | None
    context: Context
    severity: Literal["info", "warn"]
    msg: str
    x_gateway: dict[str, Any] = Field(alias="x-gateway")


class LogList(Model):
    """Interventions, the oldest first."""

    items: list[LogEntry]


class Logs(Model):
    """Where the entries are."""

    entries: str


async def _logs(call: Call) -> Logs:
    return Logs(entries=place("components", call.state.component(call.path).id, "logs", "entries"))


async def _entries(call: Call) -> LogList:
    own = call.state.component(call.path).id == OWN
    found = await call.state.hub.interventions() if own else []
    return LogList(
        items=[
            LogEntry(
                timestamp=instant(each["t_ns"]),
                context=Context(protocol=each["protocol"], bus=each["bus"]),
                severity="info" if each["outcome"] == "done" else "warn",
                msg=f"{each['action']} by {each['protocol']} {each['bus']}: {each['outcome']}",
                **{"x-gateway": each},
            )
            for each in found
        ]
    )


_PATH = "/components/{component_id}/logs"
ENDPOINTS = (
    Endpoint("GET", _PATH, "Logs of a component", _logs, Logs),
    Endpoint("GET", _PATH + "/entries", "Interventions", _entries, LogList),
)
