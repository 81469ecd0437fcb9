"""The answer of a fleet's tables: cars with causes first, values far from those of the other cars, logs not judged."""

import csv

import numpy as np
import pytest
from command import command
from fleet_logs import write_config, write_log

from gateway_fleet.fleet.peers import unusual
from gateway_fleet.fleet.verdicts import Verdict, Verdicts


def rows(values, fault="signals.Volt.low", limit=10.5, monitor="signals", log=""):
    return [
        {"device": f"van{k:02d}", "log": f"{log}{k}", "fault": fault, "dtc": "P0562-84", "low": float(low),
         "high": 14.0, "limit": limit, "worst_t": 5, "monitor": monitor, "tested": "value [V]"}
        for k, low in enumerate(values)
    ]  # fmt: skip


NORMAL = 13.7 + 0.02 * np.arange(12)


def test_a_value_far_from_those_of_all_other_cars_is_unusual():
    (one,) = unusual(rows([*NORMAL[:11], 9.6]))
    assert (one.device, one.value, one.cars, one.log) == ("van11", 9.6, 11, "11")
    assert one.low > 13.6
    assert unusual(rows(NORMAL)) == []
    assert unusual(rows([*NORMAL[:11], 13.4])) == [], "of a spread of 0.2 V"


def test_two_cars_with_the_same_fault_do_not_hide_each_other():
    assert {one.device for one in unusual(rows([*NORMAL[:10], 9.6, 9.5]))} == {"van10", "van11"}


def test_few_cars_and_checks_of_messages_say_nothing():
    assert unusual(rows([*NORMAL[:4], 9.6])) == []
    assert unusual(rows([*NORMAL[:11], 9.6], monitor=None)) == []


def test_of_healthy_fleets_few_have_an_unusual_car():
    """Values with a tail as heavy as an exponential's, of forty tests each: one fleet of twenty may have one."""
    rng = np.random.default_rng(11)
    told = 0
    for _ in range(100):
        tests = [row for k in range(40) for row in rows(rng.exponential(1.0, 12), fault=f"s.t{k}", limit=-30.0)]
        told += bool(unusual(tests))
    assert told <= 10


@pytest.fixture
def fleet(tmp_path, monkeypatch, capsys):
    """Five healthy cars, one beyond its range, one log of another vehicle, one that is cut."""
    monkeypatch.chdir(tmp_path)
    config = write_config(tmp_path)
    for k in range(5):
        write_log(tmp_path / f"logs/van{k}/1.log", seed=k, peak=800.0 + k)
    write_log(tmp_path / "logs/van5/1.log", seed=5, peak=1200.0, begin_s=1_700_100_000)
    other = (tmp_path / "logs/van0/1.log").read_text().replace(" 100#", " 5A0#")
    (tmp_path / "logs/van6").mkdir()
    (tmp_path / "logs/van6/1.log").write_text(other)
    return lambda *words: command(capsys, monkeypatch, "fleet", *words), config


def test_a_run_ends_with_the_cars_that_have_something(fleet, tmp_path):
    run, config = fleet
    ended = run("run", "logs/**", "-c", config, "-o", "out", "--workers", "0")
    lines = ended.out.splitlines()
    assert lines[0] == "7 logs, 0 judged before; now: 1 foreign, 6 whole. Tables: out"
    assert lines[1] == "1 of 7 cars with faults, 1 logs not judged whole:"
    assert lines[2].split() == ["car", "finding", "since", "(UTC)", "DTCs", "log"]
    assert lines[3].startswith("van5")
    assert "2023-11-16 02:00:0" in lines[3]
    assert lines[3].endswith("logs/van5/1.log")
    assert "of another vehicle" in lines[4]
    assert lines[-1] == "Next: gateway fleet report out --html fleet.html"
    again = run("report", "out", "--csv", "f.csv", "--html", "f.html")
    assert again.code == 0
    found = list(csv.DictReader((tmp_path / "f.csv").read_text().splitlines()))
    assert [(row["car"], row["kind"]) for row in found] == [("van5", "cause"), ("van6", "log")] or [
        (row["car"], row["kind"]) for row in found
    ] == [("van5", "not isolated"), ("van6", "log")]
    page = (tmp_path / "f.html").read_text()
    assert "2023-11-16 02:00" in page
    assert "http" not in page
    assert run("report", "out", "--json").event("fleet_report")["findings"][0]["car"] == "van5"


def test_a_causes_symptoms_are_a_count(tmp_path):
    verdicts = Verdicts(tmp_path)
    verdicts.prepare()
    who = {"log": "a", "device": "van1"}
    log = {**who, "path": "/logs/van1/a.log", "state": "whole", "begin": 10**18, "end": 10**18, "seconds": 1.0,
           "frames": 1, "decoded": 1, "left_out": 0, "km": None, "dtcs": 3}  # fmt: skip
    dtc = {**who, "status": 1, "last": 10**18, "occurrence": 1, "failed_cycles": 1, "probability": 0.99,
           "role": "symptom", "evidence": "{}", "cause": "ecu can0.Brakes"}  # fmt: skip
    dtcs = [{**dtc, "dtc": f"U010{k}-87", "fault": f"can0.M{k}.timeout", "first": 10**18 + k} for k in range(3)]
    verdicts.write("a", Verdict(logs=[log], dtcs=dtcs))
    from gateway_fleet.fleet.answer import answer

    found = answer(verdicts)
    (one,) = found.findings
    assert (one.text, len(one.dtcs), one.since_ns, one.log) == ("ecu can0.Brakes (99%)", 3, 10**18, "/logs/van1/a.log")
    assert found.verdict() == "1 of 1 cars with faults"
