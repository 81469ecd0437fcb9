"""Kinds of checks of a message: the fault of each, who asks for it, and how it sees message and sender.

A new kind is a line of :data:`KINDS` and its step in :mod:`gateway.engine.checks.communication_steps`.

Failure type bytes (SAE J2012): 87 missing message, 82 alive counter incorrect, 83 protection calculation incorrect, 81
invalid serial data received, 29 signal invalid, 56 invalid configuration, 37 signal frequency too high, 62 signal
compare failure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from gateway.engine.checks.message import Params
from gateway.engine.checks.senders import EARLY_FAULT, SECOND_FAULT
from gateway.monitors.contract import Debounce, Fault
from gateway.signals.protection.protection import Protection

#: Debounce of a frame that is wrong, and of a rule that never fits.
WRONG = Debounce(failed_after=2, passed_after=50)
AT_ONCE = Debounce(failed_after=1, passed_after=1, jump_down=True)
#: Places in :data:`KINDS`.
TIMEOUT, COUNTER, CRC, LENGTH, VALUE, RULE, EARLY, SECOND = range(8)


@dataclass(frozen=True)
class CheckKind:
    """A kind of check of a message.

    Attributes:
        fault: that it reports, with the DTC of a message that gives no base codes.
        asked: whether the settings of a message, and its protection, ask for it.
        powers: probabilities that it fails if the message is at fault, and if the message's sender is. None: if it
            fails, the configuration is wrong.
        secured: its fault, of a message that SecOC secures; None: the same.
        foreign: names of its faults that show frames which the message's sender does not send: security events.
    """

    fault: Fault
    asked: Callable[[Params, Protection], bool]
    powers: tuple[float, float] | None
    secured: Fault | None = None
    foreign: tuple[str, ...] = ()

    def fault_of(self, p: Params) -> Fault:
        """Return its fault with the DTC that it has for a message."""
        fault = self.fault if p.secoc is None else self.secured or self.fault
        base = p.lost if self.fault.name == "timeout" else p.invalid
        return replace(fault, dtc=f"{base}-{fault.dtc.rpartition('-')[2]}")


#: All of them. A message is missing or wrong, in one of several ways: what one check sees the others do not, so that
#: their passes clear little. An ECU that fails mostly dies, and all of its messages stop; or a part of them, which its
#: dead half sends. No check sees the bus: while it is cut off only its silence is tested; each controller drops a frame
#: that it damages, before any check; where it loses frames that is told, and counters wait. So it is well wherever a
#: check fails.
KINDS = (
    CheckKind(
        Fault(
            "timeout", "U0100-87", "message missing for longer than its timeout", ("silent [ms]",),
            Debounce(failed_after=1, passed_after=5), tested="silent [ms]",
            remedy="check the sender: powered, awake, its wires to this bus; and that it does send this message",
        ),
        lambda p, _: p.timeout_ms is not None, powers=(0.6, 0.95),
    ),
    CheckKind(
        Fault(
            "counter", "U0401-82", "alive counter jumped (frames lost) or stands still (frame repeated)",
            ("step", "last", "received"), Debounce(failed_after=3, passed_after=50), tested="step of the counter",
            remedy="check the bus for lost frames (gateway doctor, load), the sender for a standstill",
        ),
        lambda _, asked: asked.counter is not None or (asked.freshness is not None and asked.freshness.bits > 0),
        powers=(0.3, 0.1),
        secured=Fault(
            "freshness", "U0401-82",
            "MAC is right, but for a freshness value that was seen or is older: replayed, or the sender began again",
            ("received", "least that is new"), WRONG, tested="freshness value",
            remedy="look who else sends this identifier; where the sender's counter was set back, give another `start`",
        ),
        foreign=("freshness",),
    ),
    CheckKind(
        Fault(
            "crc", "U0401-83", "CRC does not match the payload, or a constant of the header is another",
            ("received", "computed", "constant of the header"), WRONG,
            remedy="check the wires of the bus for disturbances",
        ),
        lambda _, asked: asked.checksum is not None, powers=(0.3, 0.1),
        secured=Fault(
            "mac", "U0401-83",
            "MAC is wrong for every freshness value that the frame may have: forged, or made with another key",
            ("received", "computed"), WRONG,
            remedy="look who else sends this identifier; check whether the sender, or its key, was changed",
        ),
        foreign=("mac",),
    ),
    CheckKind(
        Fault(
            "length", "U0401-81", "frame shorter than its message, or of another length than it may have",
            ("length [byte]",), WRONG, tested="length [byte]",
            remedy="check the sender's software against the database",
        ),
        lambda p, _: p.length is not False, powers=(0.3, 0.1), foreign=("length",),
    ),
    CheckKind(
        Fault(
            "value", "U0401-29", "a floating-point signal is no number, or far outside of its range in the database",
            ("signal's place in the message", "received"), WRONG,
            remedy="check what the sender computes; and the type of the signal in the database",
        ),
        lambda p, _: p.value, powers=(0.3, 0.1),
    ),
    CheckKind(
        Fault(
            "rule", "U0401-56",
            "no frame, or too few, ever passed the CRC or checksum: the configured rule is not the sender's",
            ("frames", "received", "computed", "constant of the header"), AT_ONCE,
            remedy="see the event `protection`, or the log: they name rules that fit; correct [[bus.check]]",
        ),
        lambda _, asked: asked.checksum is not None, powers=None,
        secured=Fault(
            "rule", "U0401-56",
            "no frame ever passed: key, data id, lengths or first freshness value are not the sender's",
            ("frames", "received", "computed", "constant of the header"), AT_ONCE,
            remedy="correct secoc of [[bus.check]]: key, data_id, freshness, start",
        ),
    ),
    CheckKind(EARLY_FAULT, lambda p, _: p.most is not None, powers=(0.1, 0.02), foreign=("early",)),
    CheckKind(
        SECOND_FAULT, lambda p, asked: p.most is not None and asked.counter is not None, powers=(0.01, 0.01),
        foreign=("second_sender",),
    ),
)  # fmt: skip

#: Fault -> its kind.
KIND_OF = {fault.name: kind for kind in KINDS for fault in (kind.fault, kind.secured) if fault is not None}
