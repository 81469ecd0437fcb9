"""Messages that the hybrid powertrain's monitor takes, and its inputs."""

from __future__ import annotations

from gateway.jit import f8
from gateway.monitors.hybrid_powertrain.params import Params
from gateway.monitors.shape import Wiring, inputs

#: Fields of the inputs by message: signal and unit.
MESSAGES = {
    "HEV_CTRL_PT": {
        "U_em_ctrl": ("U_em_ctrl", "V"),
        "ice_ctrl": ("ice_ctrl", "J"),
        "u_c": ("u_c", ""),
        "gear": ("gear", ""),
        "count_pt": ("FrameCnt", ""),
    },
    "HEV_CTRL_VEH": {
        "T_b_ctrl": ("T_b_ctrl", "Nm"),
        "alpha": ("alpha", "rad"),
        "count_veh": ("FrameCnt", ""),
    },
    "HEV_SENS_ELEC": {
        "I_b_sens": ("I_b_sens", "A"),
        "U_em_sens": ("U_em_sens", "V"),
        "I_em_sens": ("I_em_sens", "A"),
        "count_elec": ("FrameCnt", ""),
    },
    "HEV_SENS_MECH": {
        "omega_e_sens": ("w_e_sens", "rad/s"),
        "omega_gb_sens": ("w_gb_sens", "rad/s"),
        "charge": ("SoC_start", ""),
        "count_mech": ("FrameCnt", ""),
    },
}

INPUTS = inputs(**{name: f8 for fields in MESSAGES.values() for name in fields})


def wire(_: Params) -> Wiring:
    """Return what the monitor wants from the bus."""
    signals, units = [], {}
    for message, fields in MESSAGES.items():
        for signal, unit in fields.values():
            signals.append(f"{message}.{signal}")
            if unit:
                units[f"{message}.{signal}"] = unit
    return Wiring(tuple(MESSAGES), tuple(signals), (), units)
