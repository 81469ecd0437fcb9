"""The same for as long as a day on a bus: memory stays flat.

CI plays 10^6 frames, ``GATEWAY_TESTS=full`` 10^8; ``GATEWAY_SOAK`` sets how many.
"""

import ctypes
import gc
import os
from pathlib import Path

import pytest
from amount import amount
from run import QUIET_S, TURN_NS, Run, schedule_for
from schedule import BUSES

FRAMES = int(float(os.environ.get("GATEWAY_SOAK", amount(10**8, 4 * 10**5, 0))))
PER_TURN = 160
SEED = int(os.environ.get("GATEWAY_SEED", "1"))
#: More than this [bytes] is a leak: of 10^8 frames 0.1 byte a frame, a fifth of an event; of 10^6 seven bytes a frame.
GROWTH = 10_000_000


def resident():
    """Return what this process has in memory [bytes], without what the C library keeps of what was freed."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


@pytest.mark.evidence("Bounded: memory")
@pytest.mark.skipif(not FRAMES, reason="20 s: not with GATEWAY_TESTS=small")
@pytest.mark.timeout(300 + FRAMES / 20_000)
def test_memory_stays_flat_whatever_goes_wrong(tmp_path):
    seconds = FRAMES / (PER_TURN * len(BUSES)) * TURN_NS / 1e9 + QUIET_S
    turns = round(seconds * 1e9) // TURN_NS
    sizes = {}

    def each(run):
        if run.turns in (turns // 4, turns // 2, turns - 1):
            sizes[run.turns] = resident()

    schedule = schedule_for(SEED, seconds - QUIET_S)
    run = Run(tmp_path, SEED, seconds, schedule, per_turn=PER_TURN, each=each).play()
    shown = ", ".join(f"{size / 1e6:.1f} MB after {turn} turns" for turn, size in sizes.items())
    print(f"seed {SEED}: {run.summary()}; {shown}")
    first, *_, last = sizes.values()
    assert last - first < GROWTH, shown
