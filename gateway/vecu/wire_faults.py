"""Faults between an ECU and the gateway: frames lost, corrupted, late, twice, cut short."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from gateway.bus.frames import EXTENDED, ID_MASK, Frames
from gateway.errors import InputError, nearest
from gateway.signals.database import Database
from gateway.vecu.contract import Truth
from gateway.vecu.scenario import WireFault

#: Last identifier of 11 bits; digits that an identifier of 29 bits is written with.
LAST_STANDARD, EXTENDED_DIGITS = 0x7FF, 8
#: Whose frames a fault concerns: identifier (with EXTENDED) and bus index, None for all.
Concerned = tuple[int | None, int | None]


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
            flag = EXTENDED if message.is_extended_frame else 0
            names.setdefault(message.name, (message.frame_id | flag, bus))
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


def apply_wire_faults(
    frames: Frames,
    faults: Iterable[WireFault],
    rng: np.random.Generator,
    databases: Mapping[int, Database] | None = None,
) -> tuple[Frames, list[Truth]]:
    """Return the frames as they arrive, in order of time, and what was done to them.

    Args:
        frames: shape (n,) of FRAME, in order of time, stamped from 0.
        faults: in the order they are applied.
        rng: source of all randomness.
        databases: bus index -> messages that the faults may name.

    Raises:
        InputError: a fault of a message that is none.
    """
    truth: list[Truth] = []
    for place, fault in enumerate(faults):
        can_id, bus = concerned(fault, f"wire[{place}]", databases or {})
        end = np.inf if fault.to_s is None else fault.to_s * 1e9
        hit = (frames["t_ns"] >= fault.from_s * 1e9) & (frames["t_ns"] < end)
        if can_id is not None:
            hit &= frames["can_id"] == can_id
        if bus is not None:
            hit &= frames["bus"] == bus
        hit &= rng.random(len(frames)) < fault.probability
        if not hit.any():
            continue
        truth.append(Truth(int(frames["t_ns"][hit][0]), fault.kind, int(hit.sum())))
        if fault.kind in ("lost", "silent"):
            frames = frames[~hit]
            continue
        frames = frames.copy()
        if fault.kind == "corrupted":
            _corrupt(frames, np.flatnonzero(hit), rng)
        elif fault.kind == "short":
            for k in np.flatnonzero(hit):
                length = int(rng.integers(0, max(int(frames[k]["length"]), 1)))
                frames[k]["length"] = length
                frames[k]["data"][length:] = 0
        elif fault.kind == "late":
            frames["t_ns"][hit] += round(fault.delay_ms * 1e6)
        else:
            again = frames[hit]
            again["t_ns"] += 300_000
            frames = np.concatenate([frames, again])
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    return frames, truth


def _corrupt(frames: Frames, places: np.ndarray, rng: np.random.Generator) -> None:
    """Flip one to three bits of each payload."""
    for k in places:
        bits = 8 * int(frames[k]["length"])
        if bits:
            chosen = rng.choice(bits, size=min(int(rng.integers(1, 4)), bits), replace=False)
            for bit in chosen:
                frames[k]["data"][bit // 8] ^= 1 << (bit % 8)
