"""The application: the page's files, one stream of events, history, recordings, commands, metrics."""

from __future__ import annotations

import asyncio
import contextlib
import json
import zlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route

from gateway.common.jsonlines import line
from gateway_fdi.errors import GatewayError
from gateway_serve.bokeh_files import bokeh_folder
from gateway_serve.hub import Hub
from gateway_serve.link import Refused
from gateway_serve.metrics import Metrics
from gateway_serve.sovd.app import no_endpoint, sovd

STATIC = Path(__file__).parent / "static"
#: Kinds of the page's files.
KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
#: Files of the package bokeh that the page uses.
BOKEH = ("bokeh.min.js", "bokeh-api.min.js")
#: Pages that may be open at a time.
MOST_VIEWERS = 32
#: Period at which a stream says that it is alive [s].
ALIVE_S = 5.0
#: Keys by which a user with the control token overrides a rule of access.
_FORCE = {"force", "why"}
#: Faults whose history one request may ask for.
MOST_FAULTS = 64


class Page:
    """Answers requests."""

    def __init__(self, hub: Hub) -> None:
        self.hub = hub
        self._metrics = Metrics(hub)
        self._files = {file.name: file for file in STATIC.iterdir() if file.suffix in KINDS}
        self._bokeh = {name: bokeh_folder() / name for name in BOKEH}

    def app(self) -> Starlette:
        """Return the application."""
        return Starlette(
            routes=[
                Route("/", self._index),
                Route("/static/{name}", self._static),
                Route("/bokeh/{name}", self._bokeh_file),
                Route("/api/stream", self._stream),
                Route("/api/history", self._history),
                Route("/api/recording/{dtc}/{number:int}", self._recording),
                Route("/api/clear", self._clear, methods=["POST"]),
                Route("/api/cycle", self._cycle, methods=["POST"]),
                Route("/api/settings", self._settings, methods=["POST"]),
                Route("/api/present", self._present, methods=["POST"]),
                Route("/metrics", self._show_metrics),
                Mount("/sovd", sovd(self.hub)),
            ],
            lifespan=self._lifespan,
            exception_handlers={HTTPException: _no_page},
        )

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        work = asyncio.create_task(self.hub.run())
        asyncio.get_running_loop().set_exception_handler(self._on_error)
        try:
            yield
        finally:
            work.cancel()

    def _on_error(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Count an exception that reached the loop: the second wall."""
        error = context.get("exception")
        if isinstance(error, Exception):
            self.hub.fence.note("page", error, context.get("message", ""), second=True)
        else:
            loop.default_exception_handler(context)

    # Files

    async def _index(self, _: Request) -> Response:
        return _file(self._files["index.html"])

    async def _static(self, request: Request) -> Response:
        found = self._files.get(request.path_params["name"])
        return _missing() if found is None else _file(found)

    async def _bokeh_file(self, request: Request) -> Response:
        found = self._bokeh.get(request.path_params["name"])
        if found is None:
            return _missing()
        return FileResponse(found, media_type="text/javascript", headers={"cache-control": "private, max-age=86400"})

    # Views

    async def _stream(self, _: Request) -> Response:
        if self.hub.viewers >= MOST_VIEWERS:
            return PlainTextResponse("too many pages are open\n", 503)
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        return StreamingResponse(self._messages(), media_type="text/event-stream", headers=headers)

    async def _messages(self) -> AsyncIterator[str]:
        viewer = self.hub.open()
        try:
            while not viewer.ended:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(viewer.news.wait(), ALIVE_S)
                taken = viewer.take()
                yield "".join(f"event: {kind}\ndata: {text}\n\n" for kind, text in taken) or ": alive\n\n"
        finally:
            self.hub.close(viewer)

    async def _history(self, request: Request) -> Response:
        asked = request.query_params.get("faults", "").split(",")[:MOST_FAULTS]
        faults = [int(text) for text in asked if text.isdigit() and len(text) < 6]
        return _json({str(fault): self.hub.history.of(fault) for fault in faults})

    async def _recording(self, request: Request) -> Response:
        dtc, number = request.path_params["dtc"], request.path_params["number"]
        try:
            found = await self.hub.recording(dtc, number)
        except GatewayError:
            found = None
        if found is None:
            return _missing()
        name = f"{dtc.upper()}-{number}.log"  # a DTC by now: letters, digits and a hyphen
        return Response(
            zlib.decompress(found.log),
            media_type="text/plain",
            headers={"content-disposition": f'attachment; filename="{name}"'},
        )

    async def _show_metrics(self, _: Request) -> Response:
        return Response(self._metrics.text(), media_type=self._metrics.content_type)

    # Requests

    async def _clear(self, request: Request) -> Response:
        return await self._ask(request, "clear", {"dtc", *_FORCE})

    async def _cycle(self, request: Request) -> Response:
        return await self._ask(request, "cycle", _FORCE)

    async def _settings(self, request: Request) -> Response:
        return await self._ask(request, "settings", {"dtcs", "receive", "send", *_FORCE})

    async def _present(self, request: Request) -> Response:
        return await self._ask(request, "present", set())

    async def _ask(self, request: Request, do: str, known: set[str]) -> Response:
        try:
            asked = json.loads(await request.body() or b"{}")
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict) or set(asked) - known:
            return PlainTextResponse(f"an object with the keys {', '.join(sorted(known)) or '(none)'}\n", 400)
        if known:  # an intervention: all who could ask have the control token (guard.py)
            asked["by"] = f"page {request.client.host if request.client else ''}".strip()
        try:
            answer = await self.hub.link.ask(do, **asked)
        except Refused as error:
            return PlainTextResponse(f"{error}\n", 409)
        self.hub.ask_memory()
        return _json({key: value for key, value in answer.items() if key not in ("kind", "id")})


def _file(path: Path) -> Response:
    return FileResponse(path, media_type=KINDS[path.suffix])


async def _no_page(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    if request.url.path.startswith("/sovd/"):  # a path that no pattern takes
        return await no_endpoint(request, error)
    return PlainTextResponse(error.detail, error.status_code, error.headers)


def _json(value: Any) -> Response:
    return Response(line(value), media_type="application/json")


def _missing() -> Response:
    return JSONResponse({"error": "there is no such thing here"}, 404)
