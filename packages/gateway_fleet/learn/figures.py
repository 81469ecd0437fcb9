"""Figures that mean something: everyday faults put into what was held back, and what the learned limits tell of them.

A fault is put in whether or not anything watches for it (:mod:`gateway_fleet.learn.everyday`); what is silent counts.
An unknown identifier and a bus that is away are told as events, by no limit that is learned: they are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gateway.bus.frames import Frames
from gateway.engine.core import Engine
from gateway.engine.events import QUALIFIED_FAILED, Events
from gateway_fleet.learn.everyday import AWAY, KINDS, UNKNOWN, Drive, Fault
from gateway_fleet.learn.proof import Replayed, restore

#: Faults of each kind at most; frames that a window has at least.
ROUNDS, LEAST = 3, 100


@dataclass(frozen=True)
class Everyday:
    """An everyday fault, and what was told of it.

    Attributes:
        kind: of it.
        about: where it is, and its size.
        codes: faults that were set, the first one first.
        named: one of them sees what is wrong.
        accused: one of them sees nothing of what is wrong.
    """

    kind: str
    about: str
    codes: tuple[str, ...]
    named: bool
    accused: bool


def codes_of(proof: Replayed, saved: Engine, frames: Frames) -> dict[str, float]:
    """Return the faults that frames set after a state of the engine -> when, from the first frame [s]."""
    engine, found = proof.parts.engine, dict[str, float]()
    restore(engine, saved, proof.config)
    start_ns, end_ns = int(frames["t_ns"][0]), int(frames["t_ns"].max())

    def hear(events: Events) -> None:
        for event in events[events["kind"] == QUALIFIED_FAILED]:
            fault = engine.faults[int(event["fault"])].id
            found.setdefault(fault, float(int(event["t_ns"]) - start_ns) * 1e-9)

    engine.process(frames, hear)
    engine.advance(end_ns, hear)
    return found


def everyday(proof: Replayed, seed: int, progress: Callable[[int, int], None]) -> list[Everyday]:
    """Put faults of each kind into what was held back; returns what came of each that has a place there."""
    sees = {fault: {one.component.name for one in some} for fault, some in proof.parts.depends.items()}
    found, windows = list[Everyday](), [k for k, each in enumerate(proof.windows) if len(each) >= LEAST]
    rng = np.random.default_rng([seed, len(windows)])
    drives = {k: Drive(proof.config, proof.parts, proof.windows[k], rng) for k in windows[:ROUNDS]}
    for number in range(ROUNDS if windows else 0):
        k = windows[number % len(windows)]
        if k not in drives:
            continue
        for done, (kind, make) in enumerate(KINDS.items()):
            fault = make(drives[k]) if kind not in (AWAY, UNKNOWN) else None
            if fault is not None and len(fault.frames):
                found.append(_everyday(kind, fault, codes_of(proof, proof.before[k], fault.frames), sees))
            progress(number * len(KINDS) + done + 1, ROUNDS * len(KINDS))
    return found


def _everyday(kind: str, fault: Fault, codes: dict[str, float], sees: dict[str, set[str]]) -> Everyday:
    """Return what codes say of a fault."""
    named = any(sees.get(code, set()) & fault.right for code in codes)
    accused = any(sees.get(code) and not sees[code] & fault.concerned for code in codes)
    return Everyday(kind, fault.about, tuple(sorted(codes, key=lambda code: codes[code])), named, accused)


def by_kind(faults: Sequence[Everyday]) -> dict[str, tuple[int, int, int, int]]:
    """Return kind -> faults, those found, those of them that a code names, and those that were silent."""
    rows = {}
    for kind in dict.fromkeys(one.kind for one in faults):
        mine = [one for one in faults if one.kind == kind]
        told = sum(bool(one.codes) for one in mine)
        rows[kind] = len(mine), told, sum(one.named for one in mine), len(mine) - told
    return rows
