"""Networks of buses, ECUs and messages, their traffic, and what a gateway tells of it.

A network is {bus: {ECU: [(identifier, cycle in ms), ...]}}; identifiers are of one message each.
"""

from gateway.bus.frames import empty, put
from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare


def config_of(folder, network, timeout=2.5, power="", health="", check=""):
    """Return a configuration that watches all messages.

    Timeouts are in cycles, ``health`` is of each bus, ``check`` of each message, with its ``{cycle}`` [ms].
    """
    text = [power]
    for bus, ecus in network.items():
        lines = ['VERSION ""', "NS_ :", "BS_:", f"BU_: {' '.join(ecus)}"]
        checks = []
        for ecu, messages in ecus.items():
            for can_id, cycle in messages:
                lines += [f"BO_ {can_id} M{can_id:X}: 8 {ecu}", f' SG_ Value : 0|8@1+ (1,0) [0|255] "" {ecu}']
                checks.append(f'[[bus.check]]\nmessage = "M{can_id:X}"\ntimeout_ms = {timeout * cycle}\n')
                checks.append(check.format(cycle=cycle, window=60 * cycle))
        (folder / f"{bus}.dbc").write_text("\n".join(lines) + "\n")
        text += [f'[[bus]]\nname = "{bus}"\nuri = "virtual:{bus}"\ndatabase = ["{bus}.dbc"]\ncodes = "own"\n']
        text += [health, *checks]
    path = folder / "network.toml"
    path.write_text("\n".join(text))
    return load_config(path)


def traffic(network, rng, end_s, is_there, value=lambda can_id, t_s: 1):
    """Return frames of all messages that are there: bus, ECU, identifier, time [s] -> bool."""
    rows = []
    for number, (bus, ecus) in enumerate(network.items()):
        for ecu, messages in ecus.items():
            for can_id, cycle in messages:
                t_ms = rng.uniform(0.0, cycle)
                while t_ms < end_s * 1e3:
                    at = t_ms + rng.uniform(-0.1, 0.1) * cycle  # jitter
                    if at > 0.0 and is_there(bus, ecu, can_id, at * 1e-3):
                        rows.append((round(at * 1e6), number, can_id, value(can_id, at * 1e-3)))
                    t_ms += cycle
    rows.sort()
    frames = empty(len(rows))
    for k, (t_ns, bus, can_id, number) in enumerate(rows):
        put(frames, k, t_ns, can_id, bytes([number] * 8))
        frames["bus"][k] = bus
    return frames


def run(config, frames, end_s, step_s=None, changes=(), start_s=0.0):
    """Return the DTCs that were set, all diagnoses, and all events; time passes in steps as it does live.

    Args:
        config: of the gateway.
        frames: all.
        end_s: time passes until then [s].
        step_s: steps of time; None: one.
        changes: (time [s], configuration) of each reload.
        start_s: when the gateway starts; before the first frame.
    """
    gateway = Gateway(config)
    events = []
    gateway.listen(events.append)
    gateway.start(round(start_s * 1e9))
    at, changes = 0, list(changes)
    stops = [end_s] if step_s is None else [k * step_s for k in range(1, round(end_s / step_s) + 1)]
    for until_s in sorted({*stops, *(t for t, _ in changes)}):
        until = round(until_s * 1e9)
        n = int(frames["t_ns"].searchsorted(until))
        gateway.feed(frames[at:n])
        gateway.advance(until)
        at = n
        if changes and changes[0][0] == until_s:
            gateway.finish(gateway.engine.now_ns)
            new = changes.pop(0)[1]
            successor = Gateway(new, parts=prepare(new), store=gateway.store)
            successor.succeed(gateway)
            gateway = successor
    gateway.stop(round(end_s * 1e9))
    gateway.close()
    codes = {e["fault"] for e in events if e["event"] == "dtc" and e["status"] & 1}
    told = [e for e in events if e["event"] == "diagnosis"]
    return codes, told, events


def causes(told):
    """Return all causes that were told as certain."""
    return {tuple(g["cause"]) for e in told for g in e["groups"] if g["cause"]}
