"""Which fault of which plant, and which component that is.

Everything is read from the shipped files: plants, their inputs, the kinds and sizes of their faults from scenarios, the
monitors from configurations. What is written here is only which component each fault is of: as its model or scenario
says it in words, not as a monitor does.
"""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from gateway_fdi.common.resources import all_shipped, shipped
from gateway_fdi.structure.decomposition import overdetermined
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.incidence import counted
from gateway_fdi.structure.isolability import incidence_of_faults

#: Components, each of which is right: nobody could tell them apart.
Truth = frozenset[str]


@dataclass(frozen=True)
class Fault:
    """A fault as a scenario has it.

    Attributes:
        plant: which.
        base: scenario that it is put into, without its own faults.
        name: for people.
        entry: keys of the scenario's table fault, with from_s, to_s.
        truth: the component that is at fault.
    """

    plant: str
    base: str
    name: str
    entry: dict[str, Any] = field(hash=False)
    truth: Truth

    @property
    def of_frames(self) -> bool:
        """Whether it is one of a message's frames, not of a value."""
        return "message" in self.entry

    @property
    def lasts_s(self) -> float:
        """How long it is there [s]."""
        return float(self.entry["to_s"]) - float(self.entry["from_s"])


def read(name: str) -> dict[str, Any]:
    """Return a scenario as it is written."""
    return tomllib.loads(shipped(f"scenarios/{name}.toml").read_text())


def _one(*names: str) -> Truth:
    return frozenset(names)


#: Fault of a structural model -> known variable of its sensor; all others are of the plant.
_SENSORS = {
    "tanks": {"f_1": "y1", "f_2": "y2", "f_3": "y3"},
    "motor": {"f_i": "i", "f_w": "w"},
    "brake": {"f_i": "i", "f_a": "a", "f_F": "c"},
    "cooling": {"f_1": "y1", "f_2": "y2", "f_3": "y3", "f_m": "ym"},
    "battery": {"f_I": "y_I", "f_V": "y_V", **{f"f_y{k}": f"y{k}" for k in range(1, 5)}},
}
#: Residuals that a fault of the steering shows in, as its equations have it (docs/steering/steering.md).
_SHOWS = {
    "wheel_angle_offset": {"gear", "rate"},
    "pinion_angle_offset": {"gear"},
    "current_offset": {"voltages"},
    "voltage_offset": {"voltages"},
    "motor_angle": {"gear", "voltages", "increments"},  # however it fails
}
#: Kind of a fault of the steering -> its component.
_STEERING = {
    "wheel_angle_offset": _one("signal chassis.SAS_Angle.Delta_S"),
    "pinion_angle_offset": _one("signal chassis.AFS_Angle.Delta_G"),
    "current_offset": _one("signal chassis.AFS_MotCur.I_U", "signal chassis.AFS_MotCur.I_V"),
    "voltage_offset": _one(
        "actuator steering.inverter", "signal chassis.AFS_MotVol.U_sd_mean", "signal chassis.AFS_MotVol.U_sq_mean"
    ),
    "motor_angle": _one("sensor steering.motor angle"),
}
_TRUCK = {
    "battery_short": _one("plant powertrain.battery"),
    "inverter_voltage": _one("actuator powertrain.inverter"),
    "machine_efficiency": _one("plant powertrain.machine"),
    "machine_resistance": _one("plant powertrain.machine"),
    "machine_voltage_sensor": _one("signal powertrain.HEV_SENS_ELEC.U_em_sens"),
}
#: Plant -> bus, its commands, its sensors' signals.
_LINEAR = {
    "aircraft": (
        "flight",
        ("Aircraft_Command.Rudder", "Aircraft_Command.Aileron"),
        ("Aircraft_Sensors.Roll", "Aircraft_Sensors.RollRate", "Aircraft_Sensors.YawRate"),
    ),
    "belt": (
        "machine",
        ("Belt_Command.Voltage",),
        ("Belt_Sensors.MotorSpeed", "Belt_Sensors.LoadSpeed", "Belt_Sensors.Current"),
    ),
}


#: Plant -> its family, whose monitors are of one kind; of the others each is one of its own.
FAMILIES = dict.fromkeys(_SENSORS, "structural") | dict.fromkeys(_LINEAR, "linear")


def _bus(base: str) -> str:
    config = shipped(f"configs/{read(base)['config'].rpartition('/')[2]}")
    return str(tomllib.loads(config.read_text())["bus"][0]["name"])


def _structural(plant: str) -> Iterator[Fault]:
    base = f"{plant}_faults"
    for entry in read(base)["fault"]:
        yield Fault(plant, base, entry["name"], entry, _structural_part(plant, entry["name"]))


