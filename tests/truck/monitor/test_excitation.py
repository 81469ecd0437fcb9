"""Internal forms: (40) corrected, and what updating by them is good for (paper 004, VI-D; Figs. 5 and 9)."""

from itertools import pairwise

import numpy as np
import pytest
from amount import amount

from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED, zeros
from gateway_fdi.structure.file import load_model
from gateway_plants.truck.ecu import plant as truck_plant
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.params import TruckFault
from gateway_plants.truck.study.conditions import CONDITIONS, compare
from gateway_plants.truck.study.follow import inputs
from gateway_plants.truck.study.paper import RESIDUALS, Paper, follow
from gateway_plants.truck.study.table import TRUCK

pytestmark = pytest.mark.skipif(not COMPILED, reason="hundreds of thousands of sets")
SENSOR = TruckFault(kind="machine_voltage_sensor")


def internal(samples, volts, *, printed):
    """(40) over a window without noise: corrected, with the leakage of the air drag, or as printed; r [rad/s],
    shape (n,).
    """
    model = load_model(shipped("models/truck.toml"))
    p = {name: q.value for name, q in model.quantities.items()}
    inertia, ratio = model.tables["f_2"].y, model.tables["f_3"].y
    plant = zeros(1, truck_plant.CONST)[0]
    truck_plant.prepare(plant, model, truck_plant.Disturbance())
    r, rows = 0.0, []
    for row in samples:
        rows.append(r)
        gear = int(row["gear"]) - 1
        u, turning = ratio[gear], inertia[gear] + p["J_em"] + p["J_c"] + p["J_e"]
        mass = p["m_v0"] - row["fuel"]
        total = u**2 * turning * p["u_f"] ** 2 + mass * p["r_w"] ** 2
        share = p["eta_em_0"] if row["i_em"] > 0 else 1.0 / p["eta_em_0"]
        machine = row["i_em"] * p["k_i"] * share - p["c_em_f"] * row["omega_e"]
        torque = truck_plant.engine_torque(plant, row["ice"], row["omega_e"]) + machine
        loss = 8.0 + 0.6 * (11 - gear) + 0.08 * row["omega_e"]
        eta = p["eta_pos"] if torque > loss else p["eta_neg"]
        gain = p["u_f"] ** 2 * p["k_i"] * eta / total
        fault = volts / (volts + 1.0) if printed else volts / row["u_em"]
        drive = gain * fault * u * row["i_em"] * share
        omega = row["omega_gb"] / p["u_f"]
        leak = p["rho"] * p["C_d"] * p["A_f"] * p["r_w"] ** 3 * omega / total
        r += 0.01 * (drive if printed else drive - leak * r)
    return np.array(rows)


@pytest.mark.long
def test_the_internal_form_of_the_voltage_sensors_fault():
    """The window of 110 s that begins at 203 s, most of it in gear 12: within 5 % of the
    largest residual; as printed far from it."""
    truck = TRUCK.model_copy(update={"noise_factor": 0.0})
    trace = follow(inputs(truck, SENSOR, 1), Paper(), keep=True).trace
    samples = drive(truck, (SENSOR,), 400.0).samples
    edges = np.flatnonzero(np.diff(trace.settled[:40_000].astype(int))) + 1
    first, last = next((a, b) for a, b in pairwise(edges) if trace.settled[a] and trace.t[b] - trace.t[a] > 80.0)
    assert 200.0 < trace.t[first] < 210.0
    assert np.median(samples["gear"][first:last]) == 12
    four = trace.residual[:, RESIDUALS.index("T4_ICDS")]
    residual = four[first:last] - four[first]
    largest = np.abs(residual).max()
    assert largest > 1.0
    wrong = np.abs(internal(samples[first:last], 20.0, printed=False) - residual).max()
    print(f"largest residual {largest:.3f}, (40) corrected is off by {wrong:.4f}")
    assert wrong < 0.05 * largest
    printed = np.abs(internal(samples[first:last], 20.0, printed=True) - residual).max()
    assert printed > 3.0 * largest


@pytest.mark.long
def test_with_noise_only_41_stays_above_its_threshold():
    """Noise five times, J_1 = 6000 As (4000 is less than this noise): share of the drive with T_norm > 1."""
    for seed in range(9000, 9000 + amount(20, 2)):
        found = compare(SENSOR, seed)
        on = dict(zip(CONDITIONS, found.on, strict=True))
        print(seed, on)
        assert on["(41)"] >= 0.95
        assert max(on["(39)"], on["(45)"], on["always"]) < 0.5
        assert found.down[1] < min(found.down[0], *found.down[2:])
