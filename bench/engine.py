"""The same log through the loop a user would write and through the gateway, in one run.

Peers: python-can messages, cantools decode, filterpy filters. All paths get the same frames from memory and
do the same work on each: CRC and alive counter, decode, and a first-order observer on every tooth time.

    python bench/engine.py [--frames 1000000] [--user-frames 20000] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import socket
import time
from contextlib import suppress

import cantools
import crccheck
import numpy as np
from filterpy.kalman import KalmanFilter

from gateway.bus.base import Statistics
from gateway.bus.can_structs import Packer, RawReceiver, Room
from gateway.bus.frames import FRAME, empty, to_message
from gateway.config.load import load_config
from gateway.engine.build import build_engine
from gateway.engine.instances import MonitorInstance
from gateway.live import fast_path
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.monitors.registry import MONITORS
from gateway.runtime.app import Gateway
from gateway.signals.database import load_database
from gateway.signals.tables import SignalRef
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import kernel
from gateway_fdi.jit.system import recvmmsg
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.ecu.tooth_frames import tooth_frames
from gateway_plants.crank.wheel import Wheel
from gateway_replay.replay import FED

RATE_RPM = 3000
BATCH = 64


def make_log(count):
    """Return ``count`` CTW_PT4 frames of a healthy engine, in order of time."""
    wheel = Wheel.parse("60-2")
    # Alive counter (256 frames of 4) and wheel (58 pulses) both come round after 29,696 pulses: one such piece
    # is repeated.
    pulses = 29_696
    rng = np.random.default_rng(1)
    seconds = (pulses / wheel.pulses + 1) * 60 / RATE_RPM
    times = tooth_times(wheel, [(0, RATE_RPM)], seconds, jitter=0.003, rng=rng)
    piece = tooth_frames(times[: pulses + 1], "classic")
    piece = piece[piece["can_id"] == 0x700]
    # From the last pulse of a piece to the first of the next is one whole number of turns.
    span = int(times[pulses] - times[0])
    copies = -(-count // len(piece))
    frames = np.tile(piece, copies)
    frames["t_ns"] += np.repeat(np.arange(copies) * span, len(piece))
    return frames[:count]


def user_loop(messages):
    """What one writes with the libraries: returns how many exceedances it saw."""
    message = cantools.database.load_file(shipped("dbc/crank.dbc")).get_message_by_name("CTW_PT4")
    kf = KalmanFilter(dim_x=1, dim_z=1)
    kf.F, kf.H = np.eye(1), np.eye(1)
    kf.Q, kf.R = np.eye(1), np.eye(1)
    pitches = Wheel.parse("60-2").pitches
    last, index, alarms = None, 0, 0
    for m in messages:
        data = bytes(m.data)
        if crccheck.crc.Crc8SaeJ1850.calc(data[1:] + b"\x00\x07") != data[0]:
            continue
        values = message.decode(data, decode_choices=False)
        count = values["FrameCnt"]
        if last is not None and (count - last) % 256 != 1:
            alarms += 1
        last = count
        for k in range(4):
            code = values[f"Pt{k}"]
            period = (code & 0x3FF) << (2 * (code >> 10))
            kf.predict()
            kf.update(period / pitches[index])
            if abs(kf.y[0, 0]) > 500:
                alarms += 1
            index = (index + 1) % 58
    return alarms


def replay_path(frames, chunk=FED):
    """Frames in chunks through the whole gateway."""
    gateway = Gateway(load_config(shipped("gateway.toml")), lasting=True)
    gateway.start(0)
    gateway.feed(frames[:1])
    begun = time.perf_counter()
    for k in range(1, len(frames), chunk):
        gateway.feed(frames[k : k + chunk])
    seconds = time.perf_counter() - begun
    assert gateway.engine.counters()["frames"] == len(frames)
    assert gateway.engine.readout()["crank"]["teeth"] == 4 * len(frames)
    assert gateway.engine.readout()["crank"]["missed"] == 0
    return seconds


def pair():
    """Two ends of a socket that keeps datagrams apart; the first is the receiver's."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        theirs.setsockopt(socket.SOL_SOCKET, 32, 1 << 20)  # SO_SNDBUFFORCE: 2700 frames; without the right to it 550
    except PermissionError:
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    ours.setblocking(False)
    return ours, theirs


def timed(frames, batch, theirs, take):
    """Send frames in batches; returns the seconds that it takes to take them."""
    datagrams = [*map(Packer(), frames)]
    seconds = 0.0
    for k in range(0, len(datagrams), batch):
        part = datagrams[k : k + batch]
        for datagram in part:
            theirs.send(datagram)
        begun = time.perf_counter()
        take(len(part))
        seconds += time.perf_counter() - begun
    return seconds


def fill(theirs, datagrams, sent):
    """Send until the receiver's queue is full; returns how many have been sent then."""
    with suppress(BlockingIOError):
        while sent < len(datagrams):
            theirs.send(datagrams[sent])
            sent += 1
    return sent


@kernel
def receive_all(fd: int, headers: int, batch: int) -> int:
    """Receive until there is nothing left; returns how many calls it took."""
    calls = 0
    while recvmmsg(fd, headers, batch, 0x40, 0) > 0:  # MSG_DONTWAIT
        calls += 1
    return calls


