"""Frames of virtual ECUs stay as they are, bit by bit and to the nanosecond: every course, and every kind of fault."""

from pathlib import Path
from typing import get_args

from kept import kept

from gateway.bus.frames import payload
from gateway_bench.vecu.message_faults import SIZED, EcuKind, MessageFault, SignalKind
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario, WireFault
from gateway_bench.vecu.table.params import TableFault
from gateway_fdi.common.resources import shipped

RESTBUS = {
    "type": "restbus",
    "cycle_ms": 50.0,
    "jitter_ms": 0.2,
    "message": [{"name": "Vehicle", "period_ms": 100.0, "e2e": {"profile": "P01", "data_id": 0x200}}],
    "signals": {
        "Vehicle.Speed": {"sine": {"mean": 60, "amplitude": 30, "period_s": 5}},
        "Vehicle.Gear": 3,
        "Vehicle.Coolant": {"ramp": {"start": 20, "end": 90, "in_s": 3}},
        "WheelSpeeds.FL": {"expression": "Vehicle.Speed / 2", "noise": 0.1},
        "WheelSpeeds.FR": [[0, 0], [2, 60], [5, 10]],
    },
}
TABLE = {
    "type": "table",
    "message": [
        {"name": "WheelSpeeds", "period_ms": 50.0, "signals": {"FL": [[0, 5], [4, 60]], "FR": 7}, "noise": {"FL": 0.5}},
        {"name": "Climate", "period_ms": 100.0, "signals": {"Cabin": 21}, "turns": {"Page": [0, 1]}},
    ],
}


def kinds_of(model):
    return get_args(model.model_fields["kind"].annotation)


def message_faults():
    """Yield a fault of each kind, one after the other."""
    for k, kind in enumerate(kinds_of(MessageFault)):
        fault = {"kind": kind, "from_s": 0.5 + 0.3 * k, "to_s": 0.75 + 0.3 * k}
        if kind in get_args(SignalKind):
            fault["signal"] = "Vehicle.Coolant"
        elif kind not in get_args(EcuKind):
            fault["message"] = "Vehicle"
        size = 3.0 if kind in SIZED else {"out_of_range": 150.0, "sna": 215.0}.get(kind)
        yield fault | {"size": size, "delay_ms": 60.0, "period_ms": 20.0, "probability": 0.9}


def frames(ecu, **more):
    """Return what is sent, and what was injected, a line each."""
    duration_s = 6.0
    scenario = Scenario(name="s", duration_s=duration_s, seed=7, ecu=[ecu], **more)
    player = Player(scenario, {"can": 0}, databases={0: (shipped("dbc/vehicle.dbc"),)})
    sent = [frame for _, batch in player.batches() for frame in batch]
    player.close()
    found = [f"{f['t_ns']} {f['can_id']:X} {f['flags']} {bytes(payload(f)).hex()}" for f in sent]
    return [*found, *(f"{fact.t_ns} {fact.kind} {fact.tooth}" for fact in player.truth)]


def test_every_frame_is_that_of_before():
    table = [
        {"kind": kind, "signal": "WheelSpeeds.FR", "from_s": 0.5 + k, "to_s": 1.0 + k, "size": 2.0}
        for k, kind in enumerate(kinds_of(TableFault))
    ]
    wire = [
        {"kind": kind, "from_s": 0.5 + 0.6 * k, "to_s": 1.0 + 0.6 * k, "probability": 0.7, "delay_ms": 60.0}
        for k, kind in enumerate(kinds_of(WireFault))
    ]
    lines = [
        *frames(RESTBUS, fault=list(message_faults())),
        *frames(TABLE, fault=table),
        *frames(TABLE, wire=wire),
    ]
    assert lines == kept(Path(__file__).with_name("frames.txt"), "\n".join(lines).encode()).decode().splitlines()
