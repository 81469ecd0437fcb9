"""Another sender's frames, one attack at a time, put into parts of a healthy drive that nothing was learned from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gateway.bus.frames import Frames
from gateway.config.load import load_config
from gateway.engine.core import Engine
from gateway.engine.events import QUALIFIED_FAILED, STRANGER, Events
from gateway.runtime.assemble import prepare
from gateway_fleet.learn.proof import restore
from gateway_fleet.learn.trial import Seeing
from gateway_replay.injection import Injection, Injector

#: Kinds: of frames beside those of a message; without its frames; of its values, at its own times.
FREQUENCY, SILENT, FORGED = ("unknown", "double", "replay", "fuzz", "forge"), "drop", "offset"
KINDS = (*FREQUENCY, SILENT, FORGED)
#: Length of a part, its time before the attack at most and at least, the attack's own, and that for which the drive
#: goes on after it at least [s]: a slow message's first added frame may be its last, and comes up to a cycle after it.
PART_S, LEAD_S, SETTLED_S, ATTACK_S, AFTER_S = 15.0, 7.0, 5.5, 4.0, 3.5
#: Faults that name another sender.
SENDERS = ("early", "second_sender", "unknown")


@dataclass
class Found:
    """Outcome of the attacks of one kind.

    Attributes:
        tried: attacks.
        found: of these, those that a fault of the message, or a security event, told.
        soon: of these, within a second.
        unwatched: values of which ``gateway learn`` tells that no offset that way is always seen; not among ``tried``.
        after_s: time until it was told [s], of each.
        by: first to tell -> how often.
        accused: faults that do not name another sender -> how often they were set while one was there.
        missed: attacks that were not found within a second, one line each.
    """

    tried: int = 0
    found: int = 0
    soon: int = 0
    unwatched: int = 0
    after_s: list[float] = field(default_factory=list)
    by: Counter[str] = field(default_factory=Counter)
    accused: Counter[str] = field(default_factory=Counter)
    missed: list[str] = field(default_factory=list)

    def add(self, asked: str, set_: dict[str, float], own: tuple[str, ...], *, named: bool) -> None:
        """Take the faults that were set by an attack, and after how long.

        Args:
            asked: the attack, for people.
            set_: fault -> after how long [s].
            own: beginnings of those that tell an attack.
            named: they tell it only where they name another sender.
        """
        self.tried += 1
        right = {name: s for name, s in set_.items() if name.startswith(own)}
        if named:
            right = {name: s for name, s in right.items() if name.rpartition(".")[2] in SENDERS}
            self.accused.update(name.rpartition(".")[2] for name in set_ if name.rpartition(".")[2] not in SENDERS)
        first = min(right, key=lambda name: right[name], default="")
        if not first or right[first] > 1.0:
            self.missed.append(f"{asked}: {f'{first} after {right[first]:.1f} s' if first else 'nothing'}")
        if first:
            self.found += 1
            self.soon += right[first] <= 1.0
            self.after_s.append(right[first])
            self.by[first.rpartition(".")[2]] += 1


class Bench:
    """Puts attacks into parts of a drive.

    Args:
        out: configuration that was learned.
        drives: healthy ones of another seed or time.
        seeing: what learning said of the signals.
        seed: of the attacks.

    Attributes:
        values: message, signal, and its smallest offsets up and down that learning saw at each moment; None: none.
    """

    def __init__(self, out: Path, drives: Sequence[Frames], seeing: Sequence[Seeing], seed: int) -> None:
        self.config = load_config(out)
        self.parts = prepare(self.config, out)
        self._rng, self._seed, self._count = np.random.default_rng(seed), seed, 0
        self._windows: list[Frames] = []
        self._saved: list[Engine] = []
        for frames in drives:
            engine = prepare(self.config, out).engine
            edges = np.arange(int(frames["t_ns"][0]), int(frames["t_ns"][-1]), round(PART_S * 1e9))
            for piece in np.split(frames, np.searchsorted(frames["t_ns"], edges[1:])):
                if piece["t_ns"][-1] - piece["t_ns"][0] > (LEAD_S + ATTACK_S + AFTER_S) * 1e9:
                    self._windows.append(piece)
                    self._saved.append(prepare(self.config, out).engine)
                    restore(self._saved[-1], engine, self.config)
                engine.process(piece, lambda _: None)
        self.limited = [c.params.message for c in self.parts.checks if c.params.most is not None]
        self.timeouts = {c.params.message: c.params.timeout_ms for c in self.parts.checks if c.params.timeout_ms}
        self.values: list[tuple[str, str, tuple[float | None, ...]]] = []
        for each in seeing:
            _, message, signal = each.name.split(".")
            sizes = tuple(size.size if size and size.always else None for size in (each.up, each.down))
            self.values.append((message, signal, sizes))

    def one(self, kind: str, found: Found) -> None:
        """Do one attack at a random time on a random message, and add its outcome."""
        rng, self._count = self._rng, self._count + 1
        at = float(rng.uniform(SETTLED_S, LEAD_S))
        name, value = "", 0.0
        signal: str | None = None
        if kind == "unknown":
            known = {message.frame_id for message in self.parts.databases[0]} | set(self.config.bus[0].health.known)
            name = hex(next(k for k in rng.integers(1, 0x700, 100).tolist() if k not in known))
        elif kind in ("forge", FORGED):
            name, signal, sizes = self.values[int(rng.integers(len(self.values)))]
            down = int(rng.integers(2))
            least = sizes[down]
            value = float((least or 1.0) * rng.uniform(1.0, 2.0) * (-1.0 if down else 1.0))
            if kind == FORGED and least is None:
                found.unwatched += 1
                return
            if kind == "forge" and name not in self.limited:
                return
        else:
            some = list(self.timeouts) if kind == SILENT else self.limited
            name = some[int(rng.integers(len(some)))]
        k = int(rng.integers(len(self._windows)))
        asked = Injection(kind, 0, name, signal, value, at, at + ATTACK_S)
        set_ = self._set(asked, k, at)
        if set_ is None:
            return
        bus = self.config.bus[0].name
        own: tuple[str, ...] = (f"{bus}.unknown",) if kind == "unknown" else (f"{bus}.{name}.",)
        if kind == FORGED:
            own = tuple(
                fault for fault, some in self.parts.depends.items() if any(name in each.component.name for each in some)
            )
        about = f"{name}.{signal} {value:+.4g}" if signal else name
        about += f" of {self.timeouts[name]:g} ms" if kind == SILENT else ""
        found.add(f"{kind} {about} @{at:.2f} of part {k}", set_, own, named=kind in FREQUENCY)

    def _set(self, asked: Injection, k: int, at: float) -> dict[str, float] | None:
        """Return the faults that were set since an attack's first frame -> after how long [s]; None: it had none."""
        engine, window, set_ = self.parts.engine, self._windows[k], dict[str, float]()
        restore(engine, self._saved[k], self.config)
        engine.tables.strangers[:] = 0
        start_ns = int(window["t_ns"][0])
        rng = np.random.default_rng([self._seed, self._count])
        injector = Injector(asked, self.parts.databases, self.parts.checks, rng, start_ns)

        faulty = injector.apply(window)
        onset_ns = _onset_ns(window, faulty)
        if onset_ns is None:
            return None

        def hear(events: Events) -> None:
            for event in events:
                after = (int(event["t_ns"]) - onset_ns) * 1e-9
                if event["kind"] == STRANGER:
                    set_.setdefault(f"{self.config.bus[int(event['bus'])].name}.unknown", after)
                elif event["kind"] == QUALIFIED_FAILED and after >= 0.0:
                    set_.setdefault(engine.faults[int(event["fault"])].id, after)

        engine.process(faulty, hear)
        return set_


def _onset_ns(before: Frames, after: Frames) -> int | None:
    """Return the stamp of the first frame that an attack has added, changed or taken out; None: there is none."""
    count = min(len(before), len(after))
    differ = np.flatnonzero(before[:count] != after[:count])
    if not len(differ):
        longer = before if len(before) > count else after
        return int(longer["t_ns"][count]) if len(longer) > count else None
    at = int(differ[0])
    return int(min(before["t_ns"][at], after["t_ns"][at]))
