"""``gateway evaluate drives``: vehicles of a folder, everyday faults, and the diagnosis that is told of them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.bus.logs import open_writer
from gateway.cli import app
from gateway.config.load import load_config
from gateway.runtime.assemble import prepare
from gateway_fleet.learn.everyday import BEGIN, END, KINDS, Drive
from gateway_fleet.study.drives.judge import Findings, _of_fault
from gateway_fleet.study.drives.vehicles import drive_of, vehicles
from gateway_fleet.study.learn.drive import Way, frames_of
from gateway_fleet.study.learn.network import network

SECONDS = 40.0


def write(path, frames):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_writer(path) as writer:
        writer.write(frames)


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A folder of three vehicles, and what is told of it."""
    folder = tmp_path_factory.mktemp("drives")
    net = network(71)
    write(folder / "one" / "b.log", frames_of(net, 71, SECONDS * 1.5, Way()))
    write(folder / "one" / "a.log", frames_of(net, 72, SECONDS, Way()))
    (folder / "one" / "car.dbc").write_text(net.dbc())
    write(folder / "two" / "only.log", frames_of(network(73), 73, SECONDS, Way()))
    (folder / "three").mkdir()
    (folder / "three" / "empty.log").write_text("")
    arguments = ["evaluate", "drives", str(folder), "--workers", "0", "--out", str(folder / "learned"), "--json"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2, result.output
    return folder, json.loads(result.stdout.splitlines()[-1])


def test_each_vehicle_is_learned_of_its_largest_log_and_judged_on_the_others(told):
    folder, found = told
    assert [(one["vehicle"], one["judged"], bool(one["error"])) for one in found["vehicles"]] == [
        ("one", 1, False),
        ("three", 0, True),
        ("two", 1, False),
    ]
    (bad,) = found["errors"]
    assert bad.startswith("three: ")
    assert "empty.log" in bad
    by_name = {vehicle.name: vehicle for vehicle in vehicles(folder)}
    assert by_name["one"].learned.name == "b.log", "the larger one"
    healthy = [drive for drive in found["drives"] if not drive["faults"]]
    assert [round(drive["seconds"]) for drive in healthy] == [SECONDS, SECONDS / 2]
    assert found["hours"] == pytest.approx(1.5 * SECONDS / 3600, rel=0.01)


def test_healthy_drives_of_made_cars_give_no_code(told):
    _, found = told
    assert found["false_codes"] == len([code for drive in found["drives"] for code in drive["codes"]]) == 0
    assert found["false_causes"] == 0


def test_faults_are_told_by_their_kinds(told):
    _, found = told
    row = {"tried": 2, "judged": 2, "found": 2, "right": 2}
    assert found["faults"]["ECU dead"] == row | dict.fromkeys(("beyond", "beyond_found", "wrong", "accused"), 0)
    by_senders = found["faults_by_senders"]
    assert {of: rows["ECU dead"]["tried"] for of, rows in by_senders.items()} == {"named": 1, "unknown": 1}
    assert found["faults"]["second sender"]["found"] >= 1, "a message of 1 s that is learned for 40 s is not judged"
    assert found["faults"]["unknown identifier"]["found"] == 2
    assert found["faults"]["offset"]["tried"] == 1, "without a database there is no signal"
    assert set(found["faults"]) <= set(KINDS)
    lines = [line for drive in found["drives"] for line in drive["lines"]]
    silent = sum(row["judged"] - row["found"] for row in found["faults"].values())
    assert len([line for line in lines if line[2].startswith("silent")]) >= silent > 0


@pytest.fixture(scope="module")
def drive(told):
    folder, _ = told
    path = folder / "learned" / "one" / "car.toml"
    config = load_config(path)
    frames = drive_of(folder / "one" / "a.log", config)
    return lambda seed=0: Drive(config, prepare(config, path), frames, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_there_between_its_begin_and_its_end_only(kind, drive):
    made = drive()
    fault = KINDS[kind](made)
    if fault is None:
        pytest.fail("this car has a place for each of them")
    before, after = made.frames, fault.frames
    assert fault.begin_ns == made.start_ns + round(BEGIN * made.seconds * 1e9)
    early = before["t_ns"] < fault.begin_ns
    assert np.array_equal(after[after["t_ns"] < fault.begin_ns], before[early])
    assert not np.array_equal(after, before)
    end_ns = made.start_ns + round((END + 0.05) * made.seconds * 1e9)
    if kind == "jitter":
        end_ns += 10**10
        for can_id in np.unique(before["can_id"]):
            orders = [frames["data"][frames["can_id"] == can_id] for frames in (before, after)]
            assert np.array_equal(*orders), "no frame of a message overtakes another"
    assert np.array_equal(after[after["t_ns"] > end_ns], before[before["t_ns"] > end_ns])
    assert (np.diff(after["t_ns"].astype(np.int64)) >= 0).all()
    assert fault.right <= fault.concerned


def test_an_unknown_identifier_is_in_no_database(drive):
    made = drive()
    assert {message.frame_id for message in made._parts.databases[0]} <= made.known, "also those that do not come"
    made.known |= set(range(0, 0x6FF, 2))
    assert int(KINDS["unknown identifier"](made).about, 16) % 2 == 1


def test_a_quantity_with_a_code_or_two_is_no_enumeration(drive):
    """What the database has texts for is a state where all of its values in the drive have one."""
    made = drive()
    names = {signal.name for _, signal in made.texts()}
    _, state = next(made.texts())
    quantity = next(signal for _, signal, _ in made.quantities())
    quantity.choices = {(1 << quantity.length) - 1: "invalid"}
    again = {signal.name for _, signal in made.texts()}
    quantity.choices = None
    assert again == names
    assert state.name in names


def test_two_swapped_signals_have_each_others_values(drive):
    made = drive()
    sent = next(one for one in made.sent if one.name == "Wheels")
    first, second = "WheelFL", "WheelRR"
    within = made.hit(sent)[made.of(sent)]
    other = drive()
    other.frames = made.swapped(sent, first, second)
    before, after = [list(zip(one.values(sent, first), one.values(sent, second), strict=True)) for one in (made, other)]
    expected = [(b, a) if hit else (a, b) for (a, b), hit in zip(before, within, strict=True)]
    assert after == expected
    assert before != after


def test_a_cause_is_wrong_if_any_part_of_it_is_well(drive):
    fault = KINDS["frozen"](drive())
    (name,) = {one.removeprefix("message ") for one in fault.right if one.startswith("message ")}
    healthy = Findings({}, {}, {})
    sees = {"its": {f"message {name}"}, "other": {"signal can0.X.Y"}}

    def row(codes, causes):
        found, _ = _of_fault(fault, Findings(codes, {}, causes), healthy, sees)
        return found.found, found.right, found.wrong, found.accused

    now = fault.begin_ns
    assert row({}, {}) == (False, False, False, False)
    assert row({"its": now}, {(f"message {name}",): now}) == (True, True, False, False)
    assert row({"its": now}, {(f"message {name}", "signal can0.X.Y"): now}) == (True, False, True, False)
    assert row({"its": now}, {(f"signal {name}.Z",): now}) == (True, False, False, False)
    assert row({"other": now}, {("bus can0",): now}) == (True, False, True, True)
    assert row({"its": now - 1}, {}) == (False, False, False, False), "it was there before"


def test_a_fault_that_nothing_can_judge_is_not_silent(drive):
    """It is over while the bus still wakes, or no limit watches; it is counted apart, and told or not."""
    fault = KINDS["ECU dead"](drive())
    told = Findings({"its": fault.begin_ns}, {}, {})

    def row(fault, found, runs_ns):
        counts, _ = _of_fault(fault, found, Findings({}, {}, {}), {}, runs_ns)
        return counts.beyond, counts.beyond_found, counts.judged, counts.found

    assert row(fault, told, fault.begin_ns) == (0, 0, 1, 1)
    assert row(fault, Findings({}, {}, {}), fault.begin_ns) == (0, 0, 1, 0)
    assert row(fault, told, fault.end_ns) == (1, 1, 0, 0)
    assert row(replace(fault, needs_s=math.inf), Findings({}, {}, {}), 0) == (1, 0, 0, 0)


def test_the_time_that_a_limit_needs_is_that_of_the_configuration(drive):
    made = drive()
    limits = {check.params.message: check.params for check in made._parts.checks}
    sent = next(one for one in made.sent if limits[one.name].most)
    limit = limits[sent.name]
    assert made.needs_s("drop", [sent]) == pytest.approx(limit.timeout_ms * 1e-3)
    assert made.needs_s("double", [sent]) == pytest.approx(limit.most.ms * 0.5e-3)
    assert made.needs_s("flip", [sent]) == 0.0, "what sees it is not asked"
    assert made.needs_s("drop", [replace(sent, name="Nobody")]) == math.inf