def least_path(frames, batch):
    """Nothing but the call of the system that receives, over the same queue: what no loop can be below."""
    ours, theirs = pair()
    theirs.setblocking(False)
    ours.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
    datagrams, sent, spent_ns = [*map(Packer(), frames)], 0, 0
    room, into = Room(1, batch), np.zeros((1, batch), FRAME)
    room.receive_into(into)
    receive_all(ours.fileno(), room.headers(0), batch)  # compiled before
    while sent < len(datagrams):
        sent = fill(theirs, datagrams, sent)
        begun_ns = time.thread_time_ns()
        receive_all(ours.fileno(), room.headers(0), batch)
        spent_ns += time.thread_time_ns() - begun_ns
    ours.close()
    theirs.close()
    return spent_ns / 1e9


def turn_path(frames, batch):
    """The daemon's loop over a bus that always has frames: so many a call of the system.

    Receive, stamps, engine, servers, what the loop does besides: CPU of its thread. The wait and the wake-up of the
    process, where frames come singly, depend on the system: bench/live.py tells their cost by a sender of its own.
    """
    from live import StructBus  # noqa: PLC0415 - tests use other functions of this file, from another folder

    ours, theirs = pair()
    theirs.setblocking(False)
    datagrams, sent, spent_ns = [*map(Packer(), frames)], 0, 0  # before the gateway starts: it waits for no message
    clock = Clock()
    link = Link("bench:", 0, "powertrain", lambda uri, index: StructBus(ours, index), clock)
    link.start()
    gateway = Gateway(load_config(shipped("gateway.toml")))
    gateway.start(clock.now())
    at_a_call, fast_path.BATCH = fast_path.BATCH, batch
    live = Live(gateway, [link], lambda event: None, clock=clock, tick_s=0.0)
    fast_path.BATCH = at_a_call
    live.turn()  # RUNNING
    while sent < len(datagrams):
        sent = fill(theirs, datagrams, sent)
        begun_ns = time.thread_time_ns()
        while link.statistics.received < sent:
            live.turn()
        spent_ns += time.thread_time_ns() - begun_ns
        with suppress(BlockingIOError):
            while theirs.recv(72):
                pass
    assert gateway.engine.counters()["decoded"] == len(frames)
    link.close()
    theirs.close()
    gateway.close()
    return spent_ns / 1e9


def receive_and_feed_path(frames, batch):
    """Frames from a socket into the gateway, without the loop around it: no wait, stamps, clock or poll of servers."""
    ours, theirs = pair()
    gateway = Gateway(load_config(shipped("gateway.toml")))
    receiver = RawReceiver(ours, Statistics())
    out = empty(batch + 1)
    gateway.start(0)

    def take(sent):
        count = receiver.receive(out, 0)
        gateway.feed(out[:count])
        assert count == sent

    seconds = timed(frames, batch, theirs, take)
    assert gateway.engine.counters()["frames"] == len(frames)
    ours.close()
    theirs.close()
    return seconds


def engine_path(frames, monitors, *, every_signal):
    """The jitted loop alone: so many crank monitors on each frame, no fault memory."""
    database = load_database([shipped("dbc/crank.dbc")])
    crank = MONITORS["crank_sync"]
    params = crank.params.model_validate({"wheel": "60-2"})
    instances = [MonitorInstance(f"m{k}", crank, params) for k in range(monitors)]
    names = [s.name for s in database.message("CTW_PT4").signals] if every_signal else []
    engine = build_engine([(0, database)], instances, [], extra=[SignalRef(0, "CTW_PT4", n) for n in names])
    engine.process(frames[:1], lambda events: None)
    begun = time.perf_counter()
    for k in range(1, len(frames), 100_000):
        engine.process(frames[k : k + 100_000], lambda events: None)
    return time.perf_counter() - begun


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--user-frames", type=int, default=20_000)
    parser.add_argument("--live-frames", type=int, default=200_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    frames = make_log(options.frames)
    messages = [to_message(frame) for frame in frames[: options.user_frames]]
    live = frames[: options.live_frames]
    best = {}

    def measure(name, count, seconds):
        best[name] = max(best.get(name, 0.0), count / seconds)

    # Rounds in turn, so that a machine that slows down slows all of them.
    for _ in range(options.rounds):
        begun = time.perf_counter()
        user_loop(messages)
        measure("python-can + cantools + filterpy", len(messages), time.perf_counter() - begun)
        rows = (
            ("live loop", turn_path),
            ("its system call alone", least_path),
            ("receive + feed", receive_and_feed_path),
        )
        for name, path in rows:
            measure(f"{name}, 1 frame a batch", len(live) // 4, path(live[: len(live) // 4], 1))
            for batch in (8, BATCH):
                measure(f"{name}, {batch} frames a batch", len(live), path(live, batch))
        measure("replay, whole gateway", len(frames), replay_path(frames))
        measure("loop: decode 6 signals", len(frames), engine_path(frames, 0, every_signal=True))
        measure(
            "loop: 1 crank monitor (4 teeth a frame)",
            len(frames),
            engine_path(frames, 1, every_signal=False),
        )
        measure(
            "loop: 5 crank monitors (20 teeth a frame)",
            len(frames),
            engine_path(frames, 5, every_signal=False),
        )
    against = "python-can + cantools + filterpy"
    rows = [
        {"name": name, "per_second": value, "ratio": value / best[against], "against": against}
        for name, value in best.items()
    ]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    if options.json:
        print(json.dumps({"rows": rows, "machine": machine}, indent=2))
        return
    print(f"{machine}; {len(frames)} frames, user's loop on {len(messages)} of them; best of {options.rounds}")
    print(f"{'':46}{'frames/s':>14}{'us/frame':>10}{'ratio':>9}")
    for row in rows:
        print(f"{row['name']:46}{row['per_second']:>14,.0f}{1e6 / row['per_second']:>10.3f}{row['ratio']:>8.0f}x")


if __name__ == "__main__":
    main()
