"""The connection to a daemon's status socket: opened again and again until there is one."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gateway.common.fence import Fence, Wall
from gateway.host.sockets import credentials_of, open_connection
from gateway_serve.wire import Garbled, Splitter

#: Waits between attempts to reach the daemon [s].
FIRST_WAIT_S, LONGEST_WAIT_S = 0.05, 1.0
#: How long an answer is waited for [s].
ANSWER_S = 10.0
PROTOCOL = 1


class Refused(Exception):
    """The daemon does not do what it was asked, or is not there; says why."""


class Absent(Refused):
    """The daemon is not there, or does not answer."""


def absence(why: str) -> str:
    """Return that no gateway is reached, why, and the way on."""
    return f"no gateway runs here ({why}); start one: gateway run; or name its socket: --status"


class StatusLink:
    """Reads one status socket for as long as it runs.

    Args:
        path: of the socket.
        on_message: takes each message and its block.
        on_link: told whether there is a daemon, and why not.
        wall: around each message; None: one of its own.
    """

    def __init__(
        self,
        path: Path,
        on_message: Callable[[dict[str, Any], bytes], None],
        on_link: Callable[[bool, str], None],
        wall: Wall | None = None,
    ) -> None:
        self._wall = wall or Fence().wall("gateway")
        self.path = path
        self._on_message, self._on_link = on_message, on_link
        self._writer: asyncio.StreamWriter | None = None
        self._tickets = itertools.count(1)
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}

    async def run(self) -> None:
        """Read until cancelled; a daemon that goes away is waited for."""
        wait_s = FIRST_WAIT_S
        while True:
            try:
                reader, self._writer = await open_connection(self.path)
            except OSError as error:
                self._on_link(False, f"{self.path}: {error.strerror or error}")
                await asyncio.sleep(wait_s)
                wait_s = min(2 * wait_s, LONGEST_WAIT_S)
                continue
            wait_s = FIRST_WAIT_S
            why = "the gateway has ended"
            try:
                await self._read(reader)
            except (OSError, Garbled) as error:
                why = f"{self.path}: {error}"
            finally:
                self._end()
            self._on_link(False, why)
            await asyncio.sleep(FIRST_WAIT_S)

    async def _read(self, reader: asyncio.StreamReader) -> None:
        splitter = Splitter()
        while data := await reader.read(1 << 18):
            for message, block in splitter.feed(data):
                kind = message.get("kind")
                if not isinstance(kind, str):
                    raise Garbled("a message of no kind")
                if kind == "hello":
                    if message.get("protocol") != PROTOCOL:
                        raise Garbled(f"protocol {message.get('protocol')}: gateway and page are of different versions")
                    self._on_link(True, "")
                self._wall.keep(self._take, message, block, of=kind)

    def _take(self, message: dict[str, Any], block: bytes) -> None:
        if message["kind"] == "answer":
            waiting = self._answers.get(message.get("id", 0))
            if waiting is not None and not waiting.done():
                waiting.set_result(message)
        self._on_message(message, block)

    def _end(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None
        for waiting in self._answers.values():
            if not waiting.done():
                waiting.set_exception(Absent("the gateway ended before it answered"))

    @property
    def peer(self) -> int:
        """Process at the other end; 0: there is none, or the system does not say."""
        socket = None if self._writer is None else self._writer.get_extra_info("socket")
        return 0 if socket is None else credentials_of(socket)[0]

    async def ask(self, do: str, **keys: Any) -> dict[str, Any]:
        """Have the daemon do something; returns its answer.

        Raises:
            Refused: it does not, or does not answer.
        """
        if self._writer is None:
            raise Absent("the gateway does not run")
        ticket = next(self._tickets)
        waiting: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[ticket] = waiting
        try:
            self._writer.write(json.dumps({"id": ticket, "do": do, **keys}).encode() + b"\n")
            answer = await asyncio.wait_for(waiting, ANSWER_S)
        except TimeoutError as error:
            raise Absent("the gateway does not answer") from error
        finally:
            del self._answers[ticket]
        if not answer.get("ok"):
            raise Refused(str(answer.get("error", "refused")))
        return answer
