"""An endpoint: its path, what it takes and gives, and the function that does the work."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic import ValidationError
from starlette.requests import Request
from starlette.responses import Response

from gateway.common.jsonlines import line
from gateway_fdi.errors import GatewayError
from gateway_serve.link import Absent, Refused
from gateway_serve.sovd.errors import SovdError
from gateway_serve.sovd.model import Body, Described, Describing, Model, Nothing
from gateway_serve.sovd.replies import error_response, failure
from gateway_serve.sovd.state import State

JSON = "application/json"


@dataclass(frozen=True)
class Call:
    """One request.

    Attributes:
        state: of the server.
        path: its parameters in the path.
        query: its parameters, as the endpoint's model of them has them.
        body: as the endpoint's model of it has it.
        who: name of the client that may change something; "": it may read.
        url: of the request.
    """

    state: State
    path: dict[str, str]
    query: Any
    body: Any
    who: str
    url: str


class Made(NamedTuple):
    """An answer with a place: what a request has made."""

    answer: Model
    location: str


@dataclass(frozen=True)
class Endpoint:
    """One method of one path.

    Attributes:
        method: GET, POST, PUT, DELETE.
        path: below BASE, ``{name}`` is a parameter.
        summary: for people.
        work: does it; returns the answer, None for no content.
        answer: model of the answer; None: none, or of another media type.
        status: of a good answer.
        body: model of the request's body; None: it has none.
        query: model of its parameters.
        media: type of the answer.
    """

    method: str
    path: str
    summary: str
    work: Callable[[Call], Awaitable[Model | Made | Response | None]]
    answer: type[Model] | None = None
    status: int = 200
    body: type[Body] | None = None
    query: type[Model] = Nothing
    media: str = JSON


async def serve(endpoint: Endpoint, state: State, request: Request) -> Response:
    """Answer a request; whatever fails is a GenericError."""
    try:
        body = None if endpoint.body is None else _body(endpoint.body, await request.body())
        query = _query(endpoint.query, request.query_params.multi_items())
        who = str(request.scope.get("gateway.who", ""))
        call = Call(state, dict(request.path_params), query, body, who, str(request.url.path))
        found = await endpoint.work(call)
    except SovdError as error:
        return failure(error)
    except Absent as error:
        return error_response(503, str(error))
    except Refused as error:
        return error_response(409, str(error))
    except GatewayError as error:
        return error_response(503, str(error))
    except Exception as error:
        state.hub.fence.note("sovd", error, f"{request.method} {request.url.path}")
        return error_response(500, "an error of this server, which is in its log")
    if isinstance(found, Response):
        return found
    headers = {}
    if isinstance(found, Made):
        headers, found = {"location": found.location}, found.answer
    if found is None:
        return Response(status_code=204)
    told = found.as_json()
    if isinstance(found, Described) and isinstance(query, Describing) and query.include_schema == "true":
        told["schema"] = type(found).model_json_schema(mode="serialization")
    return Response(line(told), endpoint.status, headers, JSON)


def _body(model: type[Body], data: bytes) -> Body:
    try:
        return model.model_validate(json.loads(data))
    except ValidationError as error:
        raise _wrong(error) from error
    except (ValueError, RecursionError) as error:
        raise SovdError(400, "the body is no JSON") from error


def _query(model: type[Model], given: Iterable[tuple[str, str]]) -> Model:
    """Return parameters; ``name[key]`` is a key of the parameter ``name``."""
    found: dict[str, Any] = {}
    for key, text in given:
        name, bracket, inner = key.partition("[")
        place, last = found, key
        if bracket and inner.endswith("]"):
            place, last = found.setdefault(name, {}), inner[:-1]
        if not isinstance(place, dict) or last in place:
            raise SovdError(400, f"the parameter {key} is given twice")
        place[last] = text
    try:
        return model.model_validate(found)
    except ValidationError as error:
        raise _wrong(error) from error


def _wrong(error: ValidationError) -> SovdError:
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    key = ".".join(map(str, first["loc"]))
    return SovdError(400, f"{key}: {first['msg']}" if key else first["msg"], parameters={"key": key})


def models_of(endpoints: Iterable[Endpoint]) -> list[type[Model]]:
    """Return all models of bodies and answers, each once."""
    found: list[type[Model]] = []
    for endpoint in endpoints:
        found += [each for each in (endpoint.body, endpoint.answer) if each is not None]
    return list(dict.fromkeys(found))