def _structural_part(plant: str, fault: str) -> Truth:
    """Return the component that a fault of a model is of."""
    base = f"{plant}_faults"
    sent = {known: f"{m['name']}.{s}" for m in read(base)["ecu"][0]["message"] for s, known in m["signals"].items()}
    known = _SENSORS[plant].get(fault)
    return _one(f"signal {_bus(base)}.{sent[known]}" if known else f"plant {plant}.{fault}")


def _linear(plant: str) -> Iterator[Fault]:
    bus, inputs, outputs = _LINEAR[plant]
    base = f"linear_{plant}_faults"
    for entry in read(base)["fault"]:
        place = entry["place"] - 1
        of_sensor = entry["kind"].startswith("output")
        part = f"signal {bus}.{outputs[place]}" if of_sensor else f"actuator {bus}.{inputs[place]}"
        yield Fault(plant, base, f"{entry['kind']} {place + 1}", entry, _one(part))


def _steering() -> Iterator[Fault]:
    for base in ("steering_parts", "steering_angle"):
        for entry in read(base)["fault"]:
            kind = entry["kind"]
            truth = _STEERING["motor_angle" if kind.startswith("motor_angle") else kind]
            yield Fault("steering", base, kind, {**entry, "to_s": entry.get("to_s", 12.0)}, truth)


def _truck() -> Iterator[Fault]:
    for kind, truth in _TRUCK.items():
        own = read(f"truck_{kind}")
        base = next(b for b in map("truck_{}".format, _TRUCK) if read(b)["ecu"] == own["ecu"])  # of the same drive
        for entry in own["fault"]:
            yield Fault("truck", base, kind, {**entry, "to_s": own["duration_s"]}, truth)


def _pedal() -> Iterator[Fault]:
    for entry in read("pedal_faults")["fault"]:
        if len(entry["channel"]) == 1 and entry.get("size") != -0.08:  # two channels at once are no single fault
            channels = (1, 2) if entry["kind"] == "drift" else entry["channel"]  # both drift apart alike
            truth = _one(*(f"signal chassis.PED_Brake.Ch{k}" for k in channels))
            yield Fault("pedal", "pedal_faults", f"{entry['kind']} {entry['channel'][0]}", entry, truth)
    for entry in read("pedal_three")["fault"]:
        message = {"brake": "PED_Brake3", "accelerator": "PED_Accelerator"}[entry["ecu"]]
        truth = _one(f"signal chassis.{message}.Ch{entry['channel'][0]}")
        name = f"{entry['ecu']} {entry['kind']}"
        yield Fault("pedal", "pedal_three", name, {**entry, "to_s": entry["from_s"] + 2.5}, truth)


#: Signals that only one rule relates with each other: which of them is off nobody can tell.
_RELATED = (
    _one("signal chassis.WheelSpeeds.FL", "signal chassis.WheelSpeeds.FR"),
    _one("signal chassis.WheelSpeeds.RL", "signal chassis.WheelSpeeds.RR", "signal chassis.Vehicle.Speed"),
)


def _alike(entry: dict[str, Any]) -> Truth:
    own = _one(f"signal chassis.{entry['signal']}")
    related = (group for group in _RELATED if own <= group)
    return next(related, own) if entry["kind"] == "offset" else own


def _signals() -> Iterator[Fault]:
    for entry in read("signals_faults")["fault"]:
        truth = _alike(entry)
        if entry["signal"] == "Climate.Page":  # it says which signal comes
            truth |= _one("signal chassis.Climate.Outside")
        yield Fault("signals", "signals_faults", f"{entry['kind']} {entry['signal']}", entry, truth)


#: Messages of the vehicle, or who sends them: Brakes sends nothing else, of Body nothing else is watched.
_SENDS = {
    "WheelSpeeds": _one("message chassis.WheelSpeeds", "ecu chassis.Brakes"),
    "Vehicle": _one("message chassis.Vehicle", "ecu chassis.Body"),
}


#: Offsets of the rest bus [km/h].
_OFFSETS = {
    "WheelSpeeds.FL": 60,
    "WheelSpeeds.FR": -60,
    "WheelSpeeds.RL": 40,
    "WheelSpeeds.RR": -40,
    "Vehicle.Speed": 30,
}


