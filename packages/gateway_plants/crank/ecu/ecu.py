"""The engine ECU: crank, sensor with its faults, tooth frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.bus.frames import Frames
from gateway.signals.frame_encoding import merged
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu
from gateway_plants.crank.ecu.faults import added_pulses, missed_pulses
from gateway_plants.crank.ecu.kinematics import cam_edges, tooth_times
from gateway_plants.crank.ecu.params import CrankParams, PulseFault
from gateway_plants.crank.ecu.tooth_frames import cam_frames, tooth_frames


def _frames(params: CrankParams, faults: Sequence[PulseFault], run: Run) -> tuple[Frames, list[Truth]]:
    duration_s, bus, rng = run.duration_s, run.bus, run.rng
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
        frames = merged(frames, cam_frames(times, edges, levels, bus=bus))
    return frames, truth


ECU = VirtualEcu(
    type="crank",
    api=2,
    params=CrankParams,
    fault=PulseFault,
    frames=_frames,
)
