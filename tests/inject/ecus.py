"""What is on the two buses: ECUs with alive counters, a plant with float signals; and the gateway that listens."""

import numpy as np

from gateway.bus.frames import FD, empty

MESSAGES = 4
FIRST_ID, PLANT_ID, OTHER_ID = 0x300, 0x2D0, 0x123

DBC = """VERSION ""
NS_ :
BS_:
BU_: Ecu Gateway
"""
PLANT = """BO_ 720 Plant: 12 Ecu
 SG_ Command : 0|32@1- (1,0) [0|0] "V" Gateway
 SG_ First : 32|32@1- (1,0) [0|0] "m" Gateway
 SG_ Second : 64|32@1- (1,0) [0|0] "m" Gateway
SIG_VALTYPE_ 720 Command : 1;
SIG_VALTYPE_ 720 First : 1;
SIG_VALTYPE_ 720 Second : 1;
"""
MONITOR = """
[[monitor]]
name = "plant"
type = "linear_observer"
bus = "chassis"
sample_ms = 10.0
states = ["first", "second"]
a = [[-5.0, 0.0], [0.0, -8.0]]
b = [[5.0], [8.0]]
c = [[1.0, 0.0], [0.0, 1.0]]
state_noise = [0.01, 0.01]
[[monitor.input]]
name = "command"
signal = "Plant.Command"
threshold = 0.2
[[monitor.output]]
name = "first"
signal = "Plant.First"
noise = 0.02
[[monitor.output]]
name = "second"
signal = "Plant.Second"
noise = 0.02
"""
OUTPUTS = """
[output.uds]
clear = {}
bus = "chassis"
[output.dtc_frame]
bus = "chassis"
cycle_ms = 200.0
[memory]
recording = { before_ms = 20.0, after_ms = 5.0, most_per_fault = 1 }
[clock]
heals_after_s = 2.0
"""


def write_config(folder, *, other=False):
    """Write the configuration, or another one for the same buses; returns its path."""
    dbc = DBC
    for k in range(MESSAGES):
        dbc += f"BO_ {FIRST_ID + k} M{k}: 8 Ecu\n"
        dbc += ' SG_ FrameCnt : 0|8@1+ (1,0) [0|255] "" Gateway\n'
        dbc += ' SG_ Value : 8|16@1+ (0.1,0) [0|6553] "V" Gateway\n'
    (folder / "ecus.dbc").write_text(dbc + PLANT)
    toml, faults = "", ""
    for b, (name, uri) in enumerate((("chassis", "virtual:a"), ("body", "virtual:b"))):
        toml += f'[[bus]]\nname = "{name}"\nuri = "{uri}"\ndatabase = ["ecus.dbc"]\n'
        for k in range(MESSAGES):
            limit = 150.0 + 50.0 * k + 100.0 * other
            toml += f'[[bus.check]]\nmessage = "M{k}"\ntimeout_ms = {limit}\n'
            toml += 'counter = { signal = "FrameCnt" }\n'
            kinds = (("counter", 0x0400, 0x82), ("length", 0x0500, 0x81), ("timeout", 0x0100, 0x87))
            for kind, first, failure in kinds:
                number = first + 16 * b + k
                faults += f'[fault."{name}.M{k}.{kind}"]\ndtc = "U{number:04X}-{failure:02X}"\n'
                faults += f'freeze_frame = ["{name}.M{k}.Value"]\n'
                if k < 2 and kind != "timeout":  # at once, and back at once
                    faults += "debounce = { failed_after = 1, passed_after = 1, jump_down = true }\n"
    path = folder / "ecus.toml"
    path.write_text('name = "injected"\n' + toml + MONITOR + faults + OUTPUTS)
    return path


class Ecus:
    """The ECUs of one bus: the frames of a turn, as arrays; counters go on however many there are.

    Attributes:
        jumps, short: percent of frames with a counter that jumps, and that are too short.
        no_value: what a float signal carries instead of its value, None: its value.
        serials: sum of all serial numbers of frames, and of their identifiers, modulo 2**64.
    """

    def __init__(self, rng, *, plant):
        self._rng, self._plant = rng, plant
        self._counts = np.zeros(MESSAGES, np.int64)
        self.jumps = self.short = 0
        self.no_value = None

    def frames(self, begin_ns, end_ns, count):
        """Return so many frames of the time between two turns, in order, and one of the plant for each 10 ms."""
        messages = np.arange(count) % MESSAGES
        frames = empty(count)
        frames["t_ns"] = begin_ns + (np.arange(count) + 1) * (end_ns - begin_ns) // (count + 1)
        frames["can_id"] = FIRST_ID + messages
        frames["length"] = 8
        frames["data"][:, 1] = self._rng.integers(256)
        steps = np.ones(count, np.int64)
        if self.jumps:
            steps += 3 * (self._rng.random(count) * 100 < self.jumps)
        for k in range(MESSAGES):
            mine = messages == k
            counts = self._counts[k] + np.cumsum(steps[mine])
            frames["data"][mine, 0] = counts % 256
            if len(counts):
                self._counts[k] = counts[-1]
        if self.short:
            short = self._rng.random(count) * 100 < self.short
            frames["length"][short] = 2
            frames["data"][short, 2:] = 0
        if self._plant:
            first = -(-begin_ns // 10_000_000) * 10_000_000
            times = np.arange(first, end_ns, 10_000_000)
            if len(times):
                frames = np.concatenate([frames, self._samples(times)])
                frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        return frames

    def _samples(self, times):
        frames = empty(len(times))
        frames["t_ns"], frames["can_id"], frames["length"], frames["flags"] = (
            times,
            PLANT_ID,
            12,
            FD,
        )
        values = np.ones((len(times), 3), "<f4")
        values[:, 1:] += self._rng.normal(0, 0.02, (len(times), 2))
        if self.no_value is not None:
            values[:, self._rng.integers(3)] = self.no_value
        frames["data"][:, :12] = values.view(np.uint8).reshape(len(times), 12)
        return frames
