"""Negative response codes (ISO 14229-1, Annex A.1)."""

from __future__ import annotations

from enum import IntEnum


class Nrc(IntEnum):
    """The codes that this server uses."""

    GENERAL_REJECT = 0x10
    SERVICE_NOT_SUPPORTED = 0x11
    SUB_FUNCTION_NOT_SUPPORTED = 0x12
    INCORRECT_LENGTH = 0x13
    RESPONSE_TOO_LONG = 0x14
    BUSY = 0x21
    CONDITIONS_NOT_CORRECT = 0x22
    REQUEST_SEQUENCE_ERROR = 0x24
    NO_RESPONSE_FROM_SUBNET = 0x25
    REQUEST_OUT_OF_RANGE = 0x31
    SECURITY_ACCESS_DENIED = 0x33
    AUTHENTICATION_REQUIRED = 0x34
    INVALID_KEY = 0x35
    EXCEEDED_NUMBER_OF_ATTEMPTS = 0x36
    REQUIRED_TIME_DELAY_NOT_EXPIRED = 0x37
    CERTIFICATE_TIME = 0x50
    CERTIFICATE_SIGNATURE = 0x51
    CERTIFICATE_CHAIN = 0x52
    CERTIFICATE_TYPE = 0x53
    CERTIFICATE_FORMAT = 0x54
    CERTIFICATE_CONTENT = 0x55
    CERTIFICATE_SCOPE = 0x56
    CERTIFICATE_REVOKED = 0x57
    OWNERSHIP_NOT_PROVEN = 0x58
    GENERAL_PROGRAMMING_FAILURE = 0x72
    RESPONSE_PENDING = 0x78
    SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION = 0x7E
    SERVICE_NOT_SUPPORTED_IN_SESSION = 0x7F


#: Codes that are not answered to a functional request (ISO 14229-1, 7.5): this server is not meant.
SILENT_WHEN_FUNCTIONAL = frozenset(
    {
        Nrc.SERVICE_NOT_SUPPORTED,
        Nrc.SUB_FUNCTION_NOT_SUPPORTED,
        Nrc.REQUEST_OUT_OF_RANGE,
        Nrc.SUB_FUNCTION_NOT_SUPPORTED_IN_SESSION,
        Nrc.SERVICE_NOT_SUPPORTED_IN_SESSION,
    }
)


class NegativeError(Exception):
    """A request that is answered with a negative response."""

    def __init__(self, nrc: Nrc) -> None:
        self.nrc = nrc
        super().__init__(nrc.name)


def refuse_unless(good: bool, nrc: Nrc) -> None:
    """Refuse a request with a code unless something holds.

    Raises:
        NegativeError: it does not.
    """
    if not good:
        raise NegativeError(nrc)
