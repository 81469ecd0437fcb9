"""Frames of these plants: an own database, an encoder that is checked against cantools, configurations, replays."""

import cantools
import numpy as np

from gateway.bus.frames import FRAME
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_replay.replay import replay

COMMAND, SENSORS = 0x2A0, 0x2A1


def database(plant):
    """Return the text of the plant's database: commands and sensors, each with an alive counter, 24 bits a signal."""
    lines = ['VERSION ""', "", "BU_: PLANT GW", ""]
    m = len(plant.inputs)
    for can_id, name, signals, resolution in (
        (COMMAND, "Cmd", plant.inputs, plant.resolution[:m]),
        (SENSORS, "Sens", plant.outputs, plant.resolution[m:]),
    ):
        lines.append(f"BO_ {can_id} {name}: 16 PLANT")
        lines.append(' SG_ Cnt : 0|4@1+ (1,0) [0|15] "" GW')
        for k, (signal, step) in enumerate(zip(signals, resolution, strict=True)):
            lines.append(f' SG_ {signal} : {8 + 24 * k}|24@1- ({step!r},0) [0|0] "" GW')
        lines.append("")
    return "\n".join(lines)


def _encoded(can_id, values, resolution, stamps, counters):
    frames = np.zeros(len(values), FRAME)
    frames["t_ns"], frames["can_id"], frames["flags"], frames["length"] = stamps, can_id, 1, 16
    frames["data"][:, 0] = counters % 16
    raw = np.round(values / np.array(resolution)).astype(np.int64) & 0xFFFFFF
    for k in range(values.shape[1]):
        for byte in range(3):
            frames["data"][:, 1 + 3 * k + byte] = (raw[:, k] >> (8 * byte)) & 0xFF
    return frames


def encode(plant, y, u, *, keep_command=None, keep_sensors=None, jitter_s=0.0, rng=None):
    """Return all frames in order of time; those that are not kept are lost."""
    m, count = len(plant.inputs), len(y)
    stamps = 1_000_000_000 + np.round(np.arange(count) * plant.period * 1e9).astype(np.int64)
    late = np.zeros((2, count), np.int64)
    if jitter_s:
        late = (rng.uniform(0.0, jitter_s, (2, count)) * 1e9).astype(np.int64)
    lead = min(3e-4, 0.1 * plant.period)
    commands = _encoded(COMMAND, u, plant.resolution[:m], stamps + late[0], np.arange(count))
    sensors = _encoded(SENSORS, y, plant.resolution[m:], stamps + round(lead * 1e9) + late[1], np.arange(count))
    if keep_command is not None:
        commands = commands[keep_command]
    if keep_sensors is not None:
        sensors = sensors[keep_sensors]
    both = np.concatenate([commands, sensors])
    return both[np.argsort(both["t_ns"], kind="stable")]


def decoded(plant, frame):
    """Return what cantools reads in a frame."""
    message = cantools.database.load_string(database(plant), "dbc").get_message_by_frame_id(int(frame["can_id"]))
    return message.decode(bytes(frame["data"][: frame["length"]]))


def configuration(folder, plant, a, b, *, kind="pi_bank", extra="", counter=True, name="m", accuracy=""):
    """Write database and configuration; returns the latter's path."""
    (folder / f"{plant.name}.dbc").write_text(database(plant))

    def matrix(values):
        return "[" + ", ".join("[" + ", ".join(repr(float(v)) for v in row) + "]" for row in values) + "]"

    lines = [
        'name = "bench"',
        '[[bus]]\nname = "can"\nuri = "loopback:127.0.0.1:29777"',
        f'database = ["{plant.name}.dbc"]',
        f'[[monitor]]\nname = "{name}"\ntype = "{kind}"\nsample_ms = {plant.period * 1e3!r}',
        f"a = {matrix(a)}\nb = {matrix(b)}\nc = {matrix(plant.c)}",
        f"state_noise = {[float(v) for v in plant.state_noise]}",
        extra,
    ]
    if counter:
        lines.append('counter = "Sens.Cnt"')
    for part, limit in zip(plant.inputs, plant.actuator, strict=True):
        lines.append(f'[[monitor.input]]\nname = "{part}"\nsignal = "Cmd.{part}"\nthreshold = {float(limit)!r}')
    for part, noise, limit, step in zip(
        plant.outputs, plant.noise, plant.sensor, plant.resolution[len(plant.inputs) :], strict=True
    ):
        told = float(np.hypot(noise, step / np.sqrt(12)))
        lines.append(
            f'[[monitor.output]]\nname = "{part}"\nsignal = "Sens.{part}"\n'
            f"noise = {told!r}\nthreshold = {float(limit)!r}\n{accuracy}"
        )
    path = folder / f"{plant.name}.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def written(path, frames):
    """Write frames as a candump log; returns its path."""
    lines = [
        f"({f['t_ns'] * 1e-9:.6f}) can {int(f['can_id']):03X}##1{bytes(f['data'][:16]).hex().upper()}" for f in frames
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def run(path, frames):
    """Replay frames as ``gateway replay`` does; returns the faults set, (seconds, name), and the summary."""
    gateway = Gateway(load_config(path), None, file=path)
    events = []
    gateway.listen(events.append)
    try:
        replay(gateway, [frames[k : k + 100_000] for k in range(0, len(frames), 100_000)])
        summary = gateway.summary(1.0)
    finally:
        gateway.close()
    begun = int(frames[0]["t_ns"])
    found = []
    for event in events:
        if event["event"] == "dtc" and event["fault"].startswith("m."):
            found.append((event, begun))
    return found, summary
