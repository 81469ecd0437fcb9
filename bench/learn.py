"""`gateway learn` on a long log: the shipped drive, again and again, with growing stamps.

Prints the CPU seconds of each stage, the largest memory, and what a frame costs beside the loop that one would write
to look at the same log: python-can's reader with cantools' decode.

    python bench/learn.py [--frames 1000000 --frames 10000000] [--peer-frames 50000]
"""

from __future__ import annotations

import argparse
import lzma
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import can
import cantools

ROOT = Path(__file__).parents[1]
CAR = ROOT / "examples/car"
#: What a process of its own does: learns, and tells what each stage took.
WORK = """
import json, resource, sys, time
from pathlib import Path
from gateway_fleet.learn.document import BusAsked
from gateway_fleet.learn.learn import Asked, learn
log, database, out = sys.argv[1:]
stages = {}
last = ["start", time.process_time()]
def progress(what, which, done):
    what = what.split()[0]
    now = time.process_time()
    stages[last[0]] = stages.get(last[0], 0.0) + now - last[1]
    last[:] = [what, now]
bus = BusAsked("can0", "socketcan:can0", (database,), files=(database,))
result = learn(Asked("car", (bus,), (Path(log),), Path(out)), progress)
progress("end", "", 1.0)
mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
named = sum(outcome.named for outcome in result.outcomes)
stages = {name: round(seconds, 2) for name, seconds in stages.items()}
tried = len(result.outcomes)
print(json.dumps({"s": stages, "mb": round(mb), "alarms": result.alarms, "named": named, "tried": tried}))
"""


def write_log(path: Path, frames: int) -> int:
    """Write the drive as often as it takes; returns how many frames there are."""
    lines = lzma.decompress((CAR / "drive.log.xz").read_bytes()).decode().splitlines()
    split = [line.split(" ", 1) for line in lines]
    stamps = [round(float(stamp[1:-1]) * 1e6) for stamp, _ in split]
    rest = [text for _, text in split]
    span = stamps[-1] - stamps[0] + 1000
    rounds = -(-frames // len(lines))
    with path.open("w") as file:
        for k in range(rounds):
            file.write(
                "".join(
                    f"({(at + k * span) // 1_000_000}.{(at + k * span) % 1_000_000:06d}) {text}\n"
                    for at, text in zip(stamps, rest, strict=True)
                )
            )
    return rounds * len(lines)


def peer(path: Path, frames: int) -> float:
    """Return the CPU time of a frame in python-can and cantools [us]."""
    database = cantools.database.load_file(CAR / "toyota_rav4.dbc", strict=False)
    known = {message.frame_id: message for message in database.messages}
    begun, count = time.process_time(), 0
    for message in can.LogReader(path):
        found = known.get(message.arbitration_id)
        if found is not None:
            found.decode(message.data, decode_choices=False)
        count += 1
        if count == frames:
            break
    return (time.process_time() - begun) / count * 1e6


def main() -> None:
    """Learn from logs of several lengths, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, action="append")
    parser.add_argument("--peer-frames", type=int, default=50_000)
    asked = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "long.log"
        for frames in asked.frames or [1_000_000, 10_000_000]:
            count = write_log(log, frames)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            said = subprocess.run(
                [sys.executable, "-c", WORK, str(log), str(CAR / "toyota_rav4.dbc"), str(Path(folder) / "car.toml")],
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"{count} frames: {cpu:.1f} s of CPU, {cpu / count * 1e6:.2f} us a frame; {said.strip()}")
        theirs, ours = peer(log, asked.peer_frames), cpu / count * 1e6
        print(
            f"python-can and cantools, reading and decoding alone: {theirs:.1f} us a frame; ratio {theirs / ours:.1f}"
        )


if __name__ == "__main__":
    main()
