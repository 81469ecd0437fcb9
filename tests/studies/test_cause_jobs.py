"""The runs of the study of the diagnosis: faults that a learned configuration can show, and pairs of them."""

from dataclasses import replace

import numpy as np
import pytest

from gateway_fdi.errors import InputError
from gateway_fleet.study.cause import drive
from gateway_fleet.study.cause.cars import END_S, Car, Injected, injected
from gateway_fleet.study.cause.cases import faults
from gateway_fleet.study.cause.command import _rates, _reliability
from gateway_fleet.study.cause.judge import judge
from gateway_fleet.study.cause.matrix import Job, Row, pairs, run

DBC = """VERSION ""
BU_: Brake Body
BO_ 16 Speed: 6 Brake
 SG_ Left : 0|16@1+ (0.1,0) [0|6553] "km/h" Body
 SG_ Right : 16|16@1+ (0.1,0) [0|6553] "km/h" Body
 SG_ Full : 32|8@1+ (1,0) [0|255] "" Body
BO_ 17 Doors: 1 Body
 SG_ Warm : 0|8@1+ (1,-40) [-40|215] "degC" Brake
BO_ 18 Lamps: 1 Body
"""
CONFIG = """
[[bus]]
name = "can0"
database = ["car.dbc"]
check = [
    { message = "Speed", timeout_ms = 100.0, crc = { signal = "Full" } },
    { message = "Doors", timeout_ms = 1999.0 },
    { message = "Lamps", timeout_ms = 2000.0, most = { frames = 8, ms = 900.0, cycle_ms = 150.0 } },
]
[[monitor]]
signal = [
    { signal = "Speed.Left", plausible = [100.0, 200.0] },
    { signal = "Speed.Full", plausible = [0.0, 255.0] },
    { signal = "Speed.Right", plausible = [0.0, 1000.0] },
    { signal = "Doors.Warm", plausible = [-40.0, 100.0], stuck = { seconds = 3.0 } },
]
rule = [{ holds = "Speed.Left == Speed.Right", tolerance = 0.5 }]
"""
#: Brake sends nothing else, so that it may be at fault; of Body's two messages each may be.
FOUND = [
    ("drop Speed", {"message can0.Speed", "ecu can0.Brake"}),
    ("flip Speed", {"message can0.Speed", "ecu can0.Brake"}),
    ("drop Doors", {"message can0.Doors"}),
    ("freeze Doors", {"message can0.Doors"}),
    ("replay Lamps", {"second sender can0.Lamps"}),
    ("value Speed.Left=202", {"signal can0.Speed.Left"}),
    ("value Doors.Warm=102.8", {"signal can0.Doors.Warm"}),
    ("offset Speed.Left=1.25", {"signal can0.Speed.Left"}),
    ("offset Speed.Right=1.25", {"signal can0.Speed.Right"}),
]


def car_of(folder):
    (folder / "car.dbc").write_text(DBC)
    (folder / "car.toml").write_text(CONFIG)
    return Car("some", folder / "car.toml", folder / "drive.log")


def test_faults_of_a_car_are_those_that_its_lines_can_show(tmp_path):
    car = car_of(tmp_path)
    needs = {"offset Speed.Left=1.25": {"Speed.Right"}, "offset Speed.Right=1.25": {"Speed.Left"}}
    expected = [Injected(car, text, frozenset(truth), frozenset(needs.get(text, ()))) for text, truth in FOUND]
    assert list(injected(car)) == expected


def test_pairs_are_of_two_parts_and_each_has_a_seed_of_its_own(tmp_path):
    car = car_of(tmp_path)
    made = list(pairs(120, 7, [car], ["no plant"]))
    assert [job.seed for job in made] == list(range(7, 127))
    assert made == list(pairs(120, 7, [car], ["no plant"]))
    names = {tuple(sorted(one.text for one in job.injected)) for job in made}
    speed, doors = ("drop Speed", "flip Speed"), ("drop Doors", "freeze Doors")
    of_frames = {(*sorted((door, one)),) for door in doors for one in speed}
    of_frames |= {(*sorted((one, "replay Lamps")),) for one in (*speed, *doors)}
    offsets, high = ("offset Speed.Left=1.25", "offset Speed.Right=1.25"), ("value Speed.Left=202",)
    of_values = {offsets} | {  # what is out of its range hides an offset beside it
        (*sorted((one, "value Doors.Warm=102.8")),) for one in (*offsets, *high)
    }
    assert names == of_frames | of_values


