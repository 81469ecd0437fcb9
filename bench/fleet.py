"""A fleet's logs by one worker and by two, in one run; and through one process without a cluster.

    python bench/fleet.py [--logs 200] [--frames 20000] [--json]

Logs are generated (tests/support/fleet_logs.py), of five cars. Wall time from the call to its end, with the cluster's
start; and CPU time of this process and of the workers, which tells what two cores of one's own would take where the
machine is shared: half of the workers' time, and all of this process's.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support"))

from fleet_logs import tables_hash, write_config, write_fleet

from gateway_fleet.fleet.run import Order, run
from gateway_logs.corpus import find


def cpu_times():
    """Return the CPU time of this process, and of those that it has started and that have ended [s]."""
    return [
        one.ru_utime + one.ru_stime for one in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found, used, hashes = {}, {}, set()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = write_config(folder)
        write_fleet(folder / "logs", options.logs, frames=options.frames)
        recordings = find([folder / "logs"])
        for workers in (0, 1, 2):
            begun, cpu = time.perf_counter(), cpu_times()
            run(Order(recordings, config, folder / f"out{workers}", workers=workers))
            found[workers] = time.perf_counter() - begun
            used[workers] = [now - before for now, before in zip(cpu_times(), cpu, strict=True)]
            hashes.add(tables_hash(folder / f"out{workers}"))
        begun = time.perf_counter()
        run(Order(recordings, config, folder / "out2", workers=2))
        again = time.perf_counter() - begun
    assert len(hashes) == 1, "the tables do not depend on who made them"
    facts = {"no cluster": found[0], "one worker": found[1], "two workers": found[2], "again": again}
    facts |= {f"CPU of this process, {n} workers": used[n][0] for n in (1, 2)}
    facts |= {f"CPU of the workers, {n} workers": used[n][1] for n in (1, 2)}
    if options.json:
        print(json.dumps(facts))
        return
    for what, seconds in facts.items():
        print(f"{what}: {seconds:.1f} s")
    print(f"two workers take {found[2] / found[1]:.2f} of one worker's time")


if __name__ == "__main__":
    main()
