"""Failures as answers of HTTP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from starlette.responses import Response

from gateway_serve.sovd.errors import SovdError, error_body


def error_response(
    status: int,
    message: str,
    code: str = "",
    parameters: Mapping[str, Any] | None = None,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return an answer that is a GenericError."""
    body = error_body(status, message, code, parameters)
    return Response(body, status, headers=None if headers is None else dict(headers), media_type="application/json")


def failure(error: SovdError) -> Response:
    """Return a failure as an answer."""
    return error_response(error.status, error.message, error.code, error.parameters)
