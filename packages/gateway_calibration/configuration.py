"""All that healthy logs can set of a configuration, at once: what was found, and how it is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from math import isnan
from pathlib import Path
from typing import Any

from gateway.config.model import Config
from gateway.monitors.contract import Calibration, CusumCalibration, Refinement, SensorCalibration
from gateway_api.thresholds import Targets
from gateway_calibration import cusum, plants, sensors, stopping
from gateway_calibration.earlier import load_afresh
from gateway_calibration.file import write
from gateway_calibration.logs import Progress, Reading, digest, of_kind, refuse
from gateway_fdi.errors import InputError
from gateway_fdi.stopping import assured


@dataclass(frozen=True)
class Found:
    """Findings of the logs: of stopping rules, of CUSUM tests, None where a configuration has none of these.

    Attributes:
        levels: largest levels of stopping rules.
        proposals: thresholds for them.
        tests: of CUSUM tests, with thresholds.
        plants: of linear plants, with matrices.
        sensors: of redundant sensors, with what they are like.
        data: names of the logs' contents.
        logs: how many they are.
        left_out: rows of logs that nothing was learnt from.
        read: logs that were read; the others had been before.
    """

    levels: stopping.Levels | None
    proposals: list[stopping.Proposal]
    tests: cusum.Found | None
    plants: list[plants.Plant]
    sensors: list[sensors.Sensors]
    data: str
    logs: int
    left_out: Sequence[Mapping[str, Any]] = ()
    read: int = 0

    @property
    def seconds(self) -> float:
        """Length of the logs [s]."""
        return max(part.seconds for part in (self.levels, self.tests, *self.plants, *self.sensors) if part is not None)

    @property
    def failed(self) -> tuple[str, ...]:
        """DTCs that the logs set."""
        parts = (part for part in (self.levels, self.tests, *self.sensors) if part is not None)
        return tuple(sorted({dtc for part in parts for dtc in part.failed}))


def anything(config: Config) -> bool:
    """Return whether logs can set anything of a configuration."""
    kinds = (Calibration, CusumCalibration, Refinement, SensorCalibration)
    return any(of_kind(config, kind) for kind in kinds)  # type: ignore[type-var]


def calibrate(
    file: Path,
    logs: Sequence[Path],
    targets: Targets,
    maps: Sequence[str] = (),
    progress: Progress = lambda frames: None,
) -> Found:
    """Run healthy logs through a gateway, and propose thresholds.

    Args:
        file: of the configuration.
        logs: healthy ones.
        targets: that thresholds are to hold.
        maps: channels of the logs taken as buses, ``"channel=bus"`` each.
        progress: called with the number of frames after each batch.

    Raises:
        InputError, InputErrors: the configuration has nothing to calibrate; a log is damaged.
    """
    config = load_afresh(file, told=True)
    if not anything(config):
        raise refuse("thresholds", file)
    levels = tests = None
    refined: list[plants.Plant] = []
    measured: list[sensors.Sensors] = []
    paths, how = list(logs), Reading(file, maps, progress)
    if of_kind(config, Calibration):
        levels = stopping.levels(config, paths, how)
    if of_kind(config, CusumCalibration):
        tests = cusum.learn(config, paths, how, margin=targets.margin, floor=targets.floor)
    if of_kind(config, Refinement):
        refined = plants.learn(config, paths, how)
    if of_kind(config, SensorCalibration):
        measured = sensors.learn(config, paths, how)
    proposals = stopping.calibrate(config, levels, targets.mtfa_s) if levels else []
    return Found(levels, proposals, tests, refined, measured, digest(paths), len(paths))


def keep(file: Path, targets: Targets, learned: Found, into: Path) -> None:
    """Write thresholds into a configuration, with their source.

    Args:
        file: of the configuration that was calibrated.
        targets: of it.
        learned: by the logs.
        into: the configuration itself, or a copy of it in the same folder.

    Raises:
        InputError: the file cannot be written, or would not find what lies beside the configuration.
    """
    source = f"{learned.seconds:.0f} s of healthy logs, sha256 {learned.data}"
    if into.absolute() != file.absolute():
        if into.absolute().parent != file.absolute().parent:
            text = "is to lie beside the configuration, whose databases are named from there"
            raise InputError(text, key="--write-to", value=str(into))
        into.write_text(file.read_text())
    if learned.levels:
        tables = stopping.tables(learned.proposals)
        write(into, tables, f"{source}, target {targets.mtfa_s:.0f} s")
    if learned.tests:
        criteria = f"margin {targets.margin:g}, floor {targets.floor:g} nu"
        write(into, learned.tests.tables, f"{source}, {criteria}")
    if learned.plants:
        plants.write(into, learned.plants, source)
    if learned.sensors:
        sensors.write(into, learned.sensors, source)


def as_dict(targets: Targets, learned: Found) -> dict[str, Any]:
    """Return what was found, for programs."""
    said: dict[str, Any] = {
        "seconds": learned.seconds,
        "data": learned.data,
        "logs": learned.logs,
        "left_out": [{name: row[name] for name in ("path", "kind", "text")} for row in learned.left_out],
        "failed": list(learned.failed),
    }
    if learned.levels:
        said |= {"target_s": targets.mtfa_s, "rows": [asdict(p) for p in learned.proposals]}
    if learned.tests:
        said |= {"margin": targets.margin, "floor": targets.floor}
        said["cusum"] = [asdict(row) | {"margin": row.margin} for row in learned.tests.rows]
    if learned.plants:
        said["plants"] = [
            {"monitor": p.monitor, "seconds": p.seconds, "fit": list(p.fit), "rows": [list(row) for row in p.rows]}
            for p in learned.plants
        ]
    if learned.sensors:
        said["sensors"] = [
            {
                "monitor": one.monitor,
                "seconds": one.seconds,
                "rows": [[None if isinstance(v, float) and isnan(v) else v for v in row] for row in one.rows],
            }
            for one in learned.sensors
        ]
    return said | {"assured_s": assured(learned.seconds, 0)}