def test_an_offset_is_drawn_and_all_else_is_put_in_as_it_is(tmp_path):
    rng = np.random.default_rng(5)
    for one in injected(car_of(tmp_path)):
        text = one.drawn(rng)
        if one.kind != "offset":
            assert text == one.text
        else:
            size = float(text.partition("=")[2])
            assert text.startswith(f"offset {one.target}=")
            assert 1.25 <= size <= 1.5 * 1.25
            assert size != 1.25


def test_a_run_counts_as_often_as_its_part_fails():
    """Two runs of one part share its rate; a message that stands is rarer than one that fails in any other way."""
    verdict = judge((), (), 0.0, 1.0)
    parts = [("message b.A", 3e-4), ("frozen b.A", 8e-5), ("message b.A", 3e-4), ("", 0.0)]
    rows = [Row("car", "some", k, 1.0, verdict, part, rate) for k, (part, rate) in enumerate(parts)]
    assert _rates(rows) == [1.5e-4, 8e-5, 1.5e-4, 0.0]


def told_in(names, right):
    """Return the row of the table for what was told with 85 %: runs, cases, mean, right, interval [%]."""
    verdict = judge((), (), 0.0, 1.0)
    rows = [
        Row("car", name, k, 1.0, replace(verdict, seen=True, chance=0.85, right=float(one)))
        for k, (name, one) in enumerate(zip(names, right, strict=True))
    ]
    table = _reliability("one fault", rows, [1.0] * len(rows))
    *cells, interval = (next(iter(column.cells)) for column in table.columns)
    return cells, [float(end.strip("% ")) for end in interval.split("to")]


def test_an_interval_is_of_cases_not_of_runs_that_are_alike():
    """Four runs of one case and six of others are as 100 / (16 + 6) cases; each a case of its own, they are ten."""
    cells, (low, high) = told_in(["A", "A", "A", "A", *"BCDEFG"], [1, 1, 1, 1, 1, 1, 1, 1, 1, 0])
    assert cells == ["0.8 to 0.9", "10", "7", "85.0%", "90.0%"]
    _, (apart_low, apart_high) = told_in("ABCDEFGHIJ", [1, 1, 1, 1, 1, 1, 1, 1, 1, 0])
    assert (apart_low, apart_high) == pytest.approx((59.6, 98.2), abs=0.1)  # Wilson's, of 9 in 10
    assert low < apart_low - 5.0
    assert high > apart_high
    assert told_in(["A + B", "B + A"], [1, 1])[0][1:3] == ["2", "1"]


def test_a_car_s_drive_is_judged_until_its_faults_end(tmp_path):
    """Doors come every 100 ms, but for a while long after the fault; nothing is told of that. Lamps always come."""
    car = car_of(tmp_path)
    car.config.write_text(
        'bus = [{ name = "can0", uri = "socketcan:can0", database = ["car.dbc"], '
        'check = [{ message = "Doors", timeout_ms = 500.0 }] }]\n'
    )
    sent = [(1000 + 0.1 * k, can_id) for k in range(1000) for can_id in (17, 18) if can_id == 18 or not 450 < k < 900]
    car.log.write_text("".join(f"({t_s:.6f}) can0 {can_id:03X}#00\n" for t_s, can_id in sent))
    (drop,) = (one for one in injected(car) if one.text == "drop Doors")
    (row,) = run(Job("some", "drop Doors", 5, injected=(drop,)))
    print(row)
    assert row.seconds == END_S
    assert row.verdict.seen
    assert row.verdict.place == 2, "Body, which sends Lamps too, comes before it: nothing tests those"
    assert not row.verdict.before


def test_without_a_package_that_finds_causes_nothing_is_judged(tmp_path, monkeypatch):
    """Rows that say "not seen" of each fault would be read as the gateway's."""
    job = Job("signals", "value Vehicle.Coolant", 5, (next(f for f in faults() if f.name == "value Vehicle.Coolant"),))
    monkeypatch.setattr(drive, "CALLS", {})
    with pytest.raises(InputError, match="no installed package finds causes"):
        run(job)
