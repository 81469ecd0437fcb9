"""The steering's ECUs: drive and gear, sensors with their faults, frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gateway.bus.frames import Frames
from gateway.signals.frame_encoding import frames_of, merged
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu, injected
from gateway_bench.vecu.databases import message_of
from gateway_plants.steering.ecu.course import Course, driving, sweep, times
from gateway_plants.steering.ecu.faults import SteeringFault
from gateway_plants.steering.ecu.params import SteeringParams
from gateway_plants.steering.ecu.signals import Signals, sense

#: Messages with the names of their counter and CRC, and when they follow the motor's sample [ms].
_PARTS = {
    "AFS_MotCur": ("MC_cur", "CRC_cur", 0.0),
    "AFS_MotVol": ("MC_vol", "CRC_vol", 0.15),
    "AFS_Angle": ("MC_ang", "CRC_ang", 0.3),
    "SAS_Angle": ("MC_sas", "CRC_sas", 0.45),
    "ESC_Speed": ("MC_v", "CRC_v", 0.6),
}
_VALID = {"AFS_MotCur": "Valid_cur", "AFS_Angle": "Valid_ang", "SAS_Angle": "Valid_sas"}


def _course(params: SteeringParams, duration_s: float, rng: np.random.Generator) -> Course:
    t = times(duration_s)
    if params.course == "sweep":
        return sweep(t)
    column = params.column
    return driving(
        t,
        params.speed,
        params.ratio,
        params.gear,
        params.cubic,
        column.motor_ratio,
        column.wheel_ratio,
        rng,
    )


def _message(name: str, period_ms: float, columns: dict[str, np.ndarray], bus: int) -> Frames:
    """Return the frames of a message, one each period from one period on."""
    counter, crc, after = _PARTS[name]
    number = np.arange(1, 1 + len(next(iter(columns.values()))))
    valid = {_VALID[name]: np.ones(len(number))} if name in _VALID else {}
    stamps = (number * period_ms + after) * 1e6
    message = message_of("dbc/steering.dbc", name)
    return frames_of(message, {**valid, **columns, counter: number % 16}, stamps, crc, bus=bus)


def _motor(params: SteeringParams, told: Signals, bus: int) -> list[Frames]:
    """Return the frames of currents, and of voltages."""
    x, period = told.samples, params.period_ms
    step = 360.0 / 65536.0
    electrical = np.degrees(params.plant.believed.pole_pairs * x["sensor"])
    angle = np.rint(electrical / step) % 65536 * step
    currents = _message("AFS_MotCur", period, {"I_U": x["i_u"], "I_V": x["i_v"], "Theta_park": angle}, bus)
    columns = {
        "U_sd_mean": x["u_d"],
        "U_sq_mean": x["u_q"],
        "U_dc": np.full(len(x), 12.0),
        "T_wdg": np.full(len(x), params.celsius),
    }
    voltages = _message("AFS_MotVol", period, columns, bus)
    if params.late_voltage is not None:
        begin_ns, end_ns = (at * 1e9 for at in params.late_voltage)
        behind = (begin_ns <= voltages["t_ns"]) & (voltages["t_ns"] < end_ns)
        voltages["t_ns"] += np.where(behind, np.int64(period * 1_000_000), 0)
    return [currents, voltages]


def _others(params: SteeringParams, course: Course, told: Signals, bus: int) -> list[Frames]:
    """Return the frames of angles, and of the speed."""
    column = params.column
    every = max(column.angle_period * 1e3, params.period_ms)
    wheel = {"Delta_S": told.wheel, "Delta_S_dot": told.rate}
    speed = {"v_X": course.speed[200::200], "Valid_v": np.ones(len(told.samples))}
    return [
        _message("AFS_Angle", every, {"Delta_M": told.motor, "Delta_G": told.pinion}, bus),
        _message("SAS_Angle", column.wheel_period * 1e3, wheel, bus),
        _message("ESC_Speed", 20.0, speed, bus),
    ]


def _frames(params: SteeringParams, faults: Sequence[SteeringFault], run: Run) -> tuple[Frames, list[Truth]]:
    rng, period_s = run.rng, params.period_ms * 1e-3
    course = _course(params, run.duration_s, rng)
    told = sense(params.plant, params.column, course, tuple(faults), period_s, rng)
    frames = np.concatenate([*_motor(params, told, run.bus), *_others(params, course, told, run.bus)])
    least = 0.1e6  # frames of one ECU do not overtake each other
    jitter = np.clip(np.abs(rng.normal(0, params.jitter_us * 1e3, len(frames))), 0, least)
    frames["t_ns"] += np.rint(jitter).astype(np.int64)
    frames = merged(frames)
    done: list[tuple[str, float, float | None]] = [(fault.kind, fault.from_s, fault.to_s) for fault in faults]
    if params.late_voltage is not None:
        done.append(("late_voltage", *params.late_voltage))
    return frames[frames["t_ns"] < run.duration_s * 1e9], injected(done, run.duration_s, period_s)


ECU = VirtualEcu(
    type="steering",
    api=2,
    params=SteeringParams,
    fault=SteeringFault,
    frames=_frames,
    # Monitors that compare messages of a steering with each other go by the time at which these arrive.
    step_ns=1_000_000,
)
