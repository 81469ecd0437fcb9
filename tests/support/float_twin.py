"""The same monitors, but for a database in which every signal that they use is a floating-point one."""

from dataclasses import dataclass

import numpy as np

from gateway.bus.frames import FD, empty, payload
from gateway.config.load import load_config
from gateway.engine.build import build_engine
from gateway.engine.instances import MonitorInstance
from gateway.runtime.assemble import prepare
from gateway.signals.database import load_database
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped


@dataclass
class Twin:
    """Frames and monitors of a scenario, with signals as floats of 4 or 8 bytes.

    ``places``: (message, signal) -> index of the frames that carry it, and dtype and offset of the signal in them.
    """

    database: object
    monitors: list
    frames: object
    places: dict

    def engine(self):
        """Return a new engine."""
        return build_engine([(0, self.database)], self.monitors, [])


def _text(messages):
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A"]
    types = []
    for number, (_, (name, signals, size)) in enumerate(messages.items()):
        lines.append(f"BO_ {256 + number} {name}: 64 A")
        for k, (signal, unit) in enumerate(signals):
            lines.append(f' SG_ {signal} : {8 * size * k}|{8 * size}@1- (1,0) [0|0] "{unit}" A')
            types.append(f"SIG_VALTYPE_ {256 + number} {signal} : {1 if size == 4 else 2};")
    return "\n".join([*lines, *types]) + "\n"


def twin(name, seconds, folder):
    """Return the twin of a shipped scenario's beginning."""
    scenario = load_scenario(shipped(f"scenarios/{name}.toml"))
    config = load_config(scenario.config)
    parts = prepare(config, scenario.config)
    by_bus = dict(enumerate(parts.databases))
    plan = parts.engine.plan
    messages = {}
    for bus, message in plan.message_names:
        wanted = [(ref.signal, unit) for ref, unit in zip(plan.slot_names, plan.slot_units, strict=True)
                  if (ref.bus, ref.message) == (bus, message)]  # fmt: skip
        if wanted:
            assert len(wanted) <= 16, f"{message} has too many signals for a frame of floats"
            messages[bus, message] = (message, wanted, 8 if len(wanted) <= 8 else 4)
    file = folder / "twin.dbc"
    file.write_text(_text(messages))
    short = scenario.model_copy(update={"duration_s": seconds, "fault": (), "wire": ()})
    played = Player(short, {bus.name: k for k, bus in enumerate(config.bus)}).frames
    ids = {}
    for number, key in enumerate(messages):
        message = by_bus[key[0]].message(key[1])
        ids[key[0], message.frame_id] = (256 + number, message, messages[key])
    rows, places = [], {}
    for frame in played:
        found = ids.get((int(frame["bus"]), int(frame["can_id"]) & 0x1FFFFFFF))
        if found is None:
            continue
        number, message, (label, signals, size) = found
        values = message.decode(payload(frame), decode_choices=False)
        out = empty(1)[0]
        out["t_ns"], out["can_id"], out["length"], out["flags"] = frame["t_ns"], number, 64, FD
        kind = f"<f{size}"
        data = np.array([values.get(signal, 0.0) for signal, _ in signals], kind).tobytes()
        out["data"][: len(data)] = np.frombuffer(data, np.uint8)
        for k, (signal, _) in enumerate(signals):
            places.setdefault((label, signal), ([], kind, size * k))[0].append(len(rows))
        rows.append(out)
    frames = empty(len(rows))
    for k, row in enumerate(rows):
        frames[k] = row
    monitors = [
        MonitorInstance(m.name, m.monitor, m.params, 0, m.priority, _unbussed(m.signals)) for m in parts.engine.monitors
    ]
    made = Twin(load_database([file]), monitors, frames, places)
    used = {(ref.message, ref.signal) for ref in made.engine().plan.slot_names}
    made.places = {key: place for key, place in places.items() if key in used}
    return made


def _unbussed(signals):
    """Return a renaming of signals without names of buses: all are on one here."""
    return {key: ".".join(value.split(".")[-2:]) for key, value in signals.items()}


def spoiled(twin_, message, signal, value, first, last):
    """Return the frames with one signal's value replaced, in its frames from ``first`` to ``last`` (excluded)."""
    frames = twin_.frames.copy()
    at, kind, offset = twin_.places[message, signal]
    with np.errstate(over="ignore"):
        data = np.frombuffer(np.array([value], kind).tobytes(), np.uint8)
    for k in at[first:last]:
        frames[k]["data"][offset : offset + len(data)] = data
    return frames, len(at[first:last])
