"""The hybrid truck's ECU: four frames each 10 ms, of one counter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.signals import frame_encoding as encode
from gateway_bench.vecu.contract import Run, Truth, VirtualEcu, injected
from gateway_bench.vecu.databases import message_of
from gateway_plants.truck.ecu.control import PERIOD
from gateway_plants.truck.ecu.drive import Drive, drive
from gateway_plants.truck.ecu.params import TruckFault, TruckParams

Column = NDArray[Any]

DATABASE = "dbc/truck.dbc"
#: Messages in the order in which they are sent: commands first, what they did behind.
MESSAGES = ("HEV_CTRL_PT", "HEV_CTRL_VEH", "HEV_SENS_ELEC", "HEV_SENS_MECH")
#: Between two frames of a set [ns].
_BETWEEN = 300_000


def signals_of(params: TruckParams, driven: Drive, rng: np.random.Generator) -> dict[str, Column]:
    """Return the signals of a drive with sensor noise, by name, each of shape (samples,)."""
    rows, noise = driven.samples, params.noise
    count = len(rows)

    def sensed(name: str, sigma: float) -> Column:
        return np.asarray(rows[name] + params.noise_factor * sigma * rng.normal(size=count))

    return {
        "I_b_sens": sensed("i_b", noise.battery_current),
        "U_em_sens": sensed("u_em", noise.machine_voltage),
        "I_em_sens": sensed("i_em", noise.machine_current),
        "w_e_sens": sensed("omega_e", noise.engine_speed),
        "w_gb_sens": sensed("omega_gb", noise.gearbox_speed),
        "SoC_start": np.full(count, params.charge),
        "U_em_ctrl": rows["volts"],
        "ice_ctrl": rows["ice"],
        "u_c": rows["clutch"],
        "gear": rows["gear"],
        "shift_active": rows["shifting"] > 0,
        "eng_run": np.ones(count),
        "T_b_ctrl": rows["brake"],
        "alpha": np.zeros(count),
        "FrameCnt": np.arange(count) % 256,
    }


def frames_of(params: TruckParams, driven: Drive, *, bus: int, rng: np.random.Generator) -> Frames:
    """Return the frames of a drive, stamped from time 0."""
    count = len(driven.samples)
    columns = signals_of(params, driven, rng)
    frames = empty(len(MESSAGES) * count)
    late = np.clip(np.abs(rng.normal(0.0, params.jitter_us * 1e3, len(frames))), 0.0, 0.3 * _BETWEEN)
    for place, name in enumerate(MESSAGES):
        message = message_of(DATABASE, name)
        stamps = np.round(np.arange(count) * PERIOD * 1e9) + place * _BETWEEN + np.round(late[place :: len(MESSAGES)])
        of_message = {s.name: columns[s.name] for s in message.signals if s.name != "Crc"}
        frames[place :: len(MESSAGES)] = encode.frames_of(message, of_message, stamps, bus=bus)
    return frames


def _frames(params: TruckParams, faults: Sequence[TruckFault], run: Run) -> tuple[Frames, list[Truth]]:
    driven = drive(params, tuple(faults), run.duration_s)
    times = [(fault.kind, fault.from_s, fault.to_s) for fault in faults]
    return frames_of(params, driven, bus=run.bus, rng=run.rng), injected(times, run.duration_s, PERIOD)


ECU = VirtualEcu(
    type="truck",
    api=2,
    params=TruckParams,
    fault=TruckFault,
    frames=_frames,
)
