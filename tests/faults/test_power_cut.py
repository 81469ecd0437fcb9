"""The power goes at any moment of five kinds of work: nothing told is lost, nothing comes twice, nothing is "damaged".

``GATEWAY_TESTS=full`` cuts at each synchronisation in all ways, with several seeds (``GATEWAY_CUTS`` is their number).
A compiler builds what takes the work down (tests/faults/power/trace.c).
"""

import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import pytest
from amount import FULL, amount
from debian import program
from fault_examples import catalogue

from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore

HERE = Path(__file__).parent / "power"
sys.path.insert(0, str(HERE))

from cuts import HALF, KEPT, LOST, TORN, cuts, place, read_trace  # noqa: E402
from work import COUNT, KINDS  # noqa: E402

pytestmark = pytest.mark.long

SEEDS = int(os.environ.get("GATEWAY_CUTS", "0")) or amount(4, 1)
#: Bits that a start leaves alone: test failed, confirmed, test failed since last clear.
BITS = 0x29


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Return a function that does a kind of work, and returns its trace."""
    folder = tmp_path_factory.mktemp("trace")
    library = folder / "trace.so"
    subprocess.run(
        [program("gcc", "gcc", "libc6-dev"), "-shared", "-fPIC", "-O1", "-o", library, HERE / "trace.c", "-ldl"],
        check=True,
        timeout=120,
    )

    def trace(kind, seed):
        place, out = folder / f"{kind}{seed}", folder / f"{kind}{seed}.trace"
        place.mkdir()
        environment = {
            **os.environ, "LD_PRELOAD": str(library), "POWER_FOLDER": f"{place}/", "POWER_TRACE": str(out),
        }  # fmt: skip
        command = [sys.executable, str(HERE / "work.py"), kind, str(place / "f.sqlite"), str(seed)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stderr
        return read_trace(out)

    return trace


class Told:
    """What was known and told of each fault until a cut: states that may be found after it."""

    def __init__(self):
        self._states = {f"m.f{k}": [(0, 0)] for k in range(COUNT)}
        self._first = dict.fromkeys(self._states, 0)

    def take(self, text):
        for line in text.decode().splitlines():
            kind, fault, status, occurrence = line.split()
            state, states = (int(status) & BITS, int(occurrence)), self._states[fault]
            if kind == "known":
                if states[-1] != state:
                    states.append(state)
            else:
                at = max(k for k, each in enumerate(states) if each == state)
                self._first[fault] = max(self._first[fault], at)

    def judge(self, fault, state):
        states, first = self._states[fault], self._first[fault]
        if state in states[first:]:
            return ""
        if state in states:
            return "lost"
        return "twice" if state[1] > max(occurrence for _, occurrence in states[first:]) else "invented"


def found_in(path):
    """Start with the files of an image: states of the faults, mishaps, verdicts recovered."""
    store = ResilientStore(path)
    try:
        memory = FaultMemory(catalogue((1,) * COUNT), store)
        records = [memory.record(f"m.f{k}") for k in range(COUNT)]
        states = {record.id: (record.status & BITS, record.occurrence) for record in records}
        return states, [incident.reason for incident in store.incidents()], len(memory.recovered.faults)
    finally:
        store.close()


def cut_and_judge(ops, seed, share, images):
    """Judge the images of a trace; returns what was wrong, and counts."""
    rng, told, at = random.Random(seed), Told(), 0
    wrong, counts = [], Counter()
    for k, disk in cuts(ops, seed, share):
        for op in ops[at:k]:
            if op.name == "lines" and op.what == "W":
                told.take(op.data)
        at = k
        for left in (KEPT, LOST, HALF, TORN):
            folder = images / "image"
            path = place(disk.image(left, rng), folder)
            states, incidents, recovered = found_in(path)
            counts[left] += 1
            counts["recovered"] += recovered > 0
            judged = {fault: told.judge(fault, state) for fault, state in states.items()}
            if incidents or any(judged.values()):
                wrong.append((k, left, incidents, judged))
            again, incidents, recovered = found_in(path)
            if again != states or incidents or recovered:
                wrong.append((k, left, "the second start finds something else", again, states, incidents, recovered))
            shutil.rmtree(folder)
    return wrong, counts


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_is_left_of_unsynchronised_writes_nothing_told_is_lost(traced, kind):
    fast = Path("/dev/shm")
    for seed in range(SEEDS):
        ops = traced(kind, seed)
        syncs = sum(op.what in "SD" for op in ops)
        assert syncs > 20, "the trace has what SQLite and the journal do"
        assert any(op.name.endswith("-verdicts") and op.what == "S" for op in ops)
        with tempfile.TemporaryDirectory(dir=fast if fast.is_dir() else None) as folder:
            wrong, counts = cut_and_judge(ops, seed, 1.0 if FULL else min(1.0, 15 / syncs), Path(folder))
        print(f"{kind}, seed {seed}: {len(ops)} operations, {syncs} of them synchronise; images {dict(counts)}")
        assert wrong == [], (kind, seed, len(wrong), wrong[:3])
        assert counts[LOST] >= 5
