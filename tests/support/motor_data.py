"""The motor of models/motor.toml, simulated and on a bus."""

import cantools
import numpy as np

from gateway.bus.frames import empty, put
from gateway_fdi.common.resources import shipped

#: Time between two samples [s]; parameters of the model.
DT = 0.01
R, K, B, J = 0.5, 0.05, 1e-3, 2e-3
#: Steps of the plant between two samples.
FINE = 20


def drive(seconds, *, seed=0, noise=1.0, onset=0.0, f_R=0.0, f_b=0.0, f_i=0.0, f_w=0.0):
    """u, i, w of each sample, shape (samples, 3); faults from the onset [s] on."""
    rng = np.random.default_rng(seed)
    count = round(seconds / DT)
    omega, rows = 0.0, np.zeros((count, 3))
    for n in range(count):
        t = n * DT
        here = float(t >= onset)
        u = 8.0 + 3.0 * np.sin(0.7 * t) + 1.5 * np.sin(3.1 * t + 1.0)
        current = (u - K * omega) / (R * (1 + here * f_R))
        rows[n] = u, current + here * f_i, omega + here * f_w
        for _ in range(FINE):
            current = (u - K * omega) / (R * (1 + here * f_R))
            omega += DT / FINE * (K * current - B * (1 + here * f_b) * omega) / J
    return rows + noise * rng.normal(size=rows.shape) * (0.0, 0.05, 0.3)


def frames_of(rows, *, begin_ns=10**9, between_ns=300_000, dbc=None):
    """The frames of samples: Drive, and 0.3 ms behind it Sensors."""
    database = cantools.database.load_file(dbc or shipped("dbc/motor.dbc"))
    frames = empty(2 * len(rows))
    for n, (u, i, w) in enumerate(rows):
        stamp = begin_ns + round(n * DT * 1e9)
        for k, (name, values) in enumerate((("Drive", {"Voltage": u}), ("Sensors", {"Current": i, "Speed": w}))):
            message = database.get_message_by_name(name)
            data = message.encode(values, strict=False)
            put(frames, 2 * n + k, stamp + k * between_ns, message.frame_id, data, bus=0)
    return frames


def decoded(frames, dbc=None):
    """What a receiver makes of the frames: u, i, w, shape (samples, 3)."""
    database = cantools.database.load_file(dbc or shipped("dbc/motor.dbc"))
    rows = np.zeros((len(frames) // 2, 3))
    for n in range(len(rows)):
        first, second = (
            database.decode_message(int(f["can_id"]), bytes(f["data"][: f["length"]]))
            for f in frames[2 * n : 2 * n + 2]
        )
        rows[n] = first["Voltage"], second["Current"], second["Speed"]
    return rows
