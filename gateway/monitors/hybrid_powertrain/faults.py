"""What a hybrid powertrain can have: the five faults of paper 004, (13), and those that the tests do not tell apart."""

from __future__ import annotations

from gateway.monitors.shape import Debounce, Fault

#: Faults by their place: those of the structural model in its order, and what is not isolated.
BATTERY, INVERTER, EFFICIENCY, RESISTANCE, SENSOR, UNISOLATED = range(6)

#: Names in the structural model.
STRUCTURAL = ("f_b_sc", "f_pe", "f_em_eta", "f_em_R", "f_em_U_sens")

_EVIDENCE = (
    "T_norm of T1",
    "T_norm of T2",
    "T_norm of T3",
    "T_norm of T4",
    "tests that have fired (T1 is 1, T2 2, T3 4, T4 8)",
    "faults that would explain them (battery is 1, inverter 2, ...)",
    "T_norm of T3, mixed causality",
    "T_norm of T4, mixed causality",
)

_FOUND = Debounce(failed_after=1, passed_after=10)

#: Manufacturer's powertrain codes; failure types of SAE J2012-DA.
_ROWS = (
    ("battery_short", "P1A10-01", "hybrid battery: cells in short circuit"),
    ("inverter_voltage", "P1A11-64", "power electronics: voltage is not what was asked for"),
    ("machine_efficiency", "P1A12-64", "electric machine: torque is not what its current makes"),
    ("machine_resistance", "P1A13-64", "electric machine: current is not what its voltage makes"),
    ("machine_voltage_sensor", "P1A14-64", "electric machine: voltage sensor"),
    ("unisolated", "P1A1F-62", "hybrid powertrain: a fault that is not isolated (yet)"),
)

FAULTS = tuple(Fault(name, dtc, text, _EVIDENCE, _FOUND) for name, dtc, text in _ROWS)
