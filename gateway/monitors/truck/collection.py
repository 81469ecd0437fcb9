"""Frames of the four messages put together by their counters, in whatever order they come.

ECUs send at their own times, and a bus lets some wait: the frames of one set come up to three periods apart. So each
set is collected by its counter, and taken when it is complete; one that is older than the last taken is not.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway.jit import Record, i8, i8s, kernel, means
from gateway.monitors.truck.messages import Inputs

#: Sets that are collected at once; counters of 8 bits are a multiple of it.
DEPTH = 4
#: Bits of the messages: HEV_CTRL_PT, HEV_CTRL_VEH, HEV_SENS_ELEC, HEV_SENS_MECH.
PT, VEH, ELEC, MECH = 1, 2, 4, 8
WHOLE = PT | VEH | ELEC | MECH
#: Periods after which what was collected of a set is given up: its counter has come round.
OLD = 64.0


class State(Record):
    """State."""

    held: Annotated[list[Inputs], DEPTH]
    have: Annotated[i8s, DEPTH] = means("bits of the messages that have come")
    number: Annotated[i8s, DEPTH] = means("counter of the set")
    last: Annotated[i8s, 4] = means("counter of each message's newest frame, -1: none yet")
    apart: i8 = means("sets of which not all frames came")


@kernel
def _place(s: State, u: Inputs, count: int, period: float) -> int:
    """Return the place of a frame's set, cleared if another was there."""
    k = count % DEPTH
    age = (u.t_ns - s.held[k].t_ns) * 1e-9
    if s.number[k] != count or age > OLD * period:
        if s.have[k] != 0 and s.have[k] != WHOLE:
            s.apart += 1
        s.have[k] = 0
        s.number[k] = count
        s.held[k].t_ns = u.t_ns
    return k


@kernel
def collect(s: State, u: Inputs, period: float) -> int:
    """Put the frame that has come to its set; returns the place of the set if that makes it whole, else -1.

    Args:
        s: state.
        u: the newest frame of each message.
        period: between two sets [s].
    """
    whole = -1
    if not np.isnan(u.count_pt) and int(u.count_pt) != s.last[0]:
        s.last[0] = int(u.count_pt)
        k = _place(s, u, s.last[0], period)
        v = s.held[k]
        v.U_em_ctrl, v.ice_ctrl, v.u_c, v.gear, v.count_pt = u.U_em_ctrl, u.ice_ctrl, u.u_c, u.gear, u.count_pt
        s.have[k] |= PT
        whole = k if s.have[k] == WHOLE else whole
    if not np.isnan(u.count_veh) and int(u.count_veh) != s.last[1]:
        s.last[1] = int(u.count_veh)
        k = _place(s, u, s.last[1], period)
        v = s.held[k]
        v.T_b_ctrl, v.alpha, v.count_veh = u.T_b_ctrl, u.alpha, u.count_veh
        s.have[k] |= VEH
        whole = k if s.have[k] == WHOLE else whole
    if not np.isnan(u.count_elec) and int(u.count_elec) != s.last[2]:
        s.last[2] = int(u.count_elec)
        k = _place(s, u, s.last[2], period)
        v = s.held[k]
        v.I_b_sens, v.U_em_sens, v.I_em_sens, v.count_elec = u.I_b_sens, u.U_em_sens, u.I_em_sens, u.count_elec
        s.have[k] |= ELEC
        whole = k if s.have[k] == WHOLE else whole
    if not np.isnan(u.count_mech) and int(u.count_mech) != s.last[3]:
        s.last[3] = int(u.count_mech)
        k = _place(s, u, s.last[3], period)
        v = s.held[k]
        v.omega_e_sens, v.omega_gb_sens, v.charge, v.count_mech = (
            u.omega_e_sens,
            u.omega_gb_sens,
            u.charge,
            u.count_mech,
        )
        s.have[k] |= MECH
        whole = k if s.have[k] == WHOLE else whole
    return whole
