"""Senders of a message: its rate, and whether its alive counter runs once.

A limit on a single gap would accuse healthy senders: frames queue, and two come at once. A limit on the frames of a
window does not. Slow messages are often sent each cycle, and at once where their content changes: of these only frames
that repeat the content before are counted. Of two senders of one identifier nobody knows whose values are true. Then no
values are used, and no other check of the message accuses its sender.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from gateway.monitors.contract import Debounce, Fault
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.jit import Record, i4, i8, i8s, means, u1, u8s

#: Most stamps that are kept of a window.
KEPT = 8

EARLY_FAULT = Fault(
    "early",
    "U0401-37",
    "message comes more often than its limit: another sender beside its own, a repeated one, or a wrong cycle",
    ("frames", "in [ms]"),
    Debounce(failed_after=1, passed_after=3),
    remedy="check which ECU sends it, and whether one was added, exchanged or updated; or give `most` room",
    tested="frames in the window",
)
SECOND_FAULT = Fault(
    "second_sender",
    "U0401-62",
    "the alive counter runs twice: two senders have one identifier",
    ("counter of one", "counter of the other"),
    Debounce(failed_after=1, passed_after=3),
    remedy="find the second sender: unplug what was added to the bus, ECU after ECU",
    tested="evidence of a second count [bit]",
)


class Most(StrictModel):
    """Most frames of a message in a window."""

    frames: int = Field(ge=1, le=100_000, description="frames that may come in any such window; more are a fault")
    ms: float = Field(gt=0, le=3.6e6, description="the window [ms]")
    cycle_ms: float | None = Field(
        None,
        gt=0,
        le=3.6e6,
        description="cycle of the sender [ms]: while fewer frames come than one sends, nothing speaks of a second one",
    )
    repeats: bool = Field(
        False,
        description="count only frames that repeat the content before: a sender may send at once when it changes",
    )


class SenderConst(Record):
    """Limit of a message's rate: ``stride * slots`` frames in ``most_ns``."""

    most_ns: i8 = means("window", "ns")
    stride: i4 = means("one stamp is kept of so many frames; 0: the rate is not watched")
    slots: i4 = means("stamps that are kept, at most KEPT")
    one_ns: i8 = means("time of as many frames of one sender; 0: not known", "ns")
    repeats: u1 = means("1: only frames that repeat the content before are counted")
    apart_ns: i8 = means("mean gap at the limit; of the two gaps around a second sender's frame one is shorter", "ns")


class SenderState(Record):
    """State of these checks of one message."""

    last_ns: i8 = means("when a checksum was last tested", "ns")
    blamed: u1 = means("1: the last checksum was wrong, and counts against the sender")
    before: i4 = means("detection counter of the checksum before that")
    left: i4 = means("frames until the next stamp is kept")
    at: i4 = means("place of the oldest stamp")
    filled: i4 = means("stamps that are kept so far")
    stamps: Annotated[i8s, KEPT] = means("the stamps", "ns")
    content: Annotated[u8s, 8] = means("payload of the last frame, where repeats are counted")
    wraps: i4 = means("windows that passed")
    crowded: u1 = means("1: the last window had too many frames")
    other_counter: i8 = means("last value of the other count: the last frame did not continue it")
    other_seen: u1 = means("1: there is another count")
    odd: i4 = means("frames for which the other count is still remembered")
    twice: i4 = means("evidence of two counts; TWO is enough", "bit")


def fill(row: Any, most: Most | None) -> None:
    """Fill the limit of a message. More than KEPT frames are rounded up to a multiple; the rate stays."""
    if most is None:
        return
    stride = -(-most.frames // KEPT)
    slots = -(-most.frames // stride)
    row["stride"], row["slots"], row["left"] = stride, slots, 1
    row["apart_ns"] = round(most.ms * 1e6 / most.frames)
    row["most_ns"] = round(most.ms * 1e6 * stride * slots / most.frames)
    row["one_ns"] = round((most.cycle_ms or 0) * 1e6 * stride * slots)
    row["repeats"] = most.repeats
