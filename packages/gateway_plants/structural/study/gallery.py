"""The gallery's plants: what their monitors say of each fault, of healthy drives, and of a plant with other parameters.

Everything is read from the shipped files: the plant and its inputs from ``scenarios/PLANT_healthy.toml``, the faults,
their sizes and the DTCs that they are to set from ``scenarios/PLANT_faults.toml``, the monitor from the configuration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gateway.bus.frames import Frames
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario, load_scenario
from gateway_fdi.common.resources import shipped
from gateway_plants.structural.ecu.params import StructuralFault, StructuralParams
from gateway_plants.structural.study.drives import heard

#: Plants of the gallery.
PLANTS = ("motor", "tanks", "cooling", "battery", "brake")
#: Frames that are fed at once.
_BATCH = 20_000


@dataclass(frozen=True)
class Case:
    """A fault of a plant: what is put in, and the DTC that is to come."""

    fault: StructuralFault
    dtc: str
    lasts_s: float


@dataclass(frozen=True)
class Outcome:
    """What a run said.

    Attributes:
        before: DTCs before the fault began.
        dtcs: DTCs behind it, in order.
        delay_s: from the fault to the first of them that names something; NaN: none.
    """

    before: tuple[str, ...]
    dtcs: tuple[str, ...]
    delay_s: float


def scenario(plant: str, which: str = "healthy") -> Scenario:
    """Return one of a plant's scenarios."""
    return load_scenario(shipped(f"scenarios/{plant}_{which}.toml"))


def cases(plant: str) -> Iterator[Case]:
    """Yield the faults of a plant's scenario with the DTC that each is to set."""
    drive = scenario(plant, "faults")
    for fault, expected in zip(drive.fault, drive.expect, strict=True):
        assert isinstance(fault, StructuralFault)
        assert fault.to_s is not None
        yield Case(fault, str(expected.dtc), fault.to_s - fault.from_s)


def frames(
    plant: str,
    seed: int,
    seconds: float,
    fault: StructuralFault | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Frames:
    """Return the frames of a run.

    Args:
        plant: of :data:`PLANTS`.
        seed: of its noise.
        seconds: its length [s].
        fault: that it has; None: it is healthy.
        parameters: of the plant, instead of the model's.
    """
    drive = scenario(plant)
    (ecu,) = drive.ecu
    assert isinstance(ecu, StructuralParams)
    ecu = ecu.model_copy(update={"parameters": dict(parameters or {})})
    changed = {"ecu": (ecu,), "duration_s": seconds, "fault": () if fault is None else (fault,), "expect": ()}
    config = load_config(drive.config)
    buses = {bus.name: k for k, bus in enumerate(config.bus)}
    databases = {k: bus.database for k, bus in enumerate(config.bus)}
    return Player(drive.model_copy(update=changed), buses, seed=seed, databases=databases).frames


def dtcs(plant: str, drive: Frames) -> list[tuple[float, str]]:
    """Return the DTCs that a plant's monitor sets, with their times [s]."""
    path = scenario(plant).config
    gateway = Gateway(load_config(path), None, file=path)
    told = heard(gateway)
    gateway.start(int(drive[0]["t_ns"]))
    for begin in range(0, len(drive), _BATCH):
        gateway.feed(drive[begin : begin + _BATCH])
    gateway.stop(int(drive[-1]["t_ns"]))
    gateway.close()
    return [(int(str(one["t_ns"])) / 1e9, str(one["dtc"])) for one in told]


def settles_s(plant: str) -> float:
    """Return how long a plant's monitor settles [s]."""
    (entry,) = load_config(scenario(plant).config).monitor
    _, params = monitor_of(entry)
    return float(params.model_dump()["settle_s"])


def run(plant: str, case: Case, seed: int) -> Outcome:
    """Return what is said of one fault, which begins at a time drawn from the seed."""
    rng = np.random.default_rng([seed, 29])
    begin = round(settles_s(plant) + case.lasts_s * (0.2 + 0.8 * rng.random()), 3)
    fault = case.fault.model_copy(update={"from_s": begin, "to_s": None})
    found = dtcs(plant, frames(plant, seed, begin + case.lasts_s, fault))
    behind = [(t, code) for t, code in found if t >= begin]
    named = [t for t, code in behind if code == case.dtc]
    return Outcome(
        tuple(code for t, code in found if t < begin),
        tuple(code for _, code in behind),
        named[0] - begin if named else float("nan"),
    )
