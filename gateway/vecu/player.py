"""Plays a scenario: the frames of all its ECUs, in order of time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from gateway.bus.frames import Frames, empty
from gateway.errors import InputError
from gateway.signals.database import load_database
from gateway.vecu.contract import Run, Truth
from gateway.vecu.registry import VIRTUAL_ECUS
from gateway.vecu.scenario import Scenario
from gateway.vecu.wire_faults import apply_wire_faults


class Player:
    """All frames of one run; the same seed gives the same run.

    Args:
        scenario: what happens.
        buses: name -> index of the buses.
        seed: instead of the scenario's.
        databases: bus index -> database files of the configuration, for ECUs and wire faults that name messages.

    Attributes:
        frames: shape (n,) of FRAME, stamped from 0.
        truth: what was injected.
        seed: that was used.
        step_ns: steps in which the frames are to be sent in real time, the shortest that an ECU asks for [ns].

    Raises:
        InputError: an ECU names a bus that is not there, or messages that cannot carry what it sends.
    """

    def __init__(
        self,
        scenario: Scenario,
        buses: Mapping[str, int],
        *,
        seed: int | None = None,
        databases: Mapping[int, Sequence[Path]] | None = None,
    ) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self.truth: list[Truth] = []
        self.step_ns = min(VIRTUAL_ECUS[ecu.type].step_ns for ecu in scenario.ecu)
        runs = [empty(0)]
        for k, ecu in enumerate(scenario.ecu):
            if ecu.bus is None and len(buses) == 1:
                bus = next(iter(buses.values()))
            elif ecu.bus is not None and ecu.bus in buses:
                bus = buses[ecu.bus]
            else:
                raise InputError(f"the buses are {', '.join(buses)}", key=f"ecu[{k}].bus", value=ecu.bus or "")
            mine = [fault for fault in scenario.fault if fault.ecu == ecu.name]
            rng = np.random.default_rng([self.seed, k])
            run = Run(scenario.duration_s, bus, rng, (databases or {}).get(bus, ()))
            try:
                frames, truth = VIRTUAL_ECUS[ecu.type].frames(ecu, mine, run)
            except InputError as error:
                if error.key is None:
                    raise
                key = f"ecu[{k}].{error.key}"
                raise InputError(error.message, file=error.file, line=error.line, key=key, value=error.value) from error
            runs.append(frames)
            self.truth += truth
        frames = np.concatenate(runs)
        frames["t_ns"] = np.maximum(frames["t_ns"], 1)  # a bus stamps what has no stamp: 0
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        rng = np.random.default_rng([self.seed, 1 << 20])
        named = any(fault.message != "*" for fault in scenario.wire)
        known = {bus: load_database(files) for bus, files in (databases or {}).items() if named}
        self.frames, done = apply_wire_faults(frames, scenario.wire, rng, known)
        self.truth += done

    def batches(self, step_ns: int = 10_000_000, *, start_ns: int = 0) -> Iterator[tuple[int, Frames]]:
        """Yield (end of the step [ns], its frames), the time from ``start_ns`` on, empty steps too.

        Args:
            step_ns: length of a step.
            start_ns: added to every time stamp.
        """
        end = round(self.scenario.duration_s * 1e9)
        frames = self.frames.copy()
        frames["t_ns"] += start_ns
        first = 0
        for until in range(step_ns, end + step_ns, step_ns):
            last = int(np.searchsorted(self.frames["t_ns"], until))
            yield start_ns + until, frames[first:last]
            first = last
