"""Frames of this truck: own database and names, an encoder checked against cantools, a configuration, replays."""

import cantools
import numpy as np
from truck.plant import CHARGE, COLUMNS, INERTIAS, LOSS, PARAMETERS, RATIOS, VOLTS

from gateway.bus.frames import FRAME
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_plants.truck.monitor import messages
from gateway_plants.truck.monitor.monitor import MONITOR
from gateway_replay.replay import replay

#: Message: identifier, signals (name, column or other, bits, signed, resolution).
MESSAGES = {
    "PCU_Set": (
        0x310,
        [
            ("UReq", "U_em_ctrl", 16, 1, 0.02),
            ("Fuel", "ice_ctrl", 16, 0, 2.0),
            ("Clu", "u_c", 8, 0, 0.004),
            ("GearAct", "gear", 4, 0, 1.0),
        ],
    ),
    "EBS_Set": (0x311, [("TBrk", "T_b_ctrl", 16, 0, 1.0), ("Grad", "alpha", 16, 1, 1e-5)]),
    "PCU_Act": (0x320, [("IBat", "I_b", 16, 1, 0.05), ("UMot", "U_em", 16, 1, 0.05), ("IMot", "I_em", 16, 1, 0.05)]),
    "DRV_Act": (
        0x321,
        [("NEng", "omega_e", 16, 0, 0.01), ("NOut", "omega_gb", 16, 1, 0.01), ("SoC0", "soc0", 8, 0, 0.005)],
    ),
}
UNITS = {
    "UReq": "V",
    "Fuel": "J",
    "TBrk": "Nm",
    "Grad": "rad",
    "IBat": "A",
    "UMot": "V",
    "IMot": "A",
    "NEng": "rad/s",
    "NOut": "rad/s",
}
#: Input of the monitor -> signal here.
SIGNALS = {
    "U_em_ctrl": "PCU_Set.UReq",
    "ice_ctrl": "PCU_Set.Fuel",
    "u_c": "PCU_Set.Clu",
    "gear": "PCU_Set.GearAct",
    "count_pt": "PCU_Set.Seq",
    "T_b_ctrl": "EBS_Set.TBrk",
    "alpha": "EBS_Set.Grad",
    "count_veh": "EBS_Set.Seq",
    "I_b_sens": "PCU_Act.IBat",
    "U_em_sens": "PCU_Act.UMot",
    "I_em_sens": "PCU_Act.IMot",
    "count_elec": "PCU_Act.Seq",
    "omega_e_sens": "DRV_Act.NEng",
    "omega_gb_sens": "DRV_Act.NOut",
    "charge": "DRV_Act.SoC0",
    "count_mech": "DRV_Act.Seq",
}
#: White noise at 100 Hz, and largest bias, of the sensors.
NOISE = {"I_b": (1.0, 0.3), "U_em": (1.0, 0.3), "I_em": (1.5, 0.4), "omega_e": (0.5, 0.3), "omega_gb": (0.2, 0.0)}
#: Faults of the monitor by the plant's name.
NAMES = {
    "battery": "battery_short",
    "inverter": "inverter_voltage",
    "efficiency": "machine_efficiency",
    "resistance": "machine_resistance",
    "sensor": "machine_voltage_sensor",
}


def database():
    lines = ['VERSION ""', "", "BU_: TRUCK GW", ""]
    for name, (can_id, signals) in MESSAGES.items():
        lines.append(f"BO_ {can_id} {name}: 8 TRUCK")
        at = 0
        for signal, _, bits, signed, step in signals:
            lines.append(
                f' SG_ {signal} : {at}|{bits}@1{"-" if signed else "+"} ({step!r},0) [0|0] "{UNITS.get(signal, "")}" GW'
            )
            at += bits
        lines += [' SG_ Seq : 56|8@1+ (1,0) [0|255] "" GW', ""]
    return "\n".join(lines)


