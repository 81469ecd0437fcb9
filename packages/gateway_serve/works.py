"""Works of a process that go on side by side until it is told to stop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from gateway_fdi.errors import GatewayError


async def work_until(stop: asyncio.Event, works: Sequence[Callable[[], Any]], failed: str) -> None:
    """Do all works until told to stop, or until one fails.

    Args:
        stop: set when it is over.
        works: each returns what is awaited.
        failed: begin of the error's text.

    Raises:
        GatewayError: one has failed.
    """
    tasks = [asyncio.create_task(work()) for work in works]
    ended = asyncio.create_task(stop.wait())
    await asyncio.wait([*tasks, ended], return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        task.cancel()
    for result in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(result, Exception) and not isinstance(result, asyncio.CancelledError):
            raise GatewayError(f"{failed}: {result}") from result
