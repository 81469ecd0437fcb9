"""Locks of components: made, shown, prolonged, ended; :mod:`gateway_serve.sovd.holding` has what they mean."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta

from pydantic import Field

from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.holding import Lock
from gateway_serve.sovd.model import Body, Model, Whole
from gateway_serve.sovd.table import Call, Endpoint, Made

#: Longest time of a lock [s].
LONGEST_S = 3600


class LockRequest(Body):
    """How long a lock is to last [s]."""

    lock_expiration: Whole = Field(ge=1, le=LONGEST_S)


class LockCreated(Model):
    """A lock."""

    id: str
    owned: bool


class LockList(Model):
    """Locks of a component: none, or one."""

    items: list[LockCreated]


class LockShown(Model):
    """A lock, and when it ends."""

    owned: bool
    lock_expiration: datetime


def _one(call: Call) -> Lock:
    lock = call.state.locks.of(call.state.component(call.path).id)
    if lock is None or lock.id != call.path["lock_id"]:
        raise SovdError(404, "there is no such lock")
    return lock


def _mine(call: Call) -> Lock:
    lock = _one(call)
    if lock.who != call.who:
        raise SovdError(403, "this lock is another client's")
    return lock


async def _list(call: Call) -> LockList:
    lock = call.state.locks.of(call.state.component(call.path).id)
    return LockList(items=[] if lock is None else [LockCreated(id=lock.id, owned=lock.who == call.who)])


async def _take(call: Call) -> Made:
    component = call.state.component(call.path)
    lock = call.state.locks.take(component, call.who, call.body.lock_expiration)
    return Made(LockCreated(id=lock.id, owned=True), f"{call.url.rstrip('/')}/{lock.id}")


async def _show(call: Call) -> LockShown:
    lock = _one(call)
    left_s = lock.until_s - asyncio.get_running_loop().time()
    return LockShown(owned=lock.who == call.who, lock_expiration=datetime.now(UTC) + timedelta(seconds=left_s))


async def _prolong(call: Call) -> None:
    call.state.locks.prolong(_mine(call), call.body.lock_expiration)


async def _release(call: Call) -> None:
    await call.state.locks.release(_mine(call))


_LOCKS = "/components/{component_id}/locks"
ENDPOINTS = (
    Endpoint("GET", _LOCKS, "Locks of a component", _list, LockList),
    Endpoint("POST", _LOCKS, "Lock a component", _take, LockCreated, 201, LockRequest),
    Endpoint("GET", _LOCKS + "/{lock_id}", "A lock", _show, LockShown),
    Endpoint("PUT", _LOCKS + "/{lock_id}", "Prolong a lock", _prolong, None, 204, LockRequest),
    Endpoint("DELETE", _LOCKS + "/{lock_id}", "End a lock, and its session", _release, None, 204),
)
