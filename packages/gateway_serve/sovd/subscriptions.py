"""Cyclic subscriptions and triggers: a value, or the faults, again and again or at a change, as server-sent events."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from typing import Any, Literal
from urllib.parse import unquote

from pydantic import Field
from starlette.responses import Response, StreamingResponse

from gateway.common.jsonlines import line
from gateway_serve.link import Refused
from gateway_serve.sovd import data, faults
from gateway_serve.sovd.components import BASE, OWN, place
from gateway_serve.sovd.errors import CODES, VENDOR, GenericError, SovdError
from gateway_serve.sovd.model import Body, Model, ReadValue, Whole
from gateway_serve.sovd.table import Call, Endpoint, Made
from gateway_serve.sovd.watching import Subscription

#: How often a resource is told, by the name of the interval [s].
INTERVALS = {"fast": 0.1, "normal": 1.0, "slow": 5.0}
#: A stream that has nothing to tell says that it is alive [s].
ALIVE_S = 5.0
LONGEST_S = 86_400
_CYCLIC, _TRIGGERS = "cyclic-subscriptions", "triggers"
_RESOURCE = re.compile(rf"(?:{BASE})?/components/{OWN}/(?:(faults)|data/([^/]+))")
_Interval = Literal["fast", "normal", "slow"]
_Condition = Literal["OnChange", "EnterRange", "LeaveRange"]


class CyclicRequest(Body):
    """A resource of the gateway (its faults, or data), how often [interval], and for how long [s]."""

    resource: str = Field(max_length=1000)
    interval: _Interval = "normal"
    duration: Whole = Field(60, ge=1, le=LONGEST_S)
    protocol: Literal["sse"] = "sse"


class TriggerCondition(Body):
    """When an event is told; bounds are of a range."""

    condition_type: _Condition = "OnChange"
    lower_bound: float | None = None
    upper_bound: float | None = None


class TriggerRequest(Body):
    """A resource of the gateway, its condition, and for how long [s]."""

    resource: str = Field(max_length=1000)
    trigger_condition: TriggerCondition = TriggerCondition()
    lifetime: Whole = Field(60, ge=1, le=LONGEST_S)
    protocol: Literal["sse"] = "sse"


class Cyclic(Model):
    """A cyclic subscription, and where its events are."""

    id: str
    observed_resource: str
    event_source: str
    protocol: Literal["sse"] = "sse"
    interval: _Interval


class CyclicList(Model):
    """Cyclic subscriptions."""

    items: list[Cyclic]


class Trigger(Model):
    """A trigger, and where its events are."""

    id: str
    observed_resource: str
    event_source: str
    protocol: Literal["sse"] = "sse"
    status: Literal["active"] = "active"
    trigger_condition: str


class TriggerList(Model):
    """Triggers."""

    items: list[Trigger]


class Event(Model):
    """One event of a stream."""

    timestamp: datetime
    payload: dict[str, Any] | None = None
    error: GenericError | None = None


def _events_at(one: Subscription) -> str:
    return place("components", OWN, one.kind, one.id, "events")


def _cyclic(one: Subscription) -> Cyclic:
    source = _events_at(one)
    return Cyclic(id=one.id, observed_resource=one.resource, event_source=source, interval=one.interval)


def _trigger(one: Subscription) -> Trigger:
    source = _events_at(one)
    return Trigger(id=one.id, observed_resource=one.resource, event_source=source, trigger_condition=one.condition)


def _own(call: Call) -> None:
    if call.state.component(call.path).id != OWN:
        raise SovdError(404, "only the gateway has subscriptions")


async def _add(call: Call, one: Subscription) -> None:
    _own(call)
    await _read(call, one.resource)
    one.until_s += asyncio.get_running_loop().time()
    call.state.subscriptions.add(one)


async def _subscribe(call: Call) -> Made:
    body: CyclicRequest = call.body
    one = Subscription(_CYCLIC, call.who, body.resource, INTERVALS[body.interval], body.duration, body.interval)
    await _add(call, one)
    return Made(_cyclic(one), f"{call.url}/{one.id}")


async def _set_trigger(call: Call) -> Made:
    body: TriggerRequest = call.body
    when = body.trigger_condition
    low = float("-inf") if when.lower_bound is None else when.lower_bound
    high = float("inf") if when.upper_bound is None else when.upper_bound
    one = Subscription(
        _TRIGGERS, call.who, body.resource, INTERVALS["fast"], body.lifetime, "fast", when.condition_type, (low, high)
    )
    await _add(call, one)
    return Made(_trigger(one), f"{call.url}/{one.id}")


def _found(call: Call, kind: str) -> Subscription:
    _own(call)
    key = call.path["subscription_id"]
    one = next((each for each in call.state.subscriptions.all() if each.kind == kind and each.id == key), None)
    if one is None:
        raise SovdError(404, "there is no such subscription")
    return one


def _all(call: Call, kind: str) -> list[Subscription]:
    _own(call)
    return [each for each in call.state.subscriptions.all() if each.kind == kind]


async def _read(call: Call, resource: str) -> dict[str, Any]:
    """Return what a resource says now.

    Raises:
        SovdError: nobody can subscribe to it.
    """
    match = _RESOURCE.fullmatch(resource)
    if match is None:
        raise SovdError(404, f"resource: {BASE}/components/{OWN}/faults or .../data/ID")
    one = call.state.components()[OWN]
    if match[1]:
        found = await faults.of(call)
        return faults.FaultList(items=[each.shown for each in found.values()]).as_json()
    key = unquote(match[2])
    return ReadValue(id=key, data=await data.read(call, one, key)).as_json()


def _stream(kind: str) -> Callable[[Call], Any]:
    async def events(call: Call) -> Response:
        one = _found(call, kind)
        if one.open:
            raise SovdError(409, "somebody listens to it")
        one.open = True
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(_events(call, one), media_type="text/event-stream", headers=headers)

    return events


async def _events(call: Call, one: Subscription) -> AsyncIterator[str]:
    loop = asyncio.get_running_loop()
    before: dict[str, Any] | None = None
    quiet_s = loop.time()
    try:
        while loop.time() < one.until_s and not call.state.hub.ending:
            event = await _event(call, one)
            said = event.as_json()
            now = {name: said.get(name) for name in ("payload", "error")}
            if one.kind == _CYCLIC or _fires(one, before, now):
                quiet_s = loop.time()
                yield f"data: {line(said)}\n\n"
            elif loop.time() > quiet_s + ALIVE_S:
                quiet_s = loop.time()
                yield ": alive\n\n"
            before = now
            await asyncio.sleep(one.every_s)
    finally:
        one.open = False


async def _event(call: Call, one: Subscription) -> Event:
    now = datetime.now(UTC)
    try:
        return Event(timestamp=now, payload=await _read(call, one.resource))
    except SovdError as error:
        code, text = error.code, error.message
    except Refused as error:
        code, text = CODES[503], str(error)
    vendor = "event" if code == VENDOR else None
    return Event(timestamp=now, error=GenericError(error_code=code, vendor_code=vendor, message=text))


def _fires(one: Subscription, before: dict[str, Any] | None, now: dict[str, Any]) -> bool:
    """Return whether a trigger's condition is met now, and was not before."""
    if one.condition == "OnChange":
        return before is not None and before != now
    wanted = one.condition == "EnterRange"
    return _inside(one, now) is wanted and before is not None and _inside(one, before) is (not wanted)


