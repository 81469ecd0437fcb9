"""Faults between an ECU and the gateway: frames lost, corrupted, late, twice, cut short; the gateway's bus off."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gateway.bus.conditions import BUS_OFF, RESTARTED
from gateway.bus.frames import ERROR, EXTENDED, ID_MASK, Frames, empty, put
from gateway.signals.database import Database
from gateway.signals.keys import can_id_of
from gateway_bench.vecu.contract import Truth
from gateway_bench.vecu.scenario import WireFault
from gateway_fdi.errors import InputError, named, nearest

#: Last identifier of 11 bits; digits that an identifier of 29 bits is written with.
LAST_STANDARD, EXTENDED_DIGITS = 0x7FF, 8
#: Whose frames a fault concerns: identifier (with EXTENDED) and bus index, None for all.
Concerned = tuple[int | None, int | None]
#: Kinds of faults of frames.
WireKind = Literal["lost", "corrupted", "late", "duplicated", "short", "silent"]


def concerned(fault: WireFault, key: str, databases: Mapping[int, Database]) -> Concerned:
    """Return whose frames a fault concerns. A name goes before an identifier that is spelt like it ("ACC").

    Args:
        fault: with its ``message``.
        key: its key path in the scenario.
        databases: bus index -> messages that can be named.

    Raises:
        InputError: neither a message nor an identifier.
    """
    text = fault.message
    if text == "*":
        return None, None
    names: dict[str, Concerned] = {}
    for bus, database in databases.items():
        for message in database:
            names.setdefault(message.name, (can_id_of(message), bus))
    if text in names:
        return names[text]
    digits = text.lower().removeprefix("0x")
    try:
        can_id = int(digits, 16)
    except ValueError:
        can_id = -1
    if not 0 <= can_id <= ID_MASK:
        raise InputError(
            f"a message of the configuration, an identifier in hex (0x700), or *{nearest(text, names)}",
            key=f"{key}.message",
            value=text,
        )
    return can_id | (EXTENDED if can_id > LAST_STANDARD or len(digits) == EXTENDED_DIGITS else 0), None


class Wire:
    """The way from the ECUs to the gateway, with faults; frames come in chunks, in order of time.

    Args:
        faults: in the order they are applied.
        rng: source of all randomness.
        databases: bus index -> messages that the faults may name.
        buses: name -> index of the buses.

    Raises:
        InputError: a fault of a message or bus that is none.
    """

    def __init__(
        self,
        faults: Iterable[WireFault],
        rng: np.random.Generator,
        databases: Mapping[int, Database],
        buses: Mapping[str, int],
    ) -> None:
        self._rng = rng
        self._faults = [
            (fault, *_concerned(fault, f"wire[{place}]", databases, buses)) for place, fault in enumerate(faults)
        ]
        self._done: dict[int, Truth] = {}
        self._told: set[tuple[int, bool]] = set()

    @property
    def truth(self) -> list[Truth]:
        """Frames changed so far, fault by fault."""
        return [self._done[place] for place in sorted(self._done)]

    def apply(self, frames: Frames, end_ns: int) -> Frames:
        """Return the frames of a chunk as they arrive, in order of time; late ones may lie after its end [ns]."""
        for place, (fault, can_id, bus) in enumerate(self._faults):
            end = np.inf if fault.to_s is None else fault.to_s * 1e9
            hit = (frames["t_ns"] >= fault.from_s * 1e9) & (frames["t_ns"] < end)
            if can_id is not None:
                hit &= frames["can_id"] == can_id
            if bus is not None:
                hit &= frames["bus"] == bus
            hit &= self._rng.random(len(frames)) < fault.probability
            if hit.any():
                first, count = int(frames["t_ns"][hit][0]), int(hit.sum())
                before = self._done.get(place, Truth(first, fault.kind, 0))
                self._done[place] = Truth(before.t_ns, fault.kind, before.count + count)
            if fault.kind != "bus_off":
                frames = disturbed(fault.kind, frames, hit, fault.delay_ms, self._rng)
                continue
            frames = np.concatenate([frames[~hit], *self._controller(place, fault, bus or 0, end_ns)])
            frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        return frames

    def _controller(self, place: int, fault: WireFault, bus: int, end_ns: int) -> Iterator[Frames]:
        """Yield what the gateway's controller says of a bus that it is off, and on again."""
        for begins, t_s, classes in ((True, fault.from_s, BUS_OFF), (False, fault.to_s, RESTARTED)):
            if t_s is None or round(t_s * 1e9) >= end_ns or (place, begins) in self._told:
                continue
            self._told.add((place, begins))
            said = empty(1)
            put(said, 0, max(round(t_s * 1e9), 1), ERROR | classes, bytes(8), bus=bus)
            yield said


def _concerned(fault: WireFault, key: str, databases: Mapping[int, Database], buses: Mapping[str, int]) -> Concerned:
    """Return whose frames a fault concerns, its bus by name too.

    Raises:
        InputError: a message or bus that is none.
    """
    can_id, bus = concerned(fault, key, databases)
    if fault.bus is None:
        if fault.kind == "bus_off" and len(buses) > 1:
            raise InputError(f"which one? The buses are {', '.join(buses)}", key=f"{key}.bus")
        return can_id, bus
    if fault.bus not in buses:
        raise InputError(named("the buses are", fault.bus, buses), key=f"{key}.bus", value=fault.bus)
    return can_id, buses[fault.bus]


def disturbed(
    kind: WireKind, frames: Frames, hit: NDArray[np.bool_], delay_ms: float, rng: np.random.Generator
) -> Frames:
    """Return frames of which some are lost, corrupted, late, there twice, cut short.

    Args:
        kind: which of these.
        frames: in order of time.
        hit: which are concerned, shape (n,).
        delay_ms: of late ones [ms].
        rng: source of all randomness.
    """
    if not hit.any():
        return frames
    if kind in ("lost", "silent"):
        return frames[~hit]
    frames = frames.copy()
    if kind == "corrupted":
        _corrupt(frames, np.flatnonzero(hit), rng)
    elif kind == "short":
        for k in np.flatnonzero(hit):
            length = int(rng.integers(0, max(int(frames[k]["length"]), 1)))
            frames[k]["length"] = length
            frames[k]["data"][length:] = 0
    elif kind == "late":
        frames["t_ns"][hit] += round(delay_ms * 1e6)
    else:
        again = frames[hit]
        again["t_ns"] += 300_000
        frames = np.concatenate([frames, again])
    return frames[np.argsort(frames["t_ns"], kind="stable")]


def _corrupt(frames: Frames, places: np.ndarray, rng: np.random.Generator) -> None:
    """Flip one to three bits of each payload."""
    for k in places:
        bits = 8 * int(frames[k]["length"])
        if bits:
            chosen = rng.choice(bits, size=min(int(rng.integers(1, 4)), bits), replace=False)
            for bit in chosen:
                frames[k]["data"][bit // 8] ^= 1 << (bit % 8)
