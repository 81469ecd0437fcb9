"""Plays a scenario: the frames of all its ECUs, in order of time."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import Frames, empty
from gateway.signals.database import Database
from gateway.signals.protection.default_profile import own_protection
from gateway.signals.protection.params import ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection
from gateway_bench.vecu.contract import EcuParams, Run, Running, Truth
from gateway_bench.vecu.databases import database_of
from gateway_bench.vecu.fault_conditions import Placed, plant_faults, resolved
from gateway_bench.vecu.harness import Harness, Sender
from gateway_bench.vecu.message_faults import MessageFault
from gateway_bench.vecu.overrides import Overrides
from gateway_bench.vecu.registry import VIRTUAL_ECUS
from gateway_bench.vecu.scenario import Scenario
from gateway_bench.vecu.wire_faults import Wire
from gateway_fdi.common.tomlfile import validate
from gateway_fdi.errors import InputError, named, under

#: Steps of a run whose ECUs ignore the buses [ns].
STEP_NS = 10_000_000
#: Longest of a run whose frames come seldom [ns].
LONGEST_STEP_NS = 100_000_000


def _joined(parts: Sequence[Frames]) -> Frames:
    """Return parts as one batch in order of time: a copy."""
    filled = [part for part in parts if len(part)]
    if not filled:
        return empty(0)
    frames = filled[0] if len(filled) == 1 else np.concatenate(filled)
    return frames[np.argsort(frames["t_ns"], kind="stable")]


class _Source:
    """An ECU with its harness.

    Args:
        key: its key path in the scenario.
        ecu: of the scenario.
        sender: messages that it sends.
        harness: puts its faults in.
        run: its settings.
    """

    def __init__(self, key: str, ecu: EcuParams, sender: Sender, harness: Harness, run: Run) -> None:
        self._key = key
        self.ecu, self.sender, self.harness, self.bus = ecu, sender, harness, run.bus
        self.truth: list[Truth] = []
        self.running: Running | None = None
        self.frames, self._taken = empty(0), 0

    def begin(self, faults: Sequence[Placed], run: Run) -> None:
        """Make its frames, or start it.

        Args:
            faults: of plants, with their places in the scenario: its own are taken.
            run: its settings.

        Raises:
            InputError: messages that cannot carry what it sends, ...
        """
        mine = [(k, fault) for k, fault in faults if fault.ecu == self.ecu.name]
        type_, found = VIRTUAL_ECUS[self.ecu.type], [fault for _, fault in mine]
        if type_.begin is not None:
            try:
                self.running = type_.begin(self.ecu, found, run)
            except InputError as error:
                raise _of_scenario(error, [k for k, _ in mine]) from error
            return
        assert type_.frames is not None
        frames, truth = type_.frames(self.ecu, found, run)
        self.truth += truth
        self.frames = frames[np.argsort(frames["t_ns"], kind="stable")]

    @property
    def step_ns(self) -> int:
        """Steps in which it is to be sent [ns]; of one that hears, how often it is to hear."""
        return VIRTUAL_ECUS[self.ecu.type].step_ns if self.running is None else self.running.step_ns

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def end_ns(self) -> int:
        """Until when it has frames that are known [ns]."""
        return int(self.frames["t_ns"][-1]) + 1 if len(self.frames) else 0

    def take(self, end_ns: int, heard: Frames) -> Frames:
        """Return its frames until a time [ns], without faults."""
        if self.running is not None:
            with under(self._key):
                return self.running.step(end_ns, heard[heard["bus"] == self.bus])
        last = int(np.searchsorted(self.frames["t_ns"], end_ns))
        frames, self._taken = self.frames[self._taken : last], last
        return frames


def _of_scenario(error: InputError, places: Sequence[int]) -> InputError:
    """Return a mistake in a fault of an ECU ("faults[2].when") as one of the scenario ("fault[7].when")."""
    found = re.match(r"faults\[(\d+)\](.*)", error.key or "")
    if found is None:
        return error
    key = f"fault[{places[int(found[1])]}]{found[2]}"
    return InputError(error.message, file=error.file, line=error.line, key=key, value=error.value)


class Player:
    """All frames of one run; the same seed gives the same run.

    Args:
        scenario: to play.
        buses: name -> index of the buses.
        seed: instead of the scenario's.
        databases: bus index -> database files of the configuration, for ECUs and faults that name messages.
        protections: (bus index, message) -> how the configuration says that it is protected.
        stepwise: signals may be set while it runs (``overrides``).

    Attributes:
        frames: shape (n,) of FRAME, stamped from 0: all of them, unless it goes step by step.
        stepwise: it goes step by step, since its frames depend on frames of the bus, or on set signals: ``take`` has
            the frames.
        seed: that was used.
        step_ns: steps in which the frames are to be sent in real time, the shortest that an ECU asks for [ns].
        loop_ns: longest step that it may be taken in, how often an ECU is to hear [ns].
        overrides: signals that are set while it runs.

    Raises:
        InputError: an ECU names a bus that is not there, or messages that cannot carry what it sends; a fault of what
            is not sent.
    """

    def __init__(
        self,
        scenario: Scenario,
        buses: Mapping[str, int],
        *,
        seed: int | None = None,
        databases: Mapping[int, Sequence[Path]] | None = None,
        protections: Mapping[tuple[int, str], ProtectionParams] | None = None,
        stepwise: bool = False,
    ) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self._files, self._protections = databases or {}, protections or {}
        faults, waiting = plant_faults(scenario)
        self._sources = [self._source(k, ecu, buses, faults) for k, ecu in enumerate(scenario.ecu)]
        if waiting:
            self._wait_no_longer(faults, waiting, buses)
        self.step_ns = min(source.step_ns for source in self._sources)
        self.loop_ns = min((s.step_ns for s in self._sources if s.running is not None), default=STEP_NS)
        by_name = any(fault.message != "*" for fault in scenario.wire)
        known = {bus: database_of(files) for bus, files in self._files.items() if by_name}
        self._wire = Wire(scenario.wire, np.random.default_rng([self.seed, 1 << 20]), known, buses)
        self._now_ns = 0
        self._find_conditions()
        self._hears = any(source.running is not None for source in self._sources)
        self.stepwise = stepwise or self._hears or bool(self._conditions)
        self._heard, self._sent, self._late = empty(0), empty(0), empty(0)
        self.overrides = Overrides([source.sender for source in self._sources], buses)
        self.frames = empty(0) if self.stepwise else self._all()

    def _wait_no_longer(self, faults: Sequence[Placed], waiting: Sequence[Placed], buses: Mapping[str, int]) -> None:
        """Make those again that have faults by a condition: its signals are known now."""
        of = {source.ecu.name: source.bus for source in self._sources}
        known = {bus: database_of(self._files.get(bus, ())) for bus in {of[fault.ecu] for _, fault in waiting}}
        frames = _joined([source.frames for source in self._sources])
        every = [*faults, *resolved(waiting, of, frames, known)]
        for k, ecu in enumerate(self.scenario.ecu):
            if any(fault.ecu == ecu.name for _, fault in waiting):
                self._sources[k] = self._source(k, ecu, buses, every)

    def _find_conditions(self) -> None:
        self._conditions = [condition for source in self._sources for condition in source.harness.conditions]

    def inject(self, table: Mapping[str, Any]) -> None:
        """Put in a fault while it runs, as ``[[fault]]`` of a scenario has it; without ``from_s`` from now on.

        Raises:
            InputError, InputErrors: keys that are wrong, a fault of what is not sent.
        """
        names = [source.ecu.name for source in self._sources]
        begin = {} if "from_s" in table else {"from_s": self._now_ns * 1e-9}
        whose = {"ecu": names[0]} if len(names) == 1 else {}
        fault = validate({**whose, **begin, **table}, MessageFault, None, "fault")
        if fault.ecu not in names:
            raise InputError(named("the ECUs are", fault.ecu, names), key="fault.ecu", value=fault.ecu)
        self._sources[names.index(fault.ecu)].harness.add(fault)
        self._find_conditions()

    def heal(self) -> None:
        """End all faults of messages and signals, those of the scenario, too."""
        for source in self._sources:
            source.harness.end(self._now_ns)

    def _all(self) -> Frames:
        """Return all frames, those that come at the end or late, too."""
        end = max(round(self.scenario.duration_s * 1e9), *(source.end_ns for source in self._sources))
        return _joined([self.take(end), self._late])

    def _source(self, k: int, ecu: EcuParams, buses: Mapping[str, int], faults: Sequence[Placed]) -> _Source:
        """Return an ECU of the scenario.

        Raises:
            InputError: it names a bus that is not there, messages that cannot carry what it sends, ...
        """
        if ecu.bus is None and len(buses) == 1:
            bus = next(iter(buses.values()))
        elif ecu.bus is not None and ecu.bus in buses:
            bus = buses[ecu.bus]
        else:
            raise InputError(f"the buses are {', '.join(buses)}", key=f"ecu[{k}].bus", value=ecu.bus or "")
        files = self._files.get(bus, ())
        ecu = ecu.with_protections({name: asked for (of, name), asked in self._protections.items() if of == bus})
        of_messages = [
            (place, fault)
            for place, fault in enumerate(self.scenario.fault)
            if fault.ecu == ecu.name and isinstance(fault, MessageFault)
        ]
        truth: list[Truth] = []
        rng = np.random.default_rng([self.seed, k])
        run = Run(self.scenario.duration_s, bus, rng, files, truth.append)
        type_ = VIRTUAL_ECUS[ecu.type]
        try:
            sends = None if type_.sends is None else partial(type_.sends, ecu, files)
            sender = Sender(bus, files, sends, partial(self._known, bus))
            harness = Harness(of_messages, sender, np.random.default_rng([self.seed, k, 1]))
            source = _Source(f"ecu[{k}]", ecu, sender, harness, run)
            source.truth = truth
            source.begin(faults, run)
        except InputError as error:
            of_scenario = error.key is None or error.key.startswith("fault[")
            with under("" if of_scenario else f"ecu[{k}]"):
                raise
        return source

    def _known(self, bus: int, database: Database, name: str) -> Protection:
        """Return what is known of the protection of a message whose ECU does not say it."""
        message = database.message(name)
        asked = self._protections.get((bus, name))
        return own_protection(message) if asked is None else protection_for(message, asked)

    @property
    def count(self) -> int:
        """Number of frames that are known now."""
        return sum(len(source) for source in self._sources) if self.stepwise else len(self.frames)

    @property
    def truth(self) -> list[Truth]:
        """Injected faults; of a run step by step: so far."""
        found = [fact for source in self._sources for fact in (*source.truth, *source.harness.truth)]
        return [*found, *self._wire.truth]

    @property
    def listens(self) -> bool:
        """Whether what is on the buses matters to it."""
        return self._hears or bool(self._conditions)

    def hear(self, frames: Frames) -> None:
        """Take frames of others on the buses, stamped from the scenario's time 0."""
        if self.listens:
            self._heard = _joined([self._heard, frames])

    def take(self, end_ns: int) -> Frames:
        """Return the frames from where the last call ended until a time [ns]."""
        others, self._heard = self._heard, empty(0)
        heard = _joined([self._sent, others])
        parts = [source.take(end_ns, heard) for source in self._sources]
        parts = [self.overrides.apply(part) for part in parts]
        if self._conditions:
            every = _joined([others, *parts])
            for condition in self._conditions:
                condition.take(every)
        parts = [source.harness.apply(part, end_ns) for source, part in zip(self._sources, parts, strict=True)]
        frames = _joined(parts)
        frames["t_ns"] = np.maximum(frames["t_ns"], 1)  # a bus stamps what has no stamp: 0
        for source in self._sources:
            frames = frames[~source.harness.starved(frames)]
        frames = _joined([self._late, self._wire.apply(frames, end_ns)])
        late = frames["t_ns"] >= end_ns
        frames, self._late, self._now_ns = frames[~late], frames[late], end_ns
        self._sent = frames.copy() if self._hears else empty(0)
        return frames

    @property
    def usual_ns(self) -> int:
        """Length of a step that is short beside the times between frames [ns]: hours of slow plants are played soon."""
        if self.stepwise:
            return STEP_NS
        times = len(np.unique(self.frames["t_ns"]))
        between_ns = round(self.scenario.duration_s * 1e9) // max(times, 1)
        return min(max(between_ns // 5, STEP_NS), LONGEST_STEP_NS)

    def batches(self, step_ns: int | None = None, *, start_ns: int = 0) -> Iterator[tuple[int, Frames]]:
        """Yield (end of the step [ns], its frames), the time from ``start_ns`` on, empty steps too.

        Args:
            step_ns: length of a step, never longer than how often an ECU is to hear; default: 10 ms, or longer where
                frames come less often (:attr:`usual_ns`).
            start_ns: added to every time stamp.
        """
        step_ns = self.usual_ns if step_ns is None else step_ns
        step_ns = min(step_ns, self.loop_ns) if self.stepwise else step_ns
        end = round(self.scenario.duration_s * 1e9)
        first = 0
        for until in range(step_ns, end + step_ns, step_ns):
            if self.stepwise:
                frames = self.take(until)
                # Answers within a step that is over come at its end: a bus has no past.
                frames["t_ns"] = np.maximum(frames["t_ns"], until - step_ns)
            else:
                last = int(np.searchsorted(self.frames["t_ns"], until))
                frames, first = self.frames[first:last].copy(), last
            frames["t_ns"] += start_ns
            yield start_ns + until, frames

    def close(self) -> None:
        """End the ECUs that run; more than once does no harm."""
        for source in self._sources:
            if source.running is not None:
                source.running.close()


class TruthReader:
    """Injected faults, as they come: each fact once to each reader."""

    def __init__(self, player: Player) -> None:
        self._player = player
        self._told: Counter[tuple[int, str, int]] = Counter()

    def until(self, until_ns: int) -> list[Truth]:
        """Return what was injected until a time [ns] and has not been returned before, in order of time."""
        left = self._told.copy()
        found = []
        for fact in sorted(self._player.truth, key=lambda fact: fact.t_ns):
            name = fact.t_ns, fact.kind, fact.tooth
            if left[name]:
                left[name] -= 1
            elif fact.t_ns <= until_ns:
                found.append(fact)
        self._told.update((fact.t_ns, fact.kind, fact.tooth) for fact in found)
        return found
