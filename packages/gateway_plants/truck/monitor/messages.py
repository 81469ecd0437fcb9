"""Messages that the hybrid powertrain's monitor takes, and its inputs."""

from __future__ import annotations

import math
from collections.abc import Mapping

from gateway.monitors import contract
from gateway.monitors.contract import Connection, Signal
from gateway.monitors.sampling import Sampling
from gateway_fdi.jit import f8, means
from gateway_plants.truck.monitor.params import Params

#: Fields of the inputs by message, and signals that are not called as their fields are.
MESSAGES = {
    "HEV_CTRL_PT": ("U_em_ctrl", "ice_ctrl", "u_c", "gear"),
    "HEV_CTRL_VEH": ("T_b_ctrl", "alpha"),
    "HEV_SENS_ELEC": ("I_b_sens", "U_em_sens", "I_em_sens"),
    "HEV_SENS_MECH": ("omega_e_sens", "omega_gb_sens", "charge"),
}
_CALLED = {"omega_e_sens": "w_e_sens", "omega_gb_sens": "w_gb_sens", "charge": "SoC_start"}
#: Sets that are collected at once: ECUs send at their own times, and a bus lets some wait; and periods after which what
#: was collected of a set is given up: its counter may have come round.
DEPTH, OLD = 4, 64


class Inputs(contract.SampledInputs):
    """The fields above, in their order."""

    U_em_ctrl: f8 = means("voltage asked of the power electronics", "V")
    ice_ctrl: f8 = means("fuel energy of a cycle of the four strokes, all cylinders", "J")
    u_c: f8 = means("clutch, 1 engaged")
    gear: f8 = means("gear; 0: neutral")
    T_b_ctrl: f8 = means("brake torque asked for", "Nm")
    alpha: f8 = means("slope of the road", "rad")
    I_b_sens: f8 = means("current of the battery, measured", "A")
    U_em_sens: f8 = means("voltage of the machine, measured", "V")
    I_em_sens: f8 = means("current of the machine, measured", "A")
    omega_e_sens: f8 = means("speed of the engine, measured", "rad/s")
    omega_gb_sens: f8 = means("speed of the gearbox's output, measured", "rad/s")
    charge: f8 = means("state of charge at the start")


def signal_of(field: str) -> str:
    """Return the signal of a field."""
    return _CALLED.get(field, field)


def connect(_: Params) -> Mapping[str, Connection]:
    """Return what the inputs are connected to."""
    return {
        field: Signal(f"{message}.{signal_of(field)}", Inputs.meanings[field].unit or None, triggers=True)
        for message, fields in MESSAGES.items()
        for field in fields
    }


def sampling(p: Params) -> Sampling:
    """Return how frames become sets: by their counters, in whatever order they come; only whole sets count."""
    counters = tuple(f"{message}.FrameCnt" for message in MESSAGES)
    oldest_ms = OLD * p.period_ms
    return Sampling("counter", p.period_ms, math.inf, oldest_ms, counters, depth=DEPTH)
