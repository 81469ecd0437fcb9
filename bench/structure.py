"""Time of the structural analysis, beside Fault Diagnosis Toolbox and plain Python, in one run.

python bench/structure.py [--sensors 12] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import warnings
from functools import partial

from gateway_fdi.common.resources import shipped
from gateway_fdi.structure.candidates import classify
from gateway_fdi.structure.file import load_model
from gateway_fdi.structure.incidence import counted
from gateway_fdi.structure.mso import find_msos

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import faultdiagnosistoolbox as fdt

#: Sensors beyond the truck's five, in the order in which they are added.
SENSORS = ["U_b", "omega_w", "omega_em", "omega_mj", "T_mj", "T_gb", "SoC"]
REPEATS = 5


def best(work):
    """Least of several times [s], and what the work returns."""
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - begun)
    return min(times), result


def toolbox(model):
    rows = [
        [*(v if v in model.variables else v[4:-1] for v in e.variables), *e.knowns, *e.faults] for e in model.equations
    ]
    named = {"type": "VarStruc", "x": list(model.variables), "f": list(model.faults)}
    return fdt.DiagnosisModel({**named, "z": list(model.knowns), "rels": rows}, name=model.name)


def msos_in_python(model):
    """The same algorithm on sets of names, as one would write it first (Krysander et al. 2008, without lumping)."""
    variables = {e.name: {v if v in model.variables else v[4:-1] for v in e.variables} for e in model.equations}

    def overdetermined(equations):
        owner = {}

        def place(e, seen):
            for v in variables[e]:
                if v not in seen:
                    seen.add(v)
                    if v not in owner or place(owner[v], seen):
                        owner[v] = e
                        return True
            return False

        free = [e for e in equations if not place(e, set())]
        reached, waiting = set(free), list(free)
        while waiting:
            for v in variables[waiting.pop()]:
                if owner[v] not in reached:
                    reached.add(owner[v])
                    waiting.append(owner[v])
        return reached, len(free)

    found = []

    def search(equations, redundancy, removable):
        if redundancy == 1:
            found.append(frozenset(equations))
            return
        removable = set(removable)
        while removable:
            e = min(removable)
            smaller, rest = overdetermined(equations - {e})
            gone = equations - smaller
            if gone <= removable:
                removable -= gone
                search(smaller, rest, removable & smaller)
            removable -= gone

    start, redundancy = overdetermined(set(variables))
    search(start, redundancy, start)
    return found


def classified():
    """Seconds for all candidates of the truck, once."""
    truck = load_model(shipped("models/truck.toml"))
    msos = find_msos(counted(truck))
    begun = time.perf_counter()
    classify(truck, msos)
    return time.perf_counter() - begun


def classified_in_python():
    """The same without compilation, in a process of its own."""
    ended = subprocess.run(
        [sys.executable, __file__, "--classify"],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return float(ended.stdout)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--sensors", type=int, default=12, help="most sensors of the truck, 5 to 12")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--classify", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.classify:
        print(classified())
        return
    truck = load_model(shipped("models/truck.toml"))
    find_msos(counted(truck))  # compiled
    classify(truck, find_msos(counted(truck)))
    rows = []
    for count in (5, 6, 7, 8, 10, 12):
        if count > arguments.sensors:
            break
        model = truck.with_sensors(SENSORS[: count - 5])
        ours, msos = best(partial(find_msos, counted(model)))
        other = toolbox(model)
        theirs, sets = best(other.MSO)
        assert {frozenset(map(int, row)) for row in sets} == {frozenset(row.nonzero()[0].tolist()) for row in msos}
        row = {"name": f"MSO sets, truck with {count} sensors", "msos": len(msos), "seconds": ours}
        row |= {"ratio": theirs / ours, "against": "faultdiagnosistoolbox", "peer_seconds": theirs}
        rows.append(row)
        if count <= 6:
            slow, found = best(partial(msos_in_python, model))
            assert len(found) == len(msos)
            rows.append({**row, "ratio": slow / ours, "against": "plain Python", "peer_seconds": slow})
    msos = find_msos(counted(truck))
    seconds, found = best(partial(classify, truck, msos))
    slow = classified_in_python()
    row = {
        "name": "classes of all candidates, 5 sensors",
        "msos": len(msos),
        "candidates": len(found),
        "bound": 0.2,
    }
    row |= {
        "seconds": seconds,
        "ratio": slow / seconds,
        "against": "plain Python",
        "peer_seconds": slow,
    }
    rows.append(row)
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        text = f"{row['name']:<38} {1e3 * row['seconds']:9.3f} ms  {row['msos']:6d} sets"
        text += f"  {row['against']:>21} {1e3 * row['peer_seconds']:9.2f} ms  {row['ratio']:6.1f} x"
        if "bound" in row:
            text += f"  ({row['candidates']} candidates; asked: < {1e3 * row['bound']:.0f} ms)"
        print(text)


if __name__ == "__main__":
    main()
