"""What a fleet of 10^6 cars sends and stores, by arithmetic from sizes that are measured here.

``python bench/fleet_cost.py`` measures a drive's statistics and a DTC with its diagnosis as a car sends them and as the
tables have them, and prints both as a table. Assumed: two drives of 30 minutes and five changes of DTCs
a car and day, 291 tests, a peak of 20 times the mean.
"""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np

from gateway.faults.fleet import FleetParams
from gateway.faults.outgoing import Outgoing, Tally
from gateway_fleet.live.batch import packed, unpacked
from gateway_fleet.live.inbox import Inbox
from gateway_fleet.live.statistics import BLOCK_S, TESTS, _Test, columns
from gateway_fleet.live.tables import export, prepare

CARS, DRIVES, CHANGES, PEAK, DAY_S = 10**6, 2, 5, 20.0, 86400.0
#: Tests of a car; minutes of a drive; cars of which the table is made.
COUNT, MINUTES, SHOWN = 291, 30, 40
CAR = FleetParams(name="cost", car="0" * 24, model="van L2", software="7.1")


def drive(rng):
    """The statistics of a drive: a third of the tests are of states, as checksums and counters are."""
    tests = {}
    for k in range(COUNT):
        scale = 10.0 ** rng.uniform(-1, 3)
        worst = np.zeros(MINUTES) if k % 3 == 0 else scale * (5.0 + rng.standard_t(6, (MINUTES, 60)).max(1))
        test = _Test(sign=1, limit=scale * rng.uniform(20.0, 30.0))
        tests[f"signals_can0.Message{k // 4}_Signal{k}.high"] = test, worst.tolist()
    head = {"event": "statistics", "t_ns": 1_790_000_000 * 10**9, "begin_ns": 1_789_998_200 * 10**9, "condition": ""}
    head |= {"block_s": BLOCK_S, "seconds": MINUTES * BLOCK_S}
    parts = [dict(list(tests.items())[at : at + TESTS]) for at in range(0, COUNT, TESTS)]
    return [{**head, "part": k, "tests": columns(part)} for k, part in enumerate(parts)]


def change(n):
    """A change of a DTC, with its diagnosis."""
    faults = [f"signals_can0.Message{k}_Signal{k}.high" for k in range(4)]
    causes = [{"components": [f"signal can0.Message{k}.Signal{k}"], "probability": 0.9 / (k + 1), "explains": faults,
               "against": [{"test": faults[k], "why": "passed", "factor": 0.01}]} for k in range(4)]  # fmt: skip
    return [
        {"event": "dtc", "t_ns": 1_790_000_000 * 10**9 + n, "bus": "can0", "fault": faults[0], "dtc": "P0501-84",
         "status": 47, "fdc": 127, "occurrence": 1, "evidence": {"value": 12.5, "threshold": 12.0}},
        {"event": "diagnosis", "t_ns": 1_790_000_000 * 10**9 + n, "groups": [
            {"failed": faults, "cause": causes[0]["components"], "causes": causes, "waits_for": [], "apart_by": []}]},
    ]  # fmt: skip


def sent(events):
    rows = [Outgoing(1, False, 0, json.dumps(each), f"1a2b3c4d5e6f7a8b-{n}", n) for n, each in enumerate(events, 1)]
    return packed(CAR, rows, Tally(0, 0, 0, 0))[0]


def stored(make):
    """Bytes in the tables for what one car tells."""
    place = Path(tempfile.mkdtemp(prefix="fleet-cost-"))
    prepare(place)
    empty = sum(path.stat().st_size for path in place.glob("*/*/*.parquet"))
    inbox = Inbox(place / "inbox.sqlite")
    for k in range(SHOWN):
        car = CAR.model_copy(update={"car": f"{k:024x}"})
        rows = [Outgoing(1, False, 0, json.dumps(each), f"{k:x}-{n}", n) for n, each in enumerate(make(k), 1)]
        inbox.take([unpacked(packed(car, rows, Tally(0, 0, 0, 0))[0])], 1_790_000_000 * 10**9)
    export(inbox, place, "2026-11-29/07")
    inbox.close()
    size = sum(path.stat().st_size for path in place.glob("*/*/*.parquet")) - empty
    shutil.rmtree(place)
    return size / SHOWN


def main():
    rng = np.random.default_rng(2026)
    one_drive, one_change = len(sent(drive(rng))), len(sent(change(1)))
    drive_kept, change_kept = stored(lambda k: drive(np.random.default_rng(k))), stored(change)
    parts = -(-COUNT // TESTS)
    per_day = CARS * (DRIVES * parts + CHANGES * 2)
    batches = CARS * (DRIVES + CHANGES) / DAY_S
    rows = [
        ("statistics of a drive, sent", f"{one_drive / 1e3:.1f} kB", f"{CARS * DRIVES * one_drive / 1e9:.1f} GB a day"),
        (
            "a DTC with its diagnosis, sent",
            f"{one_change / 1e3:.2f} kB",
            f"{CARS * CHANGES * one_change / 1e9:.1f} GB a day",
        ),
        ("a car, sent", f"{(DRIVES * one_drive + CHANGES * one_change) / 1e3:.0f} kB a day", ""),
        ("statistics, in the tables", f"{drive_kept / 1e3:.1f} kB", f"{CARS * DRIVES * drive_kept / 1e9:.1f} GB a day"),
        ("DTCs, in the tables", f"{change_kept / 1e3:.2f} kB", f"{CARS * CHANGES * change_kept / 1e9:.1f} GB a day"),
        ("DTCs and diagnoses", "10 a day", f"{CARS * CHANGES * 2 / DAY_S:.0f} events/s"),
        ("all events", f"{DRIVES * parts + CHANGES * 2} a day", f"{per_day / DAY_S:.0f} events/s"),
        ("batches", f"{DRIVES + CHANGES} a day", f"{batches:.0f}/s, at the peak {PEAK * batches:.0f}/s"),
    ]
    print("| what | a car | 10^6 cars |\n|---|---|---|")
    for row in rows:
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
