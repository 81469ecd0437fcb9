"""The queries of docs/fleet.md, asked of a fleet's tables."""

import re
from pathlib import Path

import pytest
from duck import ask
from fleet_logs import write_config, write_fleet

from gateway_fleet.fleet.run import Order, run
from gateway_logs.corpus import find

DOCS = Path(__file__).resolve().parents[2] / "docs" / "fleet.md"
QUERIES = re.findall(r"```sql\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def verdicts(tmp_path_factory):
    """Verdicts of ten logs, one of them damaged."""
    folder = tmp_path_factory.mktemp("docs")
    write_config(folder)
    paths = write_fleet(folder / "logs", 10, frames=1000)
    paths[0].write_bytes(paths[0].read_bytes() + b"nonsense\n")
    run(Order(find([folder / "logs"]), folder / "car.toml", folder / "verdicts", workers=0))
    return folder


def asked(verdicts, words):
    (query,) = (text for text in QUERIES if words in text)
    return ask(query.replace("'verdicts/", f"'{verdicts}/verdicts/"))


def test_dtcs_per_1000_km(verdicts):
    rows = asked(verdicts, "DTCs per 1000 km")
    by_device = {row[0]: row for row in rows}
    assert set(by_device) == {f"car{k}" for k in range(5)}
    assert by_device["car3"][1] == 1
    assert by_device["car3"][3] == pytest.approx(1000 / by_device["car3"][2])
    assert by_device["car0"][3] == 0


def test_near_misses(verdicts):
    rows = asked(verdicts, "near misses")
    assert rows
    assert all(row[3] >= 0 for row in rows)
    assert rows[0][3] == max(row[3] for row in rows)


def test_thresholds_against_hours(verdicts):
    rows = {(fault, float(factor)): (logs, hours) for fault, factor, logs, hours in asked(verdicts, "thresholds")}
    high = [rows["voltage.Value.high", factor][0] for factor in (0.7, 0.8, 0.9, 1.0, 1.1)]
    assert high == sorted(high, reverse=True)
    assert high[-1] == 1
    assert rows["voltage.Value.high", 1.0][1] == pytest.approx(10 * 10 / 3600, rel=0.02)


def test_all_queries_are_asked_here():
    assert len(QUERIES) == 5, "one of a lake is asked in test_decode.py, one of cars on the road in test_delivery.py"
