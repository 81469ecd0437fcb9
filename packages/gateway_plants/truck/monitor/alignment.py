"""All signals of a set at one time: the electric sensors may be some milliseconds late, or early.

An ECU that filters, or samples a cycle earlier, puts voltages and currents of another time into a set than the voltage
asked for and the speeds. T1 = U - U_ctrl then leaves what the voltage moves by in that time, tens of volts at a gear
change. The lag is found from U_ctrl and U (:mod:`gateway_fdi.slow.lag`), and found again while the drive lasts; what
is early waits for what is late, between two sets by a line. What this leaves, and all that a lag of the largest size
makes until it is known, is not the fault of a part: :func:`doubt` has it.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8, i8, kernel, means
from gateway_fdi.slow import lag
from gateway_plants.truck.monitor.messages import Inputs

#: Sets that are held; on either side of the one that is taken, sets whose movement is doubted.
DEPTH, BESIDE = 8, 1
#: Of what the alignment leaves of a movement, root mean square, what is doubted.
LEFT = 2.0


class State(Record):
    """State."""

    held: Annotated[list[Inputs], DEPTH] = means("the last sets")
    at: i8 = means("place of the newest")
    count: i8 = means("sets since a gap")
    lag: lag.State = means("by how much U is behind U_ctrl")
    out: Inputs = means("the set that is taken")
    swing: f8 = means("what the lag may still make of a voltage", "V")


@kernel
def hold(v: Inputs, u: Inputs) -> None:
    """Copy a set."""
    v.t_ns = u.t_ns
    v.U_em_ctrl, v.ice_ctrl, v.u_c, v.gear, v.T_b_ctrl = u.U_em_ctrl, u.ice_ctrl, u.u_c, u.gear, u.T_b_ctrl
    v.alpha, v.I_b_sens, v.U_em_sens, v.I_em_sens = u.alpha, u.I_b_sens, u.U_em_sens, u.I_em_sens
    v.omega_e_sens, v.omega_gb_sens, v.charge = u.omega_e_sens, u.omega_gb_sens, u.charge


@kernel
def _swing(s: State, first: int, last: int, measured: bool) -> float:
    """Return what U_ctrl, or U, moves by between two ages [sets]."""
    low, high = 1e300, -1e300
    for age in range(max(first, 0), min(last, DEPTH - 1) + 1):
        v = s.held[(s.at - age) % DEPTH]
        volts = v.U_em_sens if measured else v.U_em_ctrl
        low, high = min(low, volts), max(high, volts)
    return max(high - low, 0.0)


@kernel
def align(s: State, u: Inputs, steps: int, most: float, noise: float) -> None:
    """Take a set; ``out`` is the one to be tested.

    Args:
        u: the set.
        steps: of the counter since the set before.
        most: largest lag of either sign [sets]; 0: sets are as they are.
        noise: of a voltage [V].
    """
    hold(s.out, u)
    if most == 0.0:
        return
    if steps != 1:
        s.count = 0
        lag.restart(s.lag)
    s.at = (s.at + 1) % DEPTH
    hold(s.held[s.at], u)
    if s.count == 0 and s.held[(s.at - 1) % DEPTH].t_ns == 0:
        for k in range(DEPTH):
            hold(s.held[k], u)
    s.count = min(s.count + 1, DEPTH)
    lag.update(s.lag, u.U_em_ctrl, u.U_em_sens, most, noise)
    behind = abs(s.lag.lag)
    whole = int(behind)
    first, second = min(whole, s.count - 1), min(whole + 1, s.count - 1)
    v, w, f = s.held[(s.at - first) % DEPTH], s.held[(s.at - second) % DEPTH], behind - whole
    o = s.out
    if s.lag.lag > 0.0:
        near = v if f < 0.5 else w  # what jumps is taken of one set
        o.ice_ctrl, o.u_c, o.gear, o.T_b_ctrl, o.alpha = near.ice_ctrl, near.u_c, near.gear, near.T_b_ctrl, near.alpha
        o.U_em_ctrl = v.U_em_ctrl + f * (w.U_em_ctrl - v.U_em_ctrl)
        o.omega_e_sens = v.omega_e_sens + f * (w.omega_e_sens - v.omega_e_sens)
        o.omega_gb_sens = v.omega_gb_sens + f * (w.omega_gb_sens - v.omega_gb_sens)
    elif s.lag.lag < 0.0:
        o.U_em_sens = v.U_em_sens + f * (w.U_em_sens - v.U_em_sens)
        o.I_em_sens = v.I_em_sens + f * (w.I_em_sens - v.I_em_sens)
        o.I_b_sens = v.I_b_sens + f * (w.I_b_sens - v.I_b_sens)
    if s.lag.known == 0:
        far = int(most)
        s.swing = max(_swing(s, 0, far, False), _swing(s, 0, far, True))
        return
    at = whole if s.lag.lag > 0.0 else 0
    last = at + BESIDE + 1
    s.swing = LEFT * s.lag.left * _swing(s, at - BESIDE, last, False)
    if s.count <= last:  # what a set that is missing had is not known
        s.swing = _swing(s, at - BESIDE, last + BESIDE, False)


@kernel
def doubt(s: State) -> float:
    """Return what the lag may still make of a voltage [V]."""
    return s.swing
