"""The steering's ECUs: drive and gear, sensors with their faults, frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from gateway.bus.frames import Frames, empty, put
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu
from gateway_bench.vecu.protection import message_of, protect
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

Row = tuple[int, int, bytes]


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


def _rows(name: str, period_ms: float, columns: dict[str, np.ndarray]) -> list[Row]:
    """Return the frames of a message, one each period from one period on."""
    message = message_of("dbc/steering.dbc", name)
    counter, crc, after = _PARTS[name]
    limits = {s.name: (s.minimum, s.maximum) for s in message.signals}
    valid = {_VALID[name]: 1} if name in _VALID else {}
    rows = []
    for k in range(len(next(iter(columns.values())))):
        values: dict[str, float] = {}
        for signal, column in columns.items():
            low, high = limits[signal]
            values[signal] = float(np.clip(column[k], low, high))
        stamp = round(((k + 1) * period_ms + after) * 1e6)
        data = protect(message, {**valid, **values, counter: (k + 1) % 16}, crc=crc)
        rows.append((stamp, message.frame_id, data))
    return rows


def _motor_rows(params: SteeringParams, told: Signals) -> list[Row]:
    """Return the frames of currents and voltages."""
    x, period = told.samples, params.period_ms
    step = 360.0 / 65536.0
    electrical = np.degrees(params.plant.believed.pole_pairs * x["sensor"])
    rows = _rows(
        "AFS_MotCur",
        period,
        {"I_U": x["i_u"], "I_V": x["i_v"], "Theta_park": np.rint(electrical / step) % 65536 * step},
    )
    voltages = {
        "U_sd_mean": x["u_d"],
        "U_sq_mean": x["u_q"],
        "U_dc": np.full(len(x), 12.0),
        "T_wdg": np.full(len(x), params.celsius),
    }
    late = params.late_voltage
    for stamp, can_id, data in _rows("AFS_MotVol", period, voltages):
        behind = late is not None and late[0] * 1e9 <= stamp < late[1] * 1e9
        rows.append((stamp + behind * period * 1_000_000, can_id, data))
    return rows


def _other_rows(params: SteeringParams, course: Course, told: Signals) -> list[Row]:
    """Return the frames of angles and speed."""
    column = params.column
    every = max(column.angle_period * 1e3, params.period_ms)
    wheel = {"Delta_S": told.wheel, "Delta_S_dot": told.rate}
    speed = {"v_X": course.speed[200::200], "Valid_v": np.ones(len(told.samples))}
    return [
        *_rows("AFS_Angle", every, {"Delta_M": told.motor, "Delta_G": told.pinion}),
        *_rows("SAS_Angle", column.wheel_period * 1e3, wheel),
        *_rows("ESC_Speed", 20.0, speed),
    ]


def _stamped(rows: list[Row], jitter_us: float, duration_s: float, bus: int, rng: np.random.Generator) -> Frames:
    """Return frames in order of their stamps, with jitter, up to the end of the run."""
    frames = empty(len(rows))
    least = 0.1e6  # frames of one ECU do not overtake each other
    jitter = np.clip(np.abs(rng.normal(0, jitter_us * 1e3, len(rows))), 0, least)
    for k, (stamp, can_id, data) in enumerate(rows):
        put(frames, k, stamp + round(jitter[k]), can_id, data, bus=bus)
    frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    return frames[frames["t_ns"] < duration_s * 1e9]


def _injected(params: SteeringParams, faults: Iterable[SteeringFault], duration_s: float) -> list[Truth]:
    """Return what was injected within the run, counted in samples of the motor."""
    times: list[tuple[str, float, float | None]] = [(fault.kind, fault.from_s, fault.to_s) for fault in faults]
    if params.late_voltage is not None:
        times.append(("late_voltage", *params.late_voltage))
    truth = []
    for kind, begin, to_s in times:
        end = duration_s if to_s is None else min(to_s, duration_s)
        if begin < end:
            truth.append(Truth(round(begin * 1e9), kind, round((end - begin) * 1e3 / params.period_ms)))
    return truth


def steering_frames(
    params: SteeringParams,
    faults: Iterable[SteeringFault],
    duration_s: float,
    *,
    bus: int,
    rng: np.random.Generator,
) -> tuple[Frames, list[Truth]]:
    """Return all frames of a run, stamped from time 0, and what was injected.

    Args:
        params: the steering.
        faults: of its sensors and inverter, in the order they are applied.
        duration_s: length of the run [s].
        bus: index of its bus.
        rng: source of all randomness.
    """
    faults = tuple(faults)
    course = _course(params, duration_s, rng)
    told = sense(params.plant, params.column, course, faults, params.period_ms * 1e-3, rng)
    rows = _motor_rows(params, told) + _other_rows(params, course, told)
    frames = _stamped(rows, params.jitter_us, duration_s, bus, rng)
    return frames, _injected(params, faults, duration_s)


def _frames(params: SteeringParams, faults: Sequence[SteeringFault], run: Run) -> tuple[Frames, list[Truth]]:
    return steering_frames(params, faults, run.duration_s, bus=run.bus, rng=run.rng)


ECU = VirtualEcu(
    type="steering",
    api=2,
    params=SteeringParams,
    fault=SteeringFault,
    frames=_frames,
    # Monitors that compare messages of a steering with each other go by the time at which these arrive.
    step_ns=1_000_000,
)
