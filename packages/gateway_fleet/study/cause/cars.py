"""Two cars whose configurations are learned: one from a real drive, one from the rest bus of a vehicle."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cantools.database.can.signal import Signal

from gateway.bus.logs import open_writer
from gateway.signals.database import Database, load_database
from gateway_checks.rule.text import compile_text
from gateway_fdi.common.resources import shipped
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked, learn, write
from gateway_fleet.learn.ranges import representable
from gateway_fleet.study.cause.cases import Truth
from gateway_fleet.study.cause.drive import played

#: Faults of a car begin and end [s].
BEGIN_S, END_S = 20.0, 32.0
#: What a message's frames show is seen within this time [ms], or not put in.
_SOON_MS = 2000


@dataclass(frozen=True)
class Car:
    """A learned car: its configuration and a drive."""

    name: str
    config: Path
    log: Path


@dataclass(frozen=True)
class Injected:
    """A fault of a car, as --inject has it, without its times.

    Attributes:
        car: whose.
        text: kind, and the message or signal with its value.
        truth: the component that is at fault.
        needs: other signals; while one of them is out of its range, the fault does not show.
    """

    car: Car
    text: str
    truth: Truth
    needs: frozenset[str] = frozenset()

    @property
    def kind(self) -> str:
        """The kind of it, as --inject has it."""
        return self.text.partition(" ")[0]

    @property
    def target(self) -> str:
        """Name of the message or signal that it is put into."""
        return self.text.partition(" ")[2].partition("=")[0]

    @property
    def part(self) -> Truth:
        """The component, as the way in which it fails has it: a message that repeats one payload is *frozen*."""
        return frozenset({f"frozen {self.target}"}) if self.kind == "freeze" else self.truth

    @property
    def of_frames(self) -> bool:
        """Whether it is one of a message's frames, not of a value."""
        return "=" not in self.text

    def hides(self, other: Injected) -> bool:
        """Return whether another fault does not show beside it: of its message, or without a signal that it spoils."""
        return (self.of_frames and self.target == other.target) or (self.kind == "value" and self.target in other.needs)

    def drawn(self, rng: np.random.Generator) -> str:
        """Return it as it is put in: an offset is up to half as large again."""
        if self.kind != "offset":
            return self.text
        head, _, size = self.text.partition("=")
        return f"{head}={float(size) * rng.uniform(1.0, 1.5):g}"


def learned(folder: Path) -> list[Car]:
    """Return both cars; their configurations are written into a folder."""
    real = Car("rav4", folder / "rav4.toml", shipped("examples/car/drive.log.xz"))
    _learn(shipped("examples/car/toyota_rav4.dbc"), real)
    rest = Car("vehicle", folder / "vehicle.toml", folder / "vehicle.log")
    _, frames = played("restbus", (), 120.0, 4242)
    with open_writer(rest.log) as writer:
        writer.write(frames)
    _learn(shipped("dbc/vehicle.dbc"), rest)
    return [real, rest]


def _learn(database: Path, car: Car) -> None:
    buses = (BusAsked("can0", "socketcan:can0", (str(database),)),)
    result = learn(Asked(car.name, buses, (car.log,), car.config, seed=1), lambda *_: None)
    write(result.files(car.config))


def injected(car: Car) -> Iterator[Injected]:
    """Yield faults that the lines of a learned configuration can show, with whom each is of."""
    config = tomllib.loads(car.config.read_text())
    bus = config["bus"][0]
    name = bus["name"]
    database = load_database([car.config.parent / file for file in bus["database"]])
    sends = _sends(database, name)
    watched = [one for monitor in config.get("monitor", ()) for one in monitor.get("signal", ())]
    moving = {one["signal"].partition(".")[0] for one in watched if "stuck" in one}
    for check in bus.get("check", ()):
        message = check["message"]
        if check.get("timeout_ms", 1e9) < _SOON_MS:
            yield Injected(car, f"drop {message}", sends[message])
        if {"crc", "checksum", "e2e"} & set(check):
            yield Injected(car, f"flip {message}", sends[message])
        if {"counter", "e2e"} & set(check) or message in moving:
            yield Injected(car, f"freeze {message}", sends[message])
        if check.get("most", {"ms": 1e9})["ms"] < _SOON_MS:
            yield Injected(car, f"replay {message}", frozenset({f"second sender {name}.{message}"}))
    for monitor in config.get("monitor", ()):
        for one in monitor.get("signal", ()):
            if "plausible" in one and one["plausible"][0] >= -40 and one["plausible"][1] < 1000:
                low, high = one["plausible"]
                value = high + 0.02 * (high - low)
                if not _says(database.signal(*one["signal"].split(".")), value, high):
                    continue
                yield Injected(car, f"value {one['signal']}={value:g}", _signal(name, one["signal"]))
        for rule in monitor.get("rule", ()):
            if "tolerance" not in rule:
                continue
            for signal in _related(rule):
                text = f"offset {signal}={2.5 * rule['tolerance']:g}"
                rules = [frozenset(_related(one)) for one in monitor["rule"] if signal in _related(one)]
                yield Injected(car, text, _signal(name, signal), frozenset.intersection(*rules) - {signal})


def _related(rule: Mapping[str, Any]) -> list[str]:
    return compile_text(rule["holds"], lambda _: None).signals


def _says(signal: Signal, value: float, limit: float) -> bool:
    """Return whether a signal's bits can say a value, and one beyond a limit if it is rounded to them."""
    step = 0.0 if signal.is_float else signal.scale
    carried = signal.offset + round((value - signal.offset) / step) * step if step else value
    return value <= representable(signal)[1] and carried > limit


def _signal(bus: str, name: str) -> Truth:
    return frozenset({f"signal {bus}.{name}"})


def _sends(database: Database, bus: str) -> dict[str, Truth]:
    """Return who is at fault where a message is: itself, or its sender, where that sends nothing else."""
    senders = {m.name: [s for s in m.senders if s not in ("XXX", "Vector__XXX")] for m in database}
    count = Counter(sender for each in senders.values() for sender in each)
    return {
        name: frozenset({f"message {bus}.{name}", *(f"ecu {bus}.{s}" for s in mine if count[s] == 1)})
        for name, mine in senders.items()
    }
