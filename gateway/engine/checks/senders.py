"""Senders of a message: how often it may come, and whether its alive counter runs once.

A limit on a single gap would accuse healthy senders: their frames queue, so that two come at once. Over a window it
does not. Of two senders of one identifier nobody knows whose values are true: none are used, and no other check of the
message accuses anyone meanwhile.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from gateway.monitors.contract import Debounce, Fault
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.jit import Record, i4, i8, i8s, means, u1

#: Stamps that are kept of a window.
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
    tested="changes between two counts",
)


class Most(StrictModel):
    """Number of frames that a message may come in a window."""

    frames: int = Field(ge=1, le=100_000, description="frames that may come in any such time; more are a fault")
    ms: float = Field(gt=0, le=3.6e6, description="the time [ms]")


class SenderConst(Record):
    """How often a message may come: more than ``stride * slots`` frames in ``most_ns`` are too many."""

    most_ns: i8 = means("window", "ns")
    stride: i4 = means("each such frame's stamp is kept; 0: its rate is not watched")
    slots: i4 = means("stamps that are kept, KEPT at most")
    apart_ns: i8 = means("mean gap at the limit: of two gaps around a second sender's frame one is shorter", "ns")


class SenderState(Record):
    """State of the checks of a message's senders."""

    last_ns: i8 = means("when its checksum was last tested", "ns")
    blamed: u1 = means("1: the last frame's checksum was wrong, and counts against its sender")
    before: i4 = means("detection counter of its checksum before that")
    left: i4 = means("frames until the next stamp is kept")
    at: i4 = means("place of the oldest stamp")
    filled: i4 = means("stamps of this window so far")
    stamps: Annotated[i8s, KEPT] = means("of frames", "ns")
    wraps: i4 = means("windows that passed")
    crowded: u1 = means("1: in the last window came too many")
    other_counter: i8 = means("alive counter of the count that the last frame did not go on")
    other_seen: u1 = means("1: there is another count")
    odd: i4 = means("frames for which one that did not go on the count is remembered")
    twice: i4 = means("what speaks for two counts that go on")


def fill(row: Any, most: Most | None) -> None:
    """Fill the limit of a message; from 9 frames on the window is that of the next multiple, at the same rate."""
    if most is None:
        return
    stride = -(-most.frames // KEPT)
    slots = -(-most.frames // stride)
    row["stride"], row["slots"], row["left"] = stride, slots, 1
    row["apart_ns"] = round(most.ms * 1e6 / most.frames)
    row["most_ns"] = round(most.ms * 1e6 * stride * slots / most.frames)
