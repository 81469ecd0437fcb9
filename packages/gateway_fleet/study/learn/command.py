"""``gateway evaluate learn``."""

from __future__ import annotations

import json as json_text
import tempfile
from pathlib import Path
from typing import Any

from gateway_fleet.study.learn.drive import Way
from gateway_fleet.study.learn.judge import healthy, judged
from gateway_fleet.study.learn.network import network

#: Treatment of the frames of a drive that is learned of, by name.
WAYS = {
    "clean": Way(),
    "lost": Way(lost=0.04, pauses=14),
    "sleeps": Way(sleeps=2, late=3),
    "host": Way(lost=0.01, batch_s=0.008),
    "all": Way(lost=0.04, pauses=8, sleeps=2, late=3, batch_s=0.008),
}
#: Other drives: as recorders and buses are.
OTHER = Way(lost=0.0, pauses=0, sleeps=1, late=3, batch_s=0.004)


def learn(*, cars: int, seconds: float, hours: float, ways: str, seed: int, database: bool, json: bool) -> int:
    """Learn of virtual cars, judge the claims, replay other healthy drives; returns the exit code."""
    names = ways.split(",")
    rows: list[dict[str, Any]] = []
    for car in range(cars):
        net = network(seed + car)
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                out, claims = judged(Path(folder), net, seed + 1000 * car, seconds, WAYS[name], database=database)
                done = 0
                while claims.hours < hours / (cars * len(names)):
                    done += 1
                    claims.codes += healthy(out, net, seed + 1000 * car + done, 3600.0, OTHER)
                    claims.hours += 1.0
            rows.append({"car": seed + car, "way": name} | vars(claims))
            if not json:
                _say(rows[-1])
    true, found = sum(row["true"] for row in rows), sum(row["found"] for row in rows)
    wrong, codes = sum(len(row["wrong"]) for row in rows), sum(sum(row["codes"].values()) for row in rows)
    total = sum(row["hours"] for row in rows)
    if json:
        print(
            json_text.dumps({"seed": seed, "rows": rows, "true": true, "found": found, "wrong": wrong, "codes": codes})
        )
    else:
        print(
            f"{found} of {true} protections found, {wrong} wrong claims; {total:.0f} h of other drives: {codes} codes"
        )
    return 0


def _say(row: dict[str, Any]) -> None:
    print(f"car {row['car']} {row['way']}: {row['found']} of {row['true']}, learned in {row['seconds']:.1f} s")
    for title in ("wrong", "missed", "unshown"):
        for line in row[title]:
            print(f"  {title}: {line}")
    for fault, count in row["codes"].items():
        print(f"  healthy drives: {fault} {count} times")
