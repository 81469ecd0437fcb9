"""A fleet of made-up vans: logs of their drives, healthy or with one fault each, in the formats that are asked for."""

import numpy as np

from gateway.bus.frames import empty
from gateway.bus.logs import open_writer

DBC = """VERSION ""
NS_ :
BS_:
BU_: Motor Brakes Body
BO_ 257 MotorStatus: 8 Motor
 SG_ Rpm : 0|16@1+ (0.25,0) [0|8000] "rpm" Body
 SG_ Alive : 56|4@1+ (1,0) [0|15] "" Body
BO_ 288 WheelSpeed: 8 Brakes
 SG_ FL : 0|16@1+ (0.01,0) [0|300] "km/h" Body
 SG_ FR : 16|16@1+ (0.01,0) [0|300] "km/h" Body
 SG_ RL : 32|16@1+ (0.01,0) [0|300] "km/h" Body
 SG_ RR : 48|16@1+ (0.01,0) [0|300] "km/h" Body
BO_ 320 VehicleSpeed: 4 Body
 SG_ Speed : 0|16@1+ (0.01,0) [0|300] "km/h" Motor
BO_ 512 Coolant: 4 Motor
 SG_ Temp : 0|8@1+ (1,-40) [-40|150] "degC" Body
BO_ 544 Battery: 6 Body
 SG_ Volt : 0|16@1+ (0.01,0) [0|30] "V" Motor
BO_ 576 Brake: 4 Brakes
 SG_ Pressure : 0|16@1+ (0.01,0) [0|200] "bar" Body
"""
#: Message -> period [ms].
PERIODS = {257: 20, 288: 20, 320: 40, 512: 500, 544: 200, 576: 20}
#: First stamp of a fleet [s].
BEGIN_S = 1_760_000_000


def _course(rng, count):
    """Return speed [km/h] and turning (share of the speed between left and right), points of 20 ms."""
    speed, turn = np.zeros(count), np.zeros(count)
    v = aim = now = bend = 0.0
    for k in range(count):
        if k % 400 == 0:
            aim = float(rng.choice((0.0, 30.0, 50.0, 80.0, 110.0))) * rng.uniform(0.9, 1.1)
            bend = float(rng.choice((0.0, 0.0, 0.02, -0.02))) * rng.uniform(0.3, 1.0)
        v = max(0.0, v + float(np.clip(aim - v, -0.25, 0.16)))
        now += 0.02 * (bend - now)
        speed[k], turn[k] = v, now
    return speed, turn


def drive(seed, seconds=90.0, fault="", begin_s=BEGIN_S):
    """Return the frames of a drive.

    Args:
        seed: of the drive.
        seconds: of it.
        fault: "", "wheel" (FL + 8 km/h), "coolant" (138 degC), "battery" (9.6 V), "dead" (Brakes from a third on).
        begin_s: its first stamp [s].
    """
    rng = np.random.default_rng([4, seed])
    count = int(seconds * 50)
    speed, turn = _course(rng, count)
    wheel = [speed * (1 + side * turn) + rng.normal(0, 0.05, count) for side in (1, -1, 1, -1)]
    if fault == "wheel":
        wheel[0] = wheel[0] + 8.0
    heat = 138.0 if fault == "coolant" else rng.uniform(84, 90)
    volt = 9.6 if fault == "battery" else rng.uniform(13.75, 14.0)
    rows = []
    offsets = {can_id: rng.uniform(0, period) for can_id, period in PERIODS.items()}
    for can_id, period in PERIODS.items():
        for n, t_ms in enumerate(np.arange(offsets[can_id], seconds * 1e3, period)):
            if fault == "dead" and can_id in (288, 576) and t_ms > seconds * 333:
                break
            k = min(int(t_ms / 20), count - 1)
            data = bytearray(8)

            def put(at, value, size=2, data=data):
                data[at : at + size] = int(max(round(value), 0)).to_bytes(size, "little")

            if can_id == 257:
                put(0, (800 + 35 * speed[k] + rng.normal(0, 10)) / 0.25)
                data[7] = n % 16
            elif can_id == 288:
                for j in range(4):
                    put(2 * j, wheel[j][k] / 0.01)
            elif can_id == 320:
                put(0, speed[k] / 0.01)
            elif can_id == 512:
                put(0, heat + rng.normal(0, 0.7) + 40, 1)
            elif can_id == 544:
                put(0, (volt + rng.normal(0, 0.03)) / 0.01)
            elif can_id == 576:
                put(0, max(0.0, -np.gradient(speed[max(k - 1, 0) : k + 2]).mean() * 200 + 0.3) / 0.01)
            rows.append((t_ms + abs(rng.normal(0, 0.1)), can_id, bytes(data)))
    rows.sort()
    frames = empty(len(rows))
    for k, (t_ms, can_id, data) in enumerate(rows):
        frames["t_ns"][k] = begin_s * 10**9 + int(t_ms * 1e6)
        frames["can_id"][k] = can_id
        length = 4 if can_id in (320, 512, 576) else 6 if can_id == 544 else 8
        frames["length"][k] = length
        frames["data"][k, :length] = list(data[:length])
    return frames


def write(path, frames):
    """Write frames as a log of the format that the name says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_writer(path) as writer:
        writer.write(frames)
    return path
