"""The engine ECU: crank, sensor with its faults, tooth frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from gateway.bus.frames import Frames
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu
from gateway_plants.crank.ecu.faults import added_pulses, missed_pulses
from gateway_plants.crank.ecu.kinematics import cam_edges, tooth_times
from gateway_plants.crank.ecu.params import CrankParams, PulseFault
from gateway_plants.crank.ecu.tooth_frames import cam_frames, tooth_frames


def crank_frames(
    params: CrankParams,
    faults: Iterable[PulseFault],
    duration_s: float,
    *,
    bus: int,
    rng: np.random.Generator,
) -> tuple[Frames, list[Truth]]:
    """Return all frames of a run, stamped from time 0, and what was injected.

    Args:
        params: the engine.
        faults: of its sensor.
        duration_s: length of the run [s].
        bus: index of its bus.
        rng: source of all randomness.
    """
    pulses = params.wheel.pulses
    healthy = tooth_times(
        params.wheel,
        params.speed,
        duration_s,
        ripple=[(r.order, r.amplitude, r.phase) for r in params.ripple],
        jitter=params.jitter,
        tooth_error=params.tooth_error,
        rng=rng,
    )
    truth: list[Truth] = []
    gone = np.zeros(len(healthy), bool)
    extra = []
    for fault in faults:
        at_ns = round(fault.at_s * 1e9)
        if fault.kind == "missed_pulses":
            places, injected = missed_pulses(healthy, pulses, at_ns, fault.count, fault.tooth)
            gone[places] = True
        else:
            added, injected = added_pulses(healthy, pulses, at_ns, fault.count, rng, fault.tooth)
            extra.append(added)
        truth += injected
    times = np.unique(np.concatenate([healthy[~gone], *extra]))
    on_off = 0, round(duration_s * 1e9)
    frames = tooth_frames(times, params.format, bus=bus, span_ns=on_off)
    if params.cam:
        edges, levels = cam_edges(params.cam, params.speed, duration_s)
        frames = np.concatenate([frames, cam_frames(times, edges, levels, bus=bus)])
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    return frames, truth


def _frames(params: CrankParams, faults: Sequence[PulseFault], run: Run) -> tuple[Frames, list[Truth]]:
    return crank_frames(params, faults, run.duration_s, bus=run.bus, rng=run.rng)


ECU = VirtualEcu(
    type="crank",
    api=2,
    params=CrankParams,
    fault=PulseFault,
    frames=_frames,
)
