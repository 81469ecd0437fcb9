"""Pulse trains into the frames of dbc/crank/crank.dbc: what an ECU, or a logger, would send."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.signals.frame_encoding import frames_of, merged
from gateway_bench.vecu.databases import message_of
from gateway_plants.crank.tooth_codec import encode_intervals

Format = Literal["classic", "fd"]
DATABASE = "dbc/crank.dbc"

#: A frame that is not full leaves so long after its first interval began [ns].
FLUSH_NS = 20_000_000
#: At the latest so long after the last frame another one leaves, empty if need be [ns]: an engine that stands
#: must not look like an ECU that is dead.
ALIVE_NS = 100_000_000
#: Time on the wire: 8 bytes at 500 kbit/s with typical stuffing; 64 bytes FD at 500 kbit/s / 2 Mbit/s.
WIRE_NS = {"classic": 242_000, "fd": 354_000}
#: Longest shift of CTW_FD27's intervals [bits]: 0.5 us << 7 in 16 bits are 4.19 s.
MOST_SHIFT = 7
#: Pulses between two CTW_BASE frames.
BASE_EVERY = 58


@dataclass(frozen=True)
class _Group:
    """Intervals ``first .. last - 1`` of a train, sent together at a time."""

    first: int
    last: int
    t_ns: int


def _groups(times_ns: NDArray[np.int64], most: int) -> list[_Group]:
    """Divide the intervals of a train among frames: full ones, and those that waited too long."""
    groups = []
    first = 0
    intervals = len(times_ns) - 1
    while first < intervals:
        last = min(first + most, intervals)
        limit = int(times_ns[first + 1]) + FLUSH_NS
        waited = int(np.searchsorted(times_ns, limit, side="right")) - 1
        if waited < last:
            last = max(waited, first + 1)
            groups.append(_Group(first, last, limit))
        else:
            groups.append(_Group(first, last, int(times_ns[last])))
        first = last
    return groups


def _with_alive(groups: list[_Group], span_ns: tuple[int, int]) -> list[_Group]:
    """Fill silences with empty groups."""
    filled: list[_Group] = []
    last_ns, place = span_ns[0], 0
    for group in [*groups, _Group(-1, -1, span_ns[1])]:
        while group.t_ns - last_ns > ALIVE_NS:
            last_ns += ALIVE_NS
            filled.append(_Group(place, place, last_ns))
        if group.first >= 0:
            filled.append(group)
            last_ns, place = group.t_ns, group.last
    return filled


def tooth_frames(
    times_ns: NDArray[np.int64],
    form: Format,
    *,
    bus: int = 0,
    span_ns: tuple[int, int] | None = None,
    wire_ns: int | None = None,
) -> Frames:
    """Return the frames that carry a pulse train.

    Args:
        times_ns: shape (n,), pulse times, rising [ns].
        form: classic (CTW_PT4 and CTW_BASE) or fd (CTW_FD27).
        bus: index of the bus.
        span_ns: when the sender was switched on and off [ns]; default: first to last pulse.
        wire_ns: from the last pulse to the frame's time stamp [ns].
    """
    if span_ns is None:
        if len(times_ns) < 2:
            return empty(0)
        span_ns = int(times_ns[0]), int(times_ns[-1])
    delay = WIRE_NS[form] if wire_ns is None else wire_ns
    most = 4 if form == "classic" else 27
    groups = _with_alive(_groups(times_ns, most), span_ns)
    if form == "classic":
        return _classic(times_ns, groups, bus, delay)
    return _fd(times_ns, groups, bus, delay)


def _classic(times_ns: NDArray[np.int64], groups: list[_Group], bus: int, delay: int) -> Frames:
    codes = np.zeros(max(len(times_ns) - 1, 0), np.int64)
    if len(codes):
        encode_intervals(times_ns / 1e3, codes)
    inside = np.zeros((len(groups), 4), np.int64)
    for number, group in enumerate(groups):
        inside[number, : group.last - group.first] = codes[group.first : group.last]
    stamps = np.array([group.t_ns + delay for group in groups], np.int64)
    values = {"FrameCnt": np.arange(len(groups)) % 256, **{f"Pt{k}": inside[:, k] for k in range(4)}}
    teeth = frames_of(message_of(DATABASE, "CTW_PT4"), values, stamps, bus=bus)
    # A CTW_BASE follows the first frame behind each BASE_EVERY pulses.
    last = np.array([group.last for group in groups], np.int64)
    after = np.flatnonzero(np.diff(last // BASE_EVERY, prepend=0) > 0)
    values = {
        "FrameCnt": np.arange(len(after)) % 16,
        "TeethCnt": after % 16,
        "PulseCnt": last[after] % 65536,
        "BaseTime": times_ns[last[after]] // 1000 % 2**32,
    }
    base = frames_of(message_of(DATABASE, "CTW_BASE"), values, stamps[after] + delay, bus=bus)
    return merged(teeth, base)


def _fd(times_ns: NDArray[np.int64], groups: list[_Group], bus: int, delay: int) -> Frames:
    half_us = times_ns // 500
    inside = np.zeros((len(groups), 27))
    shifts = np.zeros(len(groups), np.int64)
    for number, group in enumerate(groups):
        span = np.diff(half_us[group.first : group.last + 1])
        shift = shifts[number] = min(max(0, int(span.max(initial=0)).bit_length() - 16), MOST_SHIFT)
        # Differences to what the receiver decodes, so that rounding does not add up.
        ends = np.rint(np.cumsum(span) / (1 << shift)).astype(np.int64)
        inside[number, : len(ends)] = np.minimum(np.diff(ends, prepend=0), 0xFFFF) * 0.5
    first, last, stamps = (np.array([getattr(g, name) for g in groups], np.int64) for name in ("first", "last", "t_ns"))
    values = {f"Pt{k}": inside[:, k] for k in range(27)} | {
        "FrameCnt": np.arange(len(groups)) % 256,
        "PulseCnt": first % 65536,
        "BaseTime": half_us[first] % 2**32 * 0.5 if len(half_us) else np.zeros(len(groups)),
        "NValid": last - first,
        "Shift": shifts,
    }
    return frames_of(message_of(DATABASE, "CTW_FD27"), values, stamps + delay, bus=bus)


def cam_frames(
    times_ns: NDArray[np.int64],
    edges_ns: NDArray[np.int64],
    levels: NDArray[np.int64],
    *,
    bus: int = 0,
) -> Frames:
    """Return a CTW_CAM for each edge of a cam sensor.

    Args:
        times_ns: shape (n,), pulse times of the crank as sent, rising [ns].
        edges_ns: shape (m,), times of the edges, rising [ns].
        levels: shape (m,), level after each.
        bus: index of the bus.
    """
    places = np.searchsorted(times_ns, edges_ns, side="right") - 1
    known = places >= 0
    places, edges_ns = places[known], edges_ns[known]
    values = {
        "FrameCnt": np.arange(len(places)) % 16,
        "Level": levels[known],
        "PulseCnt": places % 65536,
        "Delay": (edges_ns - times_ns[places]) // 1000,
    }
    return frames_of(message_of(DATABASE, "CTW_CAM"), values, edges_ns + WIRE_NS["classic"], bus=bus)
