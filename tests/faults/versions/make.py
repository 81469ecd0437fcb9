"""Make a fault memory of an earlier version, with that version's own code; tests/faults/versions/README.md says how.

git archive COMMIT gateway packages | tar -x -C OLD
PYTHONPATH=OLD:OLD/packages python make.py VERSION.sqlite
"""

import dataclasses
import sqlite3
import sys
from pathlib import Path

from gateway.faults import store as its_store

try:
    from gateway.faults import records
except ImportError:  # version 1
    records = its_store


def fitting(kind, **values):
    """Make a record of those values that it has in that version."""
    names = {field.name for field in dataclasses.fields(kind)}
    return kind(**{name: value for name, value in values.items() if name in names})


def record(k, occurrence):
    frames = {n: records.FreezeFrame(n, 1000 * k + n, {"M.A": k / 3, "M.B": None}) for n in (1, 2)}
    return fitting(
        records.Record,
        id=f"m.f{k}", dtc=0x030011 + (k << 8), status=0x2F, failed_cycles=1, occurrence=occurrence,
        first_ns=1000 + k, last_ns=2000 + k, evidence={"value": 1.5, "threshold": float(k)}, passed_cycles=k,
        aged_cycles=0, inputs={"M.C": -2.25}, peak_fdc=127, near_misses=k, first_failed=k + 1, last_failed=k + 4,
        first_confirmed=k + 1, last_confirmed=k + 4, freeze_frames=frames if occurrence else {},
    )  # fmt: skip


def changes():
    """Say all that a file of this version can keep."""
    cycle = records.Cycle(3, True, 77)
    known = {
        "records": [record(0, 1), record(1, 2), record(2, 0)],
        "cycles": {"power": cycle, "driving": records.Cycle(2, False, 70)},
        "facts": {"sequence": 6, "attempts.1": 2},
        "identifiers": {0xF190: b"WVWZZZ1JZXW000001"},
        "kept_recordings": 2,
    }
    if hasattr(records, "Permanent"):
        known["permanent"] = [records.Permanent("m.f0", 0x030011, 900)]
        known["recordings"] = [records.Recording("m.f1", 2001, 2, 1, b"log of two frames")]
    if (Path(records.__file__).parent / "interventions.py").exists():
        from gateway.faults.interventions import Intervention

        made = fitting(
            Intervention, number=1, first_ns=5, t_ns=9, count=2, protocol="uds", bus="pt", address=0x7E0, session=3,
            security=1, role="", action="clear", request=b"\x14\xff\xff\xff", outcome=0,
        )  # fmt: skip
        known["interventions"] = {1: made}
    if (Path(records.__file__).parent / "explanation.py").exists():
        from gateway.faults.explanation import Cause, Ranked

        known["records"][1].cause = Cause("cause", (Ranked(("signal m.M.A",), 0.97),), "m.f1", "P0301-11", 2001)
    return known, cycle


path = Path(sys.argv[1])
made = its_store.Store(path)
found, its_cycle = changes()
if records is its_store:
    made.save(found["records"], its_cycle)
else:
    made.save(fitting(records.Changes, **found))
    made.save(fitting(records.Changes, records=[record(0, 2)], cleared=[0x030211]))
made.close()
db = sqlite3.connect(path)
db.execute("PRAGMA journal_mode = DELETE")  # one file
db.execute("VACUUM")
print(path, db.execute("PRAGMA user_version").fetchone()[0], path.stat().st_size)
