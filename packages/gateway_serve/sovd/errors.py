"""Failures as SOVD tells them: a GenericError with every status that is not good."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.common.jsonlines import line
from gateway.servers.uds.nrc import Nrc
from gateway_serve.sovd.model import Model

#: Status -> error code, where nothing else is known.
CODES = {
    400: "incomplete-request",
    401: "insufficient-access-rights",
    403: "insufficient-access-rights",
    409: "precondition-not-fulfilled",
    500: "sovd-server-failure",
    503: "sovd-server-failure",
    504: "not-responding",
}
#: Error code of the others; their vendor code says which.
VENDOR = "vendor-specific"
_FORBIDDEN = frozenset(
    {Nrc.SECURITY_ACCESS_DENIED, Nrc.AUTHENTICATION_REQUIRED, Nrc.INVALID_KEY, Nrc.EXCEEDED_NUMBER_OF_ATTEMPTS}
)
_NOT_NOW = frozenset(
    {
        Nrc.BUSY,
        Nrc.CONDITIONS_NOT_CORRECT,
        Nrc.REQUEST_SEQUENCE_ERROR,
        Nrc.REQUIRED_TIME_DELAY_NOT_EXPIRED,
        Nrc.SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION,
        Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION,
    }
)


class GenericError(Model):
    """A failure.

    Attributes:
        error_code: one of the standard's.
        vendor_code: says more, where that is "vendor-specific".
        message: for people.
        parameters: of a negative response by UDS ``service`` and ``nrc``.
    """

    error_code: str
    vendor_code: str | None = None
    message: str
    parameters: dict[str, Any] | None = None


class SovdError(Exception):
    """A request that fails.

    Args:
        status: of HTTP.
        message: for people.
        code: error code; "": the usual one of this status.
        parameters: of the GenericError.
    """

    def __init__(self, status: int, message: str, code: str = "", parameters: Mapping[str, Any] | None = None) -> None:
        self.status, self.message, self.parameters = status, message, parameters
        self.code = code or CODES.get(status, VENDOR)
        super().__init__(message)


def error_body(status: int, message: str, code: str = "", parameters: Mapping[str, Any] | None = None) -> bytes:
    """Return a GenericError as JSON."""
    code = code or CODES.get(status, VENDOR)
    vendor = f"http-{status}" if code == VENDOR else None
    told = GenericError(
        error_code=code, vendor_code=vendor, message=message, parameters=dict(parameters) if parameters else None
    )
    return line(told.as_json()).encode()


def negative(answer: bytes) -> SovdError:
    """Return the failure that a negative response by UDS is (ISO 14229-1, Annex A.1)."""
    service, code = answer[1], answer[2]
    names = {int(each): each.name.lower().replace("_", " ") for each in Nrc}
    text = f"service 0x{service:02X} is refused: {names.get(code, 'code')} (0x{code:02X})"
    status = 403 if code in _FORBIDDEN else 409 if code in _NOT_NOW else 400
    if code == Nrc.NO_RESPONSE_FROM_SUBNET:
        status = 504
    told = "error-response" if status == 400 else ""
    return SovdError(status, text, told, {"service": service, "nrc": code})
