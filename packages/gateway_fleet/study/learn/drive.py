"""Drives of the virtual car: courses of a road drawn from a seed, and their frames, as a recorder has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.signals.bits import field_at
from gateway.signals.protection.protection import Counter, Protection, compiled, protect_all
from gateway_fleet.study.learn.network import Network, Sent

#: Time between two points of a course [s].
STEP_S = 0.01
#: Track and wheelbase [m], steering wheel to wheels, tyres' growth by wheel.
TRACK, BASE, RATIO = 1.55, 2.7, 15.5
#: Largest lateral acceleration of the drivers [m/s2].
GRIP = 5.0
#: First stamp [ns].
BEGIN_NS = 1_700_000_000_000_000_000

Course = NDArray[np.float64]


@dataclass(frozen=True)
class Way:
    """Treatment of frames between their sender and the log.

    Attributes:
        lost: share of frames that the recorder loses.
        pauses: of the recorder.
        sleeps: of the bus; ECUs wake at their own times after them.
        late: ECUs that come seconds after a wake-up.
        batch_s: length of batches in which the host stamps frames, now and then.
    """

    lost: float = 0.0
    pauses: int = 0
    sleeps: int = 0
    late: int = 0
    batch_s: float = 0.0


def _road(rng: np.random.Generator, count: int) -> tuple[Course, Course]:
    """Return speed [m/s] and steering angle [deg]."""
    speed, angle = np.zeros(count), np.zeros(count)
    v, wanted, turn, until, until_turn, aim = 0.0, 0.0, 0.0, 0, 0, 0.0
    noise = rng.normal(0.0, 1.0, count)
    for k in range(count):
        if k >= until:
            wanted = float(rng.choice((0.0, 30.0, 50.0, 50.0, 80.0, 100.0, 130.0))) / 3.6 * rng.uniform(0.85, 1.1)
            until = k + int(rng.uniform(8.0, 45.0) / STEP_S)
        rate = float(np.clip((wanted - v) * 0.4, -3.5, 2.2)) + 0.15 * noise[k]
        v = max(v + rate * STEP_S, 0.0)
        if wanted == 0.0 and v < 0.3:
            v = 0.0
        if k >= until_turn:
            grip = 3.0 / max(v, 3.0) ** 2 * BASE * RATIO * 57.3  # 3 m/s2 across, and no more than the wheel turns
            aim = float(rng.choice((0.0, 0.0, 1.0, -1.0))) * min(grip, 450.0) * rng.uniform(0.1, 0.9)
            until_turn = k + int(rng.uniform(1.5, 9.0) / STEP_S)
        turn += float(np.clip((aim - turn) * 1.5, -300.0, 300.0)) * STEP_S + (
            0.02 * noise[count - 1 - k] if v > 0 else 0.0
        )
        most = min(GRIP / max(v, 1.0) ** 2 * BASE * RATIO * 57.3, 500.0)
        turn = float(np.clip(turn, -most, most))
        speed[k], angle[k] = v, turn
    return speed, angle


def courses(seed: int, seconds: float) -> Callable[[str], Course]:
    """Return the courses of a drive by their names, shape (seconds / STEP_S,); the rest bus when asked."""
    rng = np.random.default_rng([77, seed])
    count = int(seconds / STEP_S) + 1
    v, angle = _road(rng, count)
    yaw = v * np.tan(np.radians(angle / RATIO)) / BASE  # rad/s
    along = np.gradient(v, STEP_S)
    kmh = 3.6 * v
    moves = v > 0.05

    def noise(size: float) -> Course:
        return np.asarray(rng.normal(0.0, size, count) * moves, np.float64)

    made: dict[str, Course] = {"speed": kmh * 1.0 + noise(0.02), "angle": angle}
    slip = 1.0 + np.clip(along, 0.0, None) * 0.004
    for name, side, driven, tyre in (
        ("FL", -1, 1, 1.002),
        ("FR", 1, 1, 0.999),
        ("RL", -1, 0, 1.0),
        ("RR", 1, 0, 0.997),
    ):
        made[f"wheel{name}"] = np.maximum(
            (kmh + side * 3.6 * yaw * TRACK / 2) * tyre * (slip if driven else 1.0) + noise(0.08), 0.0
        )
    gears = np.array([0.0, 14.0, 8.5, 5.8, 4.3, 3.4, 2.8])  # rad of engine a metre, roughly
    gear = np.digitize(kmh, [0.5, 18.0, 35.0, 52.0, 72.0, 95.0])
    run = np.where(gear > 0, np.maximum(v * gears[gear] * 9.549, 820.0), 820.0)
    made |= {
        "gear": gear.astype(float),
        "rpm": np.convolve(run, np.ones(25) / 25, "same") + rng.normal(0, 4.0, count),
        "torque": np.clip(30 + 70 * along + 0.02 * kmh**1.5, -60, 350) + rng.normal(0, 1.0, count),
        "pedal": np.clip(8 + 22 * along + 0.15 * kmh, 0, 100) * moves,
        "brake": np.clip(-25 * along - 8, 0, 150),
        "effort": 0.02 * angle + rng.normal(0, 0.05, count),
        "yaw": np.degrees(yaw) + rng.normal(0, 0.06, count),
        "lateral": yaw * v + rng.normal(0, 0.03, count),
        "along": along + rng.normal(0, 0.03, count),
        "coolant": 90 - 70 * np.exp(-np.arange(count) * STEP_S / 400),
        "outside": np.full(count, 17.0 + 0.5 * rng.integers(6)),
        "volts": 14.1 + np.convolve(rng.normal(0, 1.0, count), np.ones(50) / 50, "same"),
        "shown": np.floor(kmh * 1.03 + 1.5) * moves,
        "trip": 100.0 + np.cumsum(v) * STEP_S / 1000,
    }

    def course(name: str) -> Course:
        if name not in made:
            made[name] = _own(name, seed, count)
        return made[name]

    return course


def _own(name: str, seed: int, count: int) -> Course:
    """Return a course of the rest bus in steps of its bits: ``kind message signal bits``."""
    kind, message, signal, bits = name.split()
    rng = np.random.default_rng([9, int(message), int(signal)])  # of the signal
    drive = np.random.default_rng([10, seed, int(message), int(signal)])  # of today's drive
    top = (1 << int(bits)) - 1
    t = np.arange(count)
    if kind == "constant":
        return np.full(count, float(rng.integers(top + 1)))
    if kind == "flag":
        return (np.cumsum(drive.random(count) < 0.0005) % 2).astype(float)
    if kind == "state":
        states = np.cumsum(drive.random(count) < 0.001) * 7 % int(rng.integers(2, 9))
        return np.asarray(states, np.float64)
    if kind == "ramp":
        return np.clip(drive.uniform(0, 0.2) * top + t * float(rng.uniform(0, 0.3)) * top / 1e5, 0, top)
    if kind == "torque":
        return np.clip(16 + np.cumsum(drive.normal(0, 0.01, count)) + (drive.random(count) < 0.3), 0, 255)
    slow = np.convolve(drive.normal(0, 1.0, count // 50 + 60), np.ones(40) / 40, "same")
    wave = np.interp(t, np.arange(len(slow)) * 50, slow)
    wave = (wave - wave.mean()) / max(wave.std(), 1e-9)
    return np.asarray(np.clip(top * (0.45 + 0.12 * wave) + drive.normal(0, 0.002 * top, count), 0, top), np.float64)


def _times(
    m: Sent, seconds: float, way: Way, sleeps: NDArray[np.float64], late: set[int], rng: np.random.Generator
) -> Course:
    """Return when a message is sent [s]."""
    if m.period_s == 0.0:
        some: Course = np.sort(rng.uniform(0.5, seconds - 0.1, max(int(seconds / 4.0), 4)))
        asleep = [(some >= begin) & (some < end + 1.0) for begin, end in sleeps]
        return some[~np.any(asleep, axis=0)] if asleep else some
    count = int(1.002 * seconds / m.period_s) + 2
    start, period = rng.uniform(0, m.period_s), m.period_s * rng.uniform(0.999, 1.001)
    t = np.asarray(start + np.arange(count) * period + rng.uniform(-0.05, 0.05, count) * m.period_s, np.float64)
    awake = np.ones(count, np.bool_)
    for begin, end in [(-1.0, 0.0), *sleeps]:
        up = end + (rng.uniform(2.0, 6.0) if m.ecu in late else rng.uniform(0.0, 0.15))
        awake &= ~((t >= begin) & (t < (up if way.late or begin >= 0 else end)))
    return t[awake & (t < seconds)]


def frames_of(net: Network, seed: int, seconds: float, way: Way) -> Frames:
    """Return the frames that a recorder has of a drive."""
    rng = np.random.default_rng([123, seed])
    course = courses(seed, seconds)
    begins = np.sort(rng.uniform(0.15, 0.9, way.sleeps)) * seconds
    sleeps = np.column_stack([begins, begins + rng.uniform(12.0, 20.0, way.sleeps)])
    late = set(range(6, 6 + way.late))
    parts = []
    for m in net.messages:
        t = _times(m, seconds, way, sleeps, late, rng)
        parts.append(_frames(m, t, course))
    frames = np.concatenate(parts)
    keep = rng.random(len(frames)) >= way.lost
    t_s = (frames["t_ns"] - BEGIN_NS) * 1e-9
    for begin in rng.uniform(0.05, 0.95, way.pauses) * seconds:
        keep &= ~((t_s >= begin) & (t_s < begin + rng.uniform(0.3, 3.0)))
    frames = frames[keep]
    frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    return late_host(frames, way.batch_s, seed)


def late_host(frames: Frames, batch_s: float, seed: int) -> Frames:
    """Return frames in order as a host stamps them that looks at its adapter late now and then, and finds several."""
    if batch_s > 0.0:
        frames, step = frames.copy(), round(batch_s * 1e9)
        slot = frames["t_ns"] // step
        bunched = np.random.default_rng([5, seed]).random(int(slot.max() - slot.min()) + 1) < 0.1
        hit = bunched[slot - slot.min()]
        frames["t_ns"][hit] = (slot[hit] + 1) * step - 1 + np.zeros(int(hit.sum()), np.int64)
        frames["t_ns"] = np.maximum.accumulate(frames["t_ns"])
    return frames


def _frames(m: Sent, t: Course, course: Callable[[str], Course]) -> Frames:
    """Return the frames of one message, protected."""
    frames = empty(len(t))
    frames["t_ns"] = BEGIN_NS + np.rint(t * 1e9).astype(np.int64)
    frames["can_id"], frames["length"] = m.can_id, m.length
    words = np.zeros((len(t), 8), np.uint64)
    at = np.minimum((t / STEP_S).astype(np.int64), 10**9)
    for f in m.fields:
        value = course(f.course)
        raw = np.rint((value[np.minimum(at, len(value) - 1)] - f.offset) / f.scale).astype(np.int64)
        words[:, 0] |= np.clip(raw, 0, (1 << f.bits) - 1).astype(np.uint64) << np.uint64(f.start)
    if m.counter is not None:
        place = field_at(m.counter[1] // 8, m.counter[2])
        check, own = None, None
        if m.checksum is not None:
            check, own = m.checksum[2], field_at(m.checksum[1] // 8, 8)
        asked = Protection(check, own, Counter(place, m.counter[3]))
        protect_all(words, np.full(len(t), m.length, np.int64), *compiled(asked), 0)
    frames["data"] = words.view(np.uint8).reshape(len(t), 64)
    return frames