def _restbus() -> Iterator[Fault]:
    base, at = "restbus", {"from_s": 6.0, "to_s": 12.0}
    for entry in read(base)["fault"]:
        if "signal" in entry:
            yield Fault(base, base, f"{entry['kind']} {entry['signal']}", entry, _alike(entry))
    for kind, messages in (("lost", _SENDS), ("checksum", ("Vehicle",)), ("counter", ("Vehicle",))):
        for message in messages:
            yield Fault(base, base, f"{kind} {message}", {"kind": kind, "message": message, **at}, _SENDS[message])
    for signal, size in _OFFSETS.items():
        entry = {"kind": "offset", "signal": signal, "size": size, **at}
        yield Fault(base, base, f"offset {signal}", entry, _alike(entry))


def faults() -> list[Fault]:
    """Return all faults of all plants that are there."""
    of_plants: dict[str, Iterable[Callable[[], Iterable[Fault]]]] = {
        "structural": (partial(_structural, plant) for plant in _SENSORS),
        "linear": (partial(_linear, plant) for plant in _LINEAR),
        "steering": (_steering,),
        "truck": (_truck,),
        "pedal": (_pedal,),
    }
    there = [made for plant, made in of_plants.items() if all_shipped(f"scenarios/{plant}", ".toml")]
    return [*(fault for made in there for each in made for fault in each()), *_signals(), *_restbus()]


def alike(one: Fault, other: Fault) -> frozenset[Truth]:
    """Return what explains all that two faults do, whatever their sizes and courses: other parts, two at most.

    By the structure of the model (Krysander, Frisk 2008): without the equations that these parts stand in, nothing
    overdetermined is left that one of the two faults stands in. Where residuals are known instead of a model: these
    parts stand in all in which the faults show.
    """
    if one.plant in _SENSORS:
        found = _alike_in_model(one.plant, {one.name, other.name})
    else:
        shows, stands = _residuals(one.plant)
        if not {one.name, other.name} <= shows.keys():
            return frozenset()
        seen = shows[one.name] | shows[other.name]
        found = {parts for parts in _some(stands) if seen <= frozenset().union(*(stands[part] for part in parts))}
    own = set(itertools.product(one.truth, other.truth))
    whole = {frozenset(parts) for parts in found} - {frozenset(parts) for parts in own}
    return frozenset(parts for parts in whole if not any(less < parts for less in whole))


def _alike_in_model(plant: str, own: set[str]) -> set[tuple[str, ...]]:
    model = load_model(shipped(f"models/{plant}.toml"))
    where = dict(zip(model.faults, incidence_of_faults(model).T, strict=True))
    mine = np.any([where[name] for name in own], axis=0)

    def explain(names: tuple[str, ...]) -> bool:
        without = ~np.any([where[name] for name in names], axis=0)
        return not (overdetermined(counted(model), without) & mine).any()

    part = {name: next(iter(_structural_part(plant, name))) for name in model.faults}
    return {tuple(part[name] for name in names) for names in _some(model.faults) if explain(names)}


def _residuals(plant: str) -> tuple[dict[str, Truth], dict[str, Truth]]:
    """Return the residuals in which each fault shows, and in which each part stands; none: they are not known."""
    shows: dict[str, Truth] = {}
    stands: dict[str, Truth] = {}
    for fault in _steering() if plant == "steering" else _pedal() if plant == "pedal" else ():
        if plant == "steering":
            name = "motor_angle" if fault.name.startswith("motor_angle") else fault.name
            shown = {part: frozenset(_SHOWS[name]) for part in fault.truth}
        elif fault.base == "pedal_faults":  # two channels are compared; what is out of range shows by itself
            out = fault.entry["kind"].startswith("short")
            shown = {part: frozenset({"two", part} if out else {"two"}) for part in fault.truth}
        else:
            continue
        shows[fault.name] = frozenset().union(*shown.values())
        for part, residuals in shown.items():
            stands[part] = stands.get(part, frozenset()) | residuals
    return shows, stands


def _some(names: Iterable[str]) -> Iterator[tuple[str, ...]]:
    """Yield one or two of some faults."""
    listed = list(names)
    return itertools.chain(((name,) for name in listed), itertools.combinations(listed, 2))


def drawn(fault: Fault, rng: np.random.Generator) -> dict[str, Any]:
    """Return a fault as it is put in: it begins up to a fifth of its length later, and is up to half as large again."""
    entry = copy.deepcopy(fault.entry)
    entry["from_s"] = round(entry["from_s"] + rng.uniform(0.0, 0.2) * fault.lasts_s, 3)
    if (entry.get("size") and entry["kind"] in ("offset", "drift")) or entry["kind"].endswith(("_offset", "_drift")):
        entry["size"] = round(float(entry["size"]) * rng.uniform(1.0, 1.5), 6)
    return entry
