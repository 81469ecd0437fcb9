"""What tests of ``gateway learn`` share: what is asked for, and logs that are made of payloads."""

from pathlib import Path

from kept import kept

from gateway.bus.frames import empty, put
from gateway.bus.logs import open_writer
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked

ROOT = Path(__file__).parents[2]
DATABASE = ROOT / "examples/car/toyota_rav4.dbc"


def quiet(*_):
    """Show nothing."""


def as_before(name, text, folder):
    """Compare a text with what is kept of it, without its folders."""
    text = text.replace(f"{ROOT}/", "").replace(f"{folder}/", "")
    assert text.splitlines() == kept(ROOT / "tests/learn/learned" / name, text.encode()).decode().splitlines()


def asked(out, *logs, databases=(DATABASE,), **more):
    files = tuple(str(file) for file in databases)
    bus = BusAsked("can0", "socketcan:can0", files, files=files)
    return Asked("car", (bus,), tuple(logs), out, **more)


def drive(path, seconds, messages, rng=None):
    """Write a log: messages are (identifier, period in s, payload of the k-th frame, offset in s)."""
    stamps = []
    for can_id, period, payload, offset in messages:
        for k in range(int(seconds / period)):
            jitter = 0.0 if rng is None else rng.uniform(-0.05, 0.05) * period
            stamps.append((offset + k * period + jitter, can_id, payload(k)))
    stamps.sort(key=lambda each: each[0])
    frames = empty(len(stamps))
    for at, (t, can_id, data) in enumerate(stamps):
        put(frames, at, 1_000_000_000_000 + round(t * 1e9), can_id, data)
    with open_writer(path) as writer:
        writer.write(frames)
    return path
