"""The Tennessee Eastman process, by the package tep-studio (BSD): Downs, Vogel 1993; Ricker's control, 1996.

There are no equations here: methods that need them refuse. A valve's position is a command, as its controller sets it.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec

import numpy as np

from gateway_arena.contract import SAMPLES, Record, WithoutSlopes
from gateway_arena.plants.scipy_plant import onset_of
from gateway_fdi.errors import InputError
from gateway_fdi.structure.model import Model

NAME = "tennessee"
#: Disturbances of the process as it was published; those that were added later are left out.
FAULTS = tuple(f"idv_{k:02d}" for k in range(1, 21))
#: Measurements that come all the time; the others are analysers', minutes apart.
CONTINUOUS = 22
#: Time between two samples, and steps of the control in it [h].
PERIOD_H, STEPS = 0.01, 2


def is_there() -> bool:
    """Return whether tep-studio is installed."""
    return find_spec("tep_studio") is not None


class TennesseePlant(WithoutSlopes):
    """The process as the arena takes it: 12 h, under control.

    Raises:
        InputError: tep-studio is not installed.
    """

    name, source = NAME, "Tennessee Eastman process; Downs, Vogel 1993; tep-studio"
    period_s = PERIOD_H * 3600.0

    def __init__(self) -> None:
        if not is_there():
            raise InputError("this plant needs tep-studio: pip install tep-studio", key="--plant", value=NAME)
        from tep_studio.simulation.schema import TEP_SCHEMA  # noqa: PLC0415 - an extra package, slow to load

        self.commands: tuple[str, ...] = tuple(TEP_SCHEMA.names("manipulated_variables"))
        self.knowns = (*self.commands, *TEP_SCHEMA.names("measurements")[:CONTINUOUS])
        self.model = Model(NAME, (), (), self.knowns, FAULTS)
        told = {one.name: one.description for one in TEP_SCHEMA.disturbances}
        self.sizes: Mapping[str, str] = {fault: told[fault] for fault in FAULTS}
        steps = np.diff(self.record(0).values, axis=0)[:, len(self.commands) :]
        self.noise = (*[0.0] * len(self.commands), *(steps.std(0) / np.sqrt(2.0)).tolist())

    def record(self, seed: int, fault: str = "", off: float = 0.0, size: float = 1.0) -> Record:
        """Return a run; behind a shutdown of the plant its last sample stays.

        Raises:
            InputError: parameters cannot be off here; a size above 1.
        """
        if off:
            raise InputError("parameters of this plant cannot be off", key="--off", value=off)
        if size > 1.0:
            raise InputError("a disturbance of this plant has size 1 at most", key="--size", value=size)
        from tep_studio.control import ClosedLoopSimulation  # noqa: PLC0415

        onset = onset_of(seed) if fault else SAMPLES
        active = np.zeros(28)
        if fault:
            active[FAULTS.index(fault)] = size
        begin_h = (onset + 0.5) * PERIOD_H
        run = ClosedLoopSimulation(control_interval=PERIOD_H / STEPS, horizon=(SAMPLES + 1) * PERIOD_H).run(
            seed=float(seed + 1),
            disturbance_schedule=lambda t_h: active if t_h >= begin_h else np.zeros(28),
            record_every=STEPS,
        )
        rows = [[*one.implemented_action, *one.measurements[:CONTINUOUS]] for one in run.results[:SAMPLES]]
        rows += [rows[-1]] * (SAMPLES - len(rows))
        return Record(np.arange(float(SAMPLES)) * self.period_s, np.array(rows), fault, onset)