def _inside(one: Subscription, said: dict[str, Any]) -> bool | None:
    """Return whether a value is in the range; None: there is none."""
    value = ((said["payload"] or {}).get("data") or {}).get("value")
    return one.bounds[0] <= value <= one.bounds[1] if isinstance(value, int | float) else None


async def _list_cyclic(call: Call) -> CyclicList:
    return CyclicList(items=[_cyclic(each) for each in _all(call, _CYCLIC)])


async def _show_cyclic(call: Call) -> Cyclic:
    return _cyclic(_found(call, _CYCLIC))


async def _list_triggers(call: Call) -> TriggerList:
    return TriggerList(items=[_trigger(each) for each in _all(call, _TRIGGERS)])


async def _show_trigger(call: Call) -> Trigger:
    return _trigger(_found(call, _TRIGGERS))


def _ending(kind: str) -> Callable[[Call], Any]:
    async def end(call: Call) -> None:
        one = _found(call, kind)
        if one.who != call.who:
            raise SovdError(403, "this is another client's")
        call.state.subscriptions.remove(one)

    return end


_C, _T = (f"/components/{{component_id}}/{kind}" for kind in (_CYCLIC, _TRIGGERS))
_ID, _STREAM = "/{subscription_id}", "/{subscription_id}/events"
_SSE = "text/event-stream"
ENDPOINTS = (
    Endpoint("GET", _C, "Cyclic subscriptions", _list_cyclic, CyclicList),
    Endpoint("POST", _C, "Subscribe to a resource", _subscribe, Cyclic, 201, CyclicRequest),
    Endpoint("GET", _C + _ID, "A cyclic subscription", _show_cyclic, Cyclic),
    Endpoint("DELETE", _C + _ID, "End it", _ending(_CYCLIC), None, 204),
    Endpoint("GET", _C + _STREAM, "Its events", _stream(_CYCLIC), media=_SSE),
    Endpoint("GET", _T, "Triggers", _list_triggers, TriggerList),
    Endpoint("POST", _T, "Be told when a resource changes", _set_trigger, Trigger, 201, TriggerRequest),
    Endpoint("GET", _T + _ID, "A trigger", _show_trigger, Trigger),
    Endpoint("DELETE", _T + _ID, "End it", _ending(_TRIGGERS), None, 204),
    Endpoint("GET", _T + _STREAM, "Its events", _stream(_TRIGGERS), media=_SSE),
)
