"""Events on their way from a car to the collector: a batch as it goes over the wire, and the topics of a broker.

A batch is compressed JSON: by bzip2, or by zlib where that gives less. Its digest is what the collector answers with
when all of it is kept: a car that gets no such answer sends its events again, and the collector tells them apart by
their ids. So nothing depends on how many messages a broker keeps, or loses.
"""

from __future__ import annotations

import bz2  # noqa: TID251 - no file
import hashlib
import json
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from gateway.common.jsonlines import line
from gateway.faults.fleet import NAME, FleetParams
from gateway.faults.outgoing import Outgoing, Tally
from gateway.runtime.contract import CONTRACT, schema
from gateway_fdi.errors import InputError

#: Events of a batch, bytes of it as they are sent, and unpacked, at most.
MOST_EVENTS, MOST_SENT, MOST_BYTES = 200, 1 << 19, 1 << 21
_DIGITS = 32
_NAME = re.compile(NAME)
_ANY = re.compile("[^\x00-\x1f\ud800-\udfff]{0,64}")
_ID = re.compile(r"([0-9a-f]{1,16})-([0-9]{1,18})")


class Id(NamedTuple):
    """Id of an event: the fault memory's file that it was written into first, and its number there."""

    origin: str
    number: int


@dataclass(frozen=True)
class Sent:
    """An event of a batch, as it came.

    Attributes:
        id: of it.
        limits: serial number of the campaign whose limits judged.
        event: of the contract, not yet looked at.
        body: it, as JSON.
    """

    id: Id
    limits: int
    event: Any
    body: str


@dataclass(frozen=True)
class Batch:
    """Events of a car.

    Attributes:
        fleet, car, model, software: of the car.
        first: id of the first event that waits in the car; None: not known.
        dropped: events that the car gave up since its file was begun.
        events: in order.
        digest: of what was sent.
    """

    fleet: str
    car: str
    model: str
    software: str
    first: Id | None
    dropped: int
    events: tuple[Sent, ...]
    digest: str


def id_of(text: object) -> Id:
    """Return the id that a text is.

    Raises:
        InputError: it is none.
    """
    found = _ID.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        raise InputError("no id of an event", key="id", value=text)
    return Id(found[1], int(found[2]))


def digest_of(payload: bytes) -> str:
    """Return what the collector answers with where it has kept a batch."""
    return hashlib.sha256(payload).hexdigest()[:_DIGITS]


def packed(car: FleetParams, rows: Sequence[Outgoing], tally: Tally) -> tuple[bytes, list[int]]:
    """Return a batch of the first of the rows that wait, as many as there is room for, and their numbers.

    Args:
        car: of whom.
        rows: the first ones that wait, in order; at least one.
        tally: of the queue.
    """
    taken, size = list[Outgoing](), 0
    for row in rows[:MOST_EVENTS]:
        size += len(row.body) + 100
        if taken and size > MOST_BYTES // 2:
            break
        taken.append(row)
    while True:
        head = {"contract": CONTRACT, "fleet": car.name, "car": car.car, "model": car.model, "software": car.software}
        head |= {"first": taken[0].id, "dropped": tally.dropped}
        events = ",".join(f'{{"id":"{row.id}","limits":{row.limits},"event":{row.body}}}' for row in taken)
        text = f'{json.dumps(head)[:-1]},"events":[{events}]}}'.encode()
        payload = min(zlib.compress(text, 9), bz2.compress(text), key=len)
        if len(payload) <= MOST_SENT or len(taken) == 1:
            return payload, [row.number for row in taken]
        taken = taken[: len(taken) // 2]


def unpacked(payload: bytes) -> Batch:
    """Return the batch that came; its events are not looked at.

    Raises:
        InputError: it is none, or larger than a car makes one.
    """
    expand = bz2.BZ2Decompressor() if payload.startswith(b"BZh") else zlib.decompressobj()
    try:
        text = expand.decompress(payload, MOST_BYTES)
        if not expand.eof or expand.unused_data:
            raise InputError(f"no batch, or one of more than {MOST_BYTES} bytes")
        told = json.loads(text)
    except (zlib.error, OSError, ValueError, RecursionError) as error:
        raise InputError("no batch: not compressed JSON") from error
    if not isinstance(told, dict) or type(told.get("contract")) is not int:
        raise InputError("no batch: no version of the contract")
    if told["contract"] > CONTRACT:
        raise InputError(f"a batch of contract {told['contract']}; this collector knows {CONTRACT}")
    fleet, car = (_text(told, name, _NAME) for name in ("fleet", "car"))
    model, software = (_text(told, name, _ANY) for name in ("model", "software"))
    events = told.get("events")
    if not isinstance(events, list) or len(events) > MOST_EVENTS:
        raise InputError(f"a list of at most {MOST_EVENTS} events", key="events")
    dropped = told.get("dropped")
    if type(dropped) is not int or not 0 <= dropped < 2**53:
        raise InputError("a count", key="dropped", value=dropped)
    first = None if told.get("first") is None else id_of(told["first"])
    return Batch(fleet, car, model, software, first, dropped, tuple(map(_sent, events)), digest_of(payload))


def _text(told: dict[str, Any], key: str, form: re.Pattern[str]) -> str:
    value = told.get(key)
    if not isinstance(value, str) or not form.fullmatch(value):
        raise InputError("no text of a batch", key=key, value=value)
    return value


def _sent(told: Any) -> Sent:
    limits = told.get("limits") if isinstance(told, dict) else None
    if type(limits) is not int or not 0 <= limits < 2**53:
        raise InputError("a serial number", key="limits", value=limits)
    event = told.get("event")
    try:
        body = line(event)
    except (ValueError, RecursionError) as error:
        raise InputError("no event: JSON that goes too deep", key="event") from error
    return Sent(id_of(told.get("id")), limits, event, body)


def topic(fleet: str, car: str, what: str) -> str:
    """Return a topic of a car, ``+``: of all; ``what``: ``events`` or ``arrived``."""
    return f"fleet/{fleet}/car/{car}/{what}"


def batch_schema() -> dict[str, Any]:
    """Return the JSON Schema of a batch, unpacked."""
    text, count = {"type": "string", "maxLength": 64}, {"type": "integer", "minimum": 0}
    name, key = {"type": "string", "pattern": NAME}, {"type": "string", "pattern": f"^{_ID.pattern}$"}
    event = {
        "type": "object",
        "required": ["id", "limits", "event"],
        "properties": {"id": key, "limits": count, "event": {"$ref": schema()["$id"]}},
    }
    return {
        "type": "object",
        "required": ["contract", "fleet", "car", "model", "software", "dropped", "events"],
        "properties": {
            "contract": {"const": CONTRACT}, "fleet": name, "car": name, "model": text, "software": text,
            "first": key, "dropped": count,
            "events": {"type": "array", "maxItems": MOST_EVENTS, "items": event},
        },
    }  # fmt: skip
