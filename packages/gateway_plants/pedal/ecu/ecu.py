"""The pedal ECU: driver, sensors with their faults, ADC, frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.signals.frame_encoding import frames_of
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu
from gateway_bench.vecu.databases import message_of
from gateway_bench.vecu.sensor_faults import at_rail, digitised, drift, impulses, offset, stuck
from gateway_plants.pedal.ecu import strokes
from gateway_plants.pedal.ecu.params import PedalParams, SensorFault

_STROKES = {
    "exponential": strokes.exponential,
    "ramp": strokes.ramp,
    "cosine": strokes.cosine,
}


def travel(params: PedalParams, t: NDArray[np.float64], rng: np.random.Generator) -> strokes.Travel:
    """Return the pedal's travel, 0 to 1, at times [s]."""
    if params.stroke == "driving":
        return strokes.driving(t, rng)
    if params.stroke == "points":
        return strokes.along(t, params.points)
    pressed = [_STROKES[params.stroke](t, begin) for begin in params.at_s]
    return np.asarray(np.max(pressed, axis=0))


def _faulty(
    readings: NDArray[np.float64],
    fault: SensorFault,
    params: PedalParams,
    rng: np.random.Generator,
) -> Truth | None:
    """Put a fault into the readings, shape (n, channels) [V]; returns what was done."""
    n = len(readings)
    per_s = 1e3 / params.period_ms
    begin = min(round(fault.from_s * per_s), n)
    end = n if fault.to_s is None else min(round(fault.to_s * per_s), n)
    if begin >= end:
        return None
    size, supply, length = fault.size * params.supply, params.supply, end - begin
    shared: NDArray[np.float64] | None = None
    for channel in fault.channel:
        y = readings[:, channel - 1]
        if fault.kind == "stuck":
            y[:] = stuck(y, begin, end)
        elif fault.kind in ("short_to_ground", "open"):
            y[:] = at_rail(y, begin, end, 0.0)  # an ADC's pull-down takes an open input to ground
        elif fault.kind == "short_to_supply":
            y[:] = at_rail(y, begin, end, supply)
        elif fault.kind == "garbage":
            y[begin:end] = rng.uniform(0, supply, length)
        elif fault.kind == "offset":
            y += offset(n, begin, end, size)
        elif fault.kind == "drift":
            y += drift(n, begin, end, size / per_s)
        else:
            if shared is None or not fault.common:
                shared = (
                    impulses(length, fault.rate, size, rng) if fault.kind == "impulses" else rng.normal(0, size, length)
                )
            y[begin:end] += shared
    return Truth(round(begin * params.period_ms * 1e6), fault.kind, length)


def _frames(params: PedalParams, faults: Sequence[SensorFault], run: Run) -> tuple[Frames, list[Truth]]:
    rng = run.rng
    n = int(run.duration_s * 1e3 / params.period_ms)
    t = np.arange(n, dtype=np.float64) * (params.period_ms * 1e-3)
    x = travel(params, t, rng)
    readings = np.empty((n, len(params.sensors)))
    for i, sensor in enumerate(params.sensors):
        slope = (sensor.at_full - sensor.at_rest) * sensor.gain
        readings[:, i] = sensor.at_rest + sensor.offset + slope * x + rng.normal(0, sensor.noise, n)
    truth = [done for fault in faults if (done := _faulty(readings, fault, params, rng))]
    readings = digitised(readings, params.supply, params.adc_bits)
    message = message_of("dbc/pedal.dbc", params.message)
    least = 0.2 * params.period_ms * 1e6  # frames of one ECU do not overtake each other
    late = np.clip(np.abs(rng.normal(0, params.jitter_us * 1e3, n)), 0, least)
    columns = {sensor.signal: readings[:, i] for i, sensor in enumerate(params.sensors)}
    return frames_of(message, {"FrameCnt": np.arange(n) % 16, **columns}, t * 1e9 + late, bus=run.bus), truth


def _fits(params: PedalParams, fault: SensorFault) -> None:
    if max(fault.channel) > len(params.sensors):
        raise ValueError(f"ECU {params.name!r} has no channel {max(fault.channel)}")


ECU = VirtualEcu(
    type="pedal",
    api=2,
    params=PedalParams,
    fault=SensorFault,
    frames=_frames,
    fits=_fits,
)
