"""A drive of the truck: cycle, driver, plant and faults, sampled each 10 ms."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import f8, i8, kernel, record
from gateway_fdi.structure.file import load_model
from gateway_plants.truck.ecu import control as truck_control
from gateway_plants.truck.ecu import plant as truck_plant
from gateway_plants.truck.ecu.control import PERIOD
from gateway_plants.truck.ecu.cycles import speeds
from gateway_plants.truck.ecu.params import TruckFault, TruckParams
from gateway_plants.truck.ecu.plant import STEP

#: A sample: controls and what sensors without noise read; behind these the truth.
SAMPLE = record(
    i_b=f8,
    u_em=f8,
    i_em=f8,
    omega_e=f8,
    omega_gb=f8,
    volts=f8,
    ice=f8,
    clutch=f8,
    gear=i8,
    shifting=f8,
    brake=f8,
    v=f8,
    soc=f8,
    fuel=f8,
    locked=i8,
)


@kernel
def run(c: Any, p: Any, s: Any, u: Any, f: Any, e: Any, asked: Any, faults: Any, out: Any) -> None:
    """Drive.

    Args:
        c: constants of the plant.
        p: its state.
        s: state of the controller.
        u: commands.
        f: faults, written.
        e: electric quantities, written.
        asked: speed asked for at each sample, and for a second behind the end [m/s], shape (samples + 100,).
        faults: of each sample, shape (samples,) of :data:`truck_plant.FAULT`.
        out: of :data:`SAMPLE`, shape (samples,).
    """
    ahead = round(1.0 / PERIOD)
    for k in range(len(out)):
        now = faults[k]
        f.b_sc, f.pe, f.em_eta = now.b_sc, now.pe, now.em_eta
        f.em_R, f.em_U_sens = now.em_R, now.em_U_sens
        truck_control.control(c, p, s, asked[k], asked[k + ahead], e.i_em, u)
        omega_em = c.u_em * p.omega_w * c.u_f * c.ratio[u.gear - 1]
        truck_plant.electrics(c, p, u, f, omega_em, e)
        row = out[k]
        row.i_b, row.u_em, row.i_em = e.i_b, e.u_em + f.em_U_sens, e.i_em
        row.omega_e, row.omega_gb = p.omega_e, p.omega_w * c.u_f
        row.volts, row.ice, row.clutch, row.brake = u.volts, u.ice, u.clutch, u.brake
        row.gear, row.shifting = u.gear, s.shifting
        row.v, row.soc, row.fuel, row.locked = p.omega_w * c.r_w, p.soc, p.fuel, p.locked
        for _ in range(round(PERIOD / STEP)):
            truck_plant.step(c, p, u, f, e)


@dataclass(frozen=True)
class Drive:
    """A drive.

    Attributes:
        asked: speed asked for at each sample [m/s], shape (samples,).
        samples: of :data:`SAMPLE`, shape (samples,).
    """

    asked: NDArray[np.float64]
    samples: NDArray[np.void]


def drive(params: TruckParams, faults: Iterable[TruckFault], duration_s: float) -> Drive:
    """Drive the truck; the same arguments give the same drive."""
    model = load_model(shipped("models/truck.toml"))
    c, p, s, u, f, e = (
        np.zeros(1, dtype).view(np.recarray)
        for dtype in (
            truck_plant.CONST,
            truck_plant.STATE,
            truck_control.STATE,
            truck_plant.COMMAND,
            truck_plant.FAULT,
            truck_plant.ELECTRIC,
        )
    )
    truck_plant.prepare(c[0], model, params.disturbance)
    count = round(duration_s / PERIOD)
    times = np.arange(count + round(1.0 / PERIOD), dtype=np.float64) * PERIOD
    asked = speeds(params.cycle, times, params.start_s)
    rolling = asked[0] / float(c[0]["r_w"])
    p[0]["omega_w"], p[0]["soc"] = rolling, params.charge
    ratios = c[0]["ratio"] * c[0]["u_f"] * rolling
    high = np.flatnonzero(ratios >= truck_control.LEAST)
    s[0]["gear"] = 1 if not len(high) else int(high[-1]) + 1
    u[0]["gear"] = s[0]["gear"]
    p[0]["omega_e"] = max(float(c[0]["omega_e_idle"]), ratios[s[0]["gear"] - 1])
    active = np.zeros(count, truck_plant.FAULT).view(np.recarray)
    for fault in faults:
        first = round(fault.from_s / PERIOD)
        last = count if fault.to_s is None else round(fault.to_s / PERIOD)
        active[fault.field][first:last] = fault.amount
    out = np.zeros(count, SAMPLE).view(np.recarray)
    run(c[0], p[0], s[0], u[0], f[0], e[0], asked, active, out)
    return Drive(asked[:count], out)
