"""Hybrid truck on FTP75, through frames, database and engine."""

import functools

import numpy as np

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.ecu import frames_of
from gateway_plants.truck.ecu.params import TruckFault, TruckParams
from gateway_plants.truck.monitor.params import QUANTITIES

TRUCK = TruckParams(type="truck")

CONFIG = load_config(shipped("configs/truck.toml"))
UNISOLATED = "P1A1F-62"
NAMES = (*QUANTITIES, "T7")

#: Fault, its DTC, the tests that it fires: T1 to T4 of ICDS and MCDS, and T1, T2, T5, T6, T7.
TABLE = [
    ("machine_efficiency", "P1A12-64", (0, 0, 1, 1), (0, 0, 0, 0, 1)),
    ("machine_resistance", "P1A13-64", (0, 1, 1, 0), (0, 1, 1, 0, 0)),
    ("inverter_voltage", "P1A11-64", (1, 0, 1, 0), (1, 0, 1, 0, 0)),
    ("battery_short", "P1A10-01", (0, 1, 0, 1), (0, 1, 0, 1, 0)),
    ("machine_voltage_sensor", "P1A14-64", (1, 0, 0, 1), (1, 0, 0, 1, 0)),
]


@functools.lru_cache(maxsize=2)
def driven(fault=None, onset=0.0, seconds=1874.0, truck=TRUCK):
    """A drive."""
    faults = () if fault is None else (TruckFault(kind=fault, from_s=onset),)
    return drive(truck, faults, seconds)


def configured(**changes):
    """The shipped configuration with other parameters of its monitor."""
    (entry,) = CONFIG.monitor
    return CONFIG.model_copy(update={"monitor": (entry.model_copy(update=changes),)})


def run(drive_, seed, config=CONFIG, change=lambda frames: frames, truck=TRUCK):
    """Largest T_norm of each quantity, number of sets, and the DTC events with seconds since the begin."""
    frames = change(frames_of(truck, drive_, bus=0, rng=np.random.default_rng(seed)))
    frames["t_ns"] += 10**9
    gateway = Gateway(config)
    events = []
    gateway.listen(lambda e: events.append(e) if e["event"] == "dtc" else None)
    gateway.start(10**9)
    for k in range(0, len(frames), 100_000):
        gateway.feed(frames[k : k + 100_000])
    state = gateway.engine.state_of(0)[0]
    peaks = (*state["cusum"]["peak"], state["observer"]["peak"])
    found = dict(zip(NAMES, map(float, peaks), strict=True)), int(state["sets"])
    gateway.close()
    return *found, [((e["t_ns"] - 10**9) / 1e9, e["dtc"], e["status"] & 1) for e in events]


def fired(peak):
    """Tests that have fired, in the order of NAMES."""
    return tuple(int(peak[name] > 1) for name in NAMES)


def fired_of_paper(peak):
    """Likewise of ICDS and of MCDS."""
    static = (peak["T1"] > 1, peak["T2"] > 1)
    integral = (max(peak[f"{t}_signed"], peak[f"{t}_absolute"]) > 1 for t in ("T3", "T4"))
    mixed = (peak[f"{t}_mixed"] > 1 for t in ("T3", "T4"))
    return tuple(tuple(map(int, (*static, *rest))) for rest in (integral, mixed))
