"""Negative answers by their meaning (ISO 14229-1, Annex A): which reads rest for ever, and which are tried again."""

from __future__ import annotations

#: The ECU needs longer, and says so again and again until the answer.
PENDING = 0x78
#: The answer is longer than the gateway takes.
TOO_LONG = 0x14
#: The ECU is busy: the same again, soon.
BUSY = 0x21
#: Not here, not in this session, not to us: it will say the same the next time. Sessions and keys are never asked for.
FINAL = {
    0x11: "serviceNotSupported",
    0x12: "subFunctionNotSupported",
    0x13: "incorrectMessageLengthOrInvalidFormat",
    0x14: "responseTooLong",
    0x31: "requestOutOfRange",
    0x33: "securityAccessDenied",
    0x34: "authenticationRequired",
    0x7E: "subFunctionNotSupportedInActiveSession",
    0x7F: "serviceNotSupportedInActiveSession",
}
#: Negative codes by which an ECU says that it does not know a service: at all, in this session.
UNKNOWN = (0x11, 0x7F)
#: All others (conditions not correct, voltage too low, ...): later.
