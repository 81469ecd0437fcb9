"""Faults between an ECU and the gateway: frames lost, corrupted, late, twice, cut short."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gateway.bus.frames import Frames
from gateway.vecu.pulse_faults import Truth
from gateway.vecu.scenario import WireFault


def apply_wire_faults(
    frames: Frames, faults: Iterable[WireFault], rng: np.random.Generator
) -> tuple[Frames, list[Truth]]:
    """Return the frames as they arrive, in order of time, and what was done to them.

    Args:
        frames: shape (n,) of FRAME, in order of time, stamped from 0.
        faults: in the order they are applied.
        rng: source of all randomness.
    """
    truth: list[Truth] = []
    for fault in faults:
        end = np.inf if fault.to_s is None else fault.to_s * 1e9
        hit = (frames["t_ns"] >= fault.from_s * 1e9) & (frames["t_ns"] < end)
        if fault.can_id is not None:
            hit &= frames["can_id"] == fault.can_id
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
