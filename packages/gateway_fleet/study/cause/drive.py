"""One run: frames of a plant with faults, and the diagnoses that the gateway tells of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import Frames
from gateway.bus.logs import LogReader
from gateway.common.calls import CALLS
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway.runtime.diagnosis import DIAGNOSIS
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import Scenario, located
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError
from gateway_fleet.study.cause.cases import read
from gateway_replay.injection import Injector, parse_injection

#: Keys of an ECU that are no faults of a scenario, and put something wrong in as they do.
_WRONG = ("late_voltage",)
#: Frames that are fed at once.
_BATCH = 20_000


@dataclass(frozen=True)
class Told:
    """What was told: each diagnosis with its time [s], of the frames' clock."""

    t_s: float
    groups: tuple[Mapping[str, Any], ...]


def played(base: str, entries: Sequence[Mapping[str, Any]], seconds: float, seed: int) -> tuple[Config, Frames]:
    """Return the frames of a scenario with other faults, and the configuration that looks at them.

    What else its ECUs do wrong at some time is left out.
    """
    path = shipped(f"scenarios/{base}.toml")
    told = read(base)
    ecus = [{key: value for key, value in ecu.items() if key not in _WRONG} for ecu in told["ecu"]]
    data = {**told, "ecu": ecus, "fault": list(entries), "expect": [], "duration_s": seconds}
    scenario = located(Scenario.model_validate(data), path.parent)
    config = load_config(scenario.config)
    return config, player_of(scenario, config, seed=seed).frames


def recorded(log: Path, path: Path, injections: Sequence[str], seed: int) -> tuple[Config, Frames]:
    """Return the frames of a log with faults put in, and the configuration that looks at them."""
    config = load_config(path)
    return config, injected_into(config, _frames(log, config.bus[0].channel), injections, seed, path)


def injected_into(
    config: Config, frames: Frames, injections: Sequence[str], seed: int, path: Path | None = None
) -> Frames:
    """Return frames with faults put in, as --inject has them; ``path``: of the configuration."""
    parts = prepare(config, path)
    names = [bus.name for bus in config.bus]
    for k, text in enumerate(injections):
        asked = parse_injection(text, names, parts.databases)
        frames = Injector(asked, parts.databases, parts.checks, np.random.default_rng([seed, k])).apply(frames)
    return frames


@lru_cache(maxsize=2)
def _frames(log: Path, channel: str) -> Frames:
    return np.concatenate(list(LogReader(log, channels={channel: 0})))


def diagnoses(config: Config, frames: Frames) -> list[Told]:
    """Return the diagnoses of a run."""
    told = [e for e in events_of(config, frames) if e["event"] == "diagnosis"]
    start = int(frames["t_ns"][0])
    return [Told((e["t_ns"] - start) * 1e-9, tuple(e["groups"])) for e in told]


def events_of(config: Config, frames: Frames) -> list[Mapping[str, Any]]:
    """Return the events of a run, for a study that judges what is told of causes.

    Raises:
        InputError: no package finds any, which is not the same as that none is found.
    """
    if DIAGNOSIS not in CALLS:
        raise InputError("no installed package finds causes")
    gateway = Gateway(config)
    events: list[Mapping[str, Any]] = []
    gateway.listen(events.append)
    start, end = int(frames["t_ns"][0]), int(frames["t_ns"][-1])
    gateway.start(start)
    for begin in range(0, len(frames), _BATCH):
        gateway.feed(frames[begin : begin + _BATCH])
    gateway.advance(end)
    gateway.close()
    return events
