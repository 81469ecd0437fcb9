"""What a hybrid powertrain can have: the five faults of paper 004, (13), and those that the tests do not tell apart."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from gateway.monitors.contract import TOGETHER, VAGUE, Blame, Debounce, Fault
from gateway.monitors.evidence import as_bits, as_digits

#: Faults by their place: those of the structural model in its order, and what is not isolated.
BATTERY, INVERTER, EFFICIENCY, RESISTANCE, SENSOR, UNISOLATED = range(6)

#: Names in the structural model.
STRUCTURAL = ("f_b_sc", "f_pe", "f_em_eta", "f_em_R", "f_em_U_sens")

_FOUND = Debounce(failed_after=1, passed_after=10)

#: What a verdict rests on.
_LARGEST = "largest test against its limit [times]"

#: Manufacturer's powertrain codes; failure types of SAE J2012-DA.
_ROWS = (
    ("battery_short", "P1A10-01", "hybrid battery: cells in short circuit"),
    ("inverter_voltage", "P1A11-64", "power electronics: voltage is not what was asked for"),
    ("machine_efficiency", "P1A12-64", "electric machine: torque is not what its current makes"),
    ("machine_resistance", "P1A13-64", "electric machine: current is not what its voltage makes"),
    ("machine_voltage_sensor", "P1A14-64", "electric machine: voltage sensor"),
    ("unisolated", "P1A1F-62", "hybrid powertrain: a fault that is not isolated (yet)"),
)


def faults_of(tests: tuple[str, ...]) -> tuple[Fault, ...]:
    """Return what these tests can report, with its evidence."""
    names = ("battery", "inverter", "efficiency of the machine", "resistance of the machine", "voltage sensor")
    evidence = (
        *(f"test {name} against its limit [times]" for name in tests),
        as_bits("tests that have fired", tests),
        as_digits("faults that explain them, likeliest first", names, 1),
        "error of the machine's torque as motor, estimated by test T7",
    )
    return tuple(Fault(name, dtc, text, evidence, _FOUND, tested=_LARGEST) for name, dtc, text in _ROWS)


#: What each fault blames, as the structural model has it.
BLAMES: dict[str, tuple[Blame, ...]] = {
    "battery_short": (Blame("battery", "plant"),),
    "inverter_voltage": (Blame("inverter", "actuator"),),
    "machine_efficiency": (Blame("machine", "plant"),),
    "machine_resistance": (Blame("machine", "plant"),),
    "machine_voltage_sensor": (Blame("HEV_SENS_ELEC.U_em_sens"),),
}
_PARTS = tuple(dict.fromkeys(one for blamed in BLAMES.values() for one in blamed))
BLAMES = {
    name: (*blamed, *(one._replace(share=TOGETHER) for one in _PARTS if one not in blamed))
    for name, blamed in BLAMES.items()
}
BLAMES["unisolated"] = (*(one._replace(share=VAGUE) for one in _PARTS), Blame("model", "model"))

#: How likely a test fires if a fault is there that it sees.
_FIRES = 0.8


def behind(seen: Mapping[str, Iterable[str]]) -> dict[str, list[Blame]]:
    """Return whom each test blames: the parts of the faults that it sees, by their names in the structural model."""
    parts = dict(zip(STRUCTURAL, (blamed[0] for name, blamed in BLAMES.items() if name != "unisolated"), strict=True))
    return {
        test: [
            *dict.fromkeys(parts[f]._replace(share=_FIRES) for f in STRUCTURAL if f in faults),
            Blame("model", "model"),
        ]
        for test, faults in seen.items()
    }