def read_by_sensors(rows, given, rng, errors=None, late=0):
    """Return columns as the bus has them: bias, gain, noise; the voltage sensor's fault.

    ``errors``: bias and gain by name, drawn if not given; ``late``: sets by which the electric sensors are.
    """
    columns = {name: rows[:, k].copy() for k, name in enumerate(COLUMNS)}
    for name, (noise, most) in NOISE.items():
        gain = rng.uniform(-0.002, 0.002) * (name not in ("omega_e", "omega_gb"))
        bias = rng.uniform(-most, most)
        if errors is not None:
            bias, gain = errors.get(name, (0.0, 0.0))
        if name in ("I_b", "U_em", "I_em"):
            columns[name] = np.concatenate([np.full(late, rows[0, COLUMNS.index(name)]), columns[name]])[: len(rows)]
        columns[name] = columns[name] * (1.0 + gain) + bias + rng.normal(0.0, noise, len(rows))
    columns["omega_e"] = np.maximum(columns["omega_e"], 0.0)
    columns["U_em"] += given[:, 4]
    columns["soc0"] = np.full(len(rows), rows[0, COLUMNS.index("soc")])
    return columns


def encode(columns):
    """Return all frames in order of time, four a set."""
    count = len(columns["gear"])
    frames = np.zeros((count, len(MESSAGES)), FRAME)
    for m, (can_id, signals) in enumerate(MESSAGES.values()):
        mine = frames[:, m]
        mine["t_ns"] = 1_000_000_000 + np.arange(count) * 10_000_000 + m * 250_000
        mine["can_id"], mine["length"] = can_id, 8
        word, at = np.zeros(count, np.uint64), 0
        for _, column, bits, _, step in signals:
            raw = np.round(columns[column] / step).astype(np.int64) & (2**bits - 1)
            word |= raw.astype(np.uint64) << np.uint64(at)
            at += bits
        word |= (np.arange(count) % 256).astype(np.uint64) << np.uint64(56)
        mine["data"][:, :8] = word.view(np.uint8).reshape(count, 8)
        frames[:, m] = mine
    return frames.ravel()


def decoded(frame):
    message = cantools.database.load_string(database(), "dbc").get_message_by_frame_id(int(frame["can_id"]))
    return message.name, message.decode(bytes(frame["data"][:8]))


def told_names():
    """Return the monitor's own name of each signal, the counters' among them."""
    counters = zip(("count_pt", "count_veh", "count_elec", "count_mech"), messages.MESSAGES, strict=True)
    connected = {key: signal.name for key, signal in MONITOR.connect(None).items()}
    return connected | {key: f"{message}.FrameCnt" for key, message in counters}


def _inline(table):
    return "{ " + ", ".join(f"{k} = {v}" for k, v in table.items()) + " }"


def configuration(folder, extra=""):
    """Write database and configuration; returns the latter's path."""
    (folder / "truck.dbc").write_text(database())
    tables = {
        "f_1": (CHARGE, VOLTS),
        "f_2": (np.arange(1, len(INERTIAS) + 1), INERTIAS),
        "f_3": (np.arange(1, len(RATIOS) + 1), RATIOS),
    }
    told = {**PARAMETERS, "T_l0": LOSS[0], "T_lg": LOSS[1], "T_lw": LOSS[2], "n_g": float(len(RATIOS))}
    lines = [
        'name = "bench"',
        '[[bus]]\nname = "can"\nuri = "loopback:127.0.0.1:29778"\ndatabase = ["truck.dbc"]',
        '[[monitor]]\nname = "m"\ntype = "hybrid_powertrain"',
        f"parameters = {_inline(told)}",
        "signals = " + _inline({f'"{name}"': f'"{SIGNALS[key]}"' for key, name in told_names().items()}),
        extra,
    ]
    for name, (x, y) in tables.items():
        lines.append(f"[monitor.tables.{name}]\nx = {[float(v) for v in x]}\ny = {[float(v) for v in y]}")
    path = folder / "truck.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def run(path, frames):
    """Replay frames as ``gateway replay`` does; returns (seconds, fault, failed) of each change, and the summary."""
    gateway = Gateway(load_config(path), None, file=path)
    events = []
    gateway.listen(events.append)
    try:
        replay(gateway, [frames[k : k + 100_000] for k in range(0, len(frames), 100_000)])
        state = gateway.engine.state_of(0)[0].copy()
    finally:
        gateway.close()
    begun = int(frames[0]["t_ns"])
    found = [
        ((e["t_ns"] - begun) * 1e-9, e["fault"].removeprefix("m."), e["status"] & 1)
        for e in events
        if e["event"] == "dtc" and e["fault"].startswith("m.")
    ]
    return found, state
