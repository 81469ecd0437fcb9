"""The application: all endpoints, their documents, and GenericErrors where there is none."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Awaitable, Callable, Mapping, Sequence

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from gateway.common.jsonlines import line
from gateway_serve.hub import Hub
from gateway_serve.sovd import (
    bulk_data,
    configurations,
    data,
    entities,
    faults,
    locks,
    logs,
    modes,
    operations,
    subscriptions,
)
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.openapi import document
from gateway_serve.sovd.replies import error_response, failure
from gateway_serve.sovd.state import State
from gateway_serve.sovd.table import JSON, Endpoint, serve

_RESOURCES = (
    entities, faults, data, configurations, modes, operations, locks, logs, bulk_data, subscriptions,
)  # fmt: skip
ENDPOINTS: tuple[Endpoint, ...] = tuple(each for resource in _RESOURCES for each in resource.ENDPOINTS)
#: Documents of entities: where, and the path that they are of.
_DOCS = ("", "/areas/{area_id}", "/components/{component_id}", "/apps/{app_id}")


def sovd(hub: Hub) -> Starlette:
    """Return the application, to be mounted at ``/sovd``."""
    state = State(hub)
    by_path: dict[str, dict[str, Endpoint]] = defaultdict(dict)
    for each in ENDPOINTS:
        by_path[each.path][each.method] = each
    routes = [Route(f"/v1{path}", _handler(state, of), methods=list(of)) for path, of in by_path.items()]
    routes += [Route(f"/v1{path}/docs", _docs(state, path), methods=["GET"]) for path in _DOCS]
    version = entities.ENDPOINTS[0]
    routes.append(Route("/version-info", _handler(state, {"GET": version}), methods=["GET"]))
    app = Starlette(routes=routes, exception_handlers={HTTPException: no_endpoint})
    app.router.redirect_slashes = False
    return app


def _handler(state: State, of: dict[str, Endpoint]) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        return await serve(of["GET" if request.method == "HEAD" else request.method], state, request)

    return handle


def _docs(state: State, path: str) -> Callable[[Request], Awaitable[Response]]:
    known: Sequence[Callable[[], Mapping[str, str]]] = (
        state.buses,
        lambda: {key: one.name for key, one in state.components().items()},
        state.monitors,
    )
    entity = dict(zip(_DOCS[1:], known, strict=True)).get(path)

    async def handle(request: Request) -> Response:
        if entity is not None and next(iter(request.path_params.values())) not in entity():
            return failure(SovdError(404, "there is no such entity"))
        examples = {name: list(of()) for name, of in zip(("area_id", "component_id", "app_id"), known, strict=True)}
        return Response(line(document(ENDPOINTS, path, examples)), media_type=JSON)

    return handle


async def no_endpoint(_: Request, error: Exception) -> Response:
    """Return what is answered where there is no endpoint for a path or a method."""
    assert isinstance(error, HTTPException)
    text = "there is no such resource" if error.status_code == 404 else str(error.detail)
    return error_response(error.status_code, text, headers=error.headers)
