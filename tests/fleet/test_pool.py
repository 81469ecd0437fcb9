"""Statistics of drives, limits of many cars, and answers from the tables."""

import json

import numpy as np
import pytest
from road import Memory, car_of, rows
from scipy.stats import t as student

from gateway.engine.buckets import TickRow
from gateway.faults.fleet import FleetCondition
from gateway.faults.outgoing import Outgoing, Tally
from gateway_fleet.live import tables as of_fleet
from gateway_fleet.live.answers import Answers, rate
from gateway_fleet.live.batch import packed
from gateway_fleet.live.collect import Came, Collector
from gateway_fleet.live.forget import forget
from gateway_fleet.live.inbox import Row
from gateway_fleet.live.pool import Shown, pool, shown
from gateway_fleet.live.statistics import Drive, _Test, columns

#: Unit variance of Student's t with six degrees of freedom; seconds of a minute.
UNIT, SECONDS = np.sqrt(4.0 / 6.0), 60


def fleet(rng, count):
    """Cars as in research: each has its own centre and its own spread."""
    return rng.normal(0.0, 1.0, count), np.exp(rng.normal(0.0, 0.2, count))


def minutes(rng, centre, spread, count=60):
    """The largest value of each minute, in order."""
    worst = (rng.standard_t(6, (count, SECONDS)) * UNIT).max(axis=1)
    return np.sort(centre + spread * worst)


def false_alarms(limits, centres, spreads):
    """Hours with an alarm in 1e5 h, exactly."""
    return float((1.0 - (1.0 - student.sf((limits - centres) / spreads / UNIT, 6)) ** (60 * SECONDS)).mean()) * 1e5


def seen(values, day=0):
    """Block maxima of a car as they are."""
    return Shown(np.asarray(values), np.ones(len(values)), np.full(len(values), day))


def test_limits_of_many_cars_keep_the_rate_that_is_told():
    """Wanted: 10 in 1e5 h a test; a limit from a car's own hour gives 20,000."""
    rng, found = np.random.default_rng(11), []
    others = fleet(rng, 4000)
    for _ in range(5):
        pooled = pool([seen(minutes(rng, *car)) for car in zip(*fleet(rng, 300), strict=True)], 60.0, 1e-4)
        assert not pooled.own
        expected, low, high = (1e5 * one for one in pooled.per_hour)
        assert low <= expected <= high * 1.000001
        assert high == pytest.approx(10.0)
        found.append(false_alarms(pooled.limit, *others))
    assert np.mean(found) <= 10.0
    assert sum(low <= one <= 10.0 for one in found) >= 4
    few = fleet(rng, 30)
    own = pool([seen(minutes(rng, *car)) for car in zip(*few, strict=True)], 60.0, 1e-4)
    assert own.own
    assert false_alarms(np.array(own.each), *few) <= 10.0
    assert pool([seen(np.ones(60))] * 12, 60.0, 1e-4) is None, "what never moves has no tail"
    assert pool([seen(minutes(rng, 0.0, 1.0))] * 9, 60.0, 1e-4) is None


def test_blocks_of_one_car_or_of_one_day_say_less_than_others():
    """The same blocks: cars of one day; of ten days; and far ones in few cars."""
    rng = np.random.default_rng(5)
    cars = np.array([minutes(rng, 0.0, 1.0) for _ in range(120)])
    alike = np.sort(cars.ravel()).reshape(cars.shape)
    made = [[seen(car) for car in cars], [seen(car, k % 10) for k, car in enumerate(cars)], [*map(seen, alike)]]
    one, days, far = (pool(each, 60.0, 1e-4).limit for each in made)
    assert days > 1.1 * one
    assert far > 1.5 * one


def test_a_summary_of_a_drive_is_as_good_as_its_minutes():
    rng = np.random.default_rng(3)
    cars = [minutes(rng, *car) for car in zip(*fleet(rng, 120), strict=True)]
    tests = columns(
        {f"m{k}.f": (_Test(sign=1), list(car)) for k, car in enumerate(cars)} | {"z": (_Test(), [2.0] * 60)}
    )
    body = json.dumps({
        "event": "statistics", "t_ns": 1, "begin_ns": 0, "part": 0, "condition": "", "block_s": 60.0,
        "seconds": 3600.0, "tests": tests,
    })  # fmt: skip
    kept = list(of_fleet.test_rows(Row(1, "c", "", "", "a", 1, 0, 1, body)))
    assert [row["blocks"] for row in kept] == [60] * 121
    assert (kept[-1]["values"], kept[-1]["weights"]) == ([2.0], [60.0])
    again = [shown([(row["values"], row["weights"], 0)]) for row in kept[:-1]]
    for car, exact in zip(again, cars, strict=True):
        assert car.quantile(0.5) == pytest.approx(np.median(exact), abs=0.4)
        assert car.values[-1] == pytest.approx(exact[-1], abs=0.1)
    exact = pool([seen(car) for car in cars], 60.0, 1e-4)
    assert pool(again, 60.0, 1e-4).limit == pytest.approx(exact.limit, rel=0.15)
    one, two = ((row["values"], row["weights"], day) for day, row in enumerate(kept[:2]))
    assert shown([one, two]).blocks == 120.0


def test_a_drive_of_291_tests_takes_less_than_four_kilobytes(tmp_path):
    """Half an hour; a third of the tests are of states, which do not move."""
    rng, of = np.random.default_rng(2026), {}
    for k in range(291):
        scale = 10.0 ** rng.uniform(-1, 3)
        worst = scale * minutes(rng, 5.0, 1.0, 30) if k % 3 else np.zeros(30)
        of[f"signals_can0.Message{k // 4}_Signal{k}.high"] = _Test(sign=1, limit=scale * rng.uniform(20, 30)), worst
    head = {"event": "statistics", "t_ns": 10**18, "begin_ns": 10**18, "part": 0, "condition": "", "block_s": 60.0}
    rows = [Outgoing(1, True, 0, json.dumps(head | {"seconds": 1800.0, "tests": columns(of)}), "1a2b3c4d5e6f-1", 1)]
    assert len(packed(car_of(), rows, Tally(0, 0, 0, 0))[0]) <= 4000


def tick(t_s, fault, value, limit, ratio):
    """One result in a tick of the status socket."""
    row = np.zeros(1, TickRow.dtype)
    row["fault"], row["numbers"], row["count"] = fault, 1, 1
    row["low"] = row["high"] = row["worst"] = value
    row["limit"] = row["threshold"] = limit
    row["ratio"] = ratio
    return {"kind": "tick", "t_ns": round(t_s * 1e9)}, row.tobytes()


def test_a_drive_becomes_block_maxima_towards_the_limit_by_condition():
    drive = Drive([FleetCondition(name="cold", signal="E.T", max=40.0)])
    drive.on_message({"kind": "hello", "faults": [{"id": "m.x.high"}, {"id": "m.x.low"}]}, b"")
    for k in range(600):
        drive.note({"E.T": 20.0 if k < 240 else 90.0})
        drive.on_message(*tick(1e6 + k, 0, 1.0 + k % 60 / 100.0 + k // 60, 15.0, 0.5))
        drive.on_message(*tick(1e6 + k, 1, 1.0 + k % 60 / 100.0 + k // 60, -5.0, 0.7))
    assert drive.take() == []
    drive.on_message({"kind": "event", "event": {"event": "cycle", "state": "ended", "t_ns": 10**15}}, b"")
    events = {event["condition"]: event for event in drive.take()}
    assert sorted(events) == ["", "cold"]
    cold = events["cold"]["tests"]
    assert cold["fault"] == ["m.x.high", "m.x.low"]
    assert cold["sign"] == [1, -1]
    assert [sum(weights) for weights in cold["weights"]] in ([3, 3], [4, 4])
    largest = [sum(values) * 2.0**unit for values, unit in zip(cold["values"], cold["unit"], strict=True)]
    assert largest[0] in (pytest.approx(3.59, abs=0.1), pytest.approx(4.59, abs=0.1))
    assert largest[1] == pytest.approx(-1.0, abs=0.1), "towards its limit, which is below"
    assert events["cold"]["seconds"] + events[""]["seconds"] == 540.0
    assert drive.take() == []


def diagnosis(n, *causes):
    """A diagnosis that has proven these causes."""
    groups = [{"failed": ["m.f"], "cause": [cause], "causes": []} for cause in causes]
    return {"event": "diagnosis", "t_ns": n, "groups": groups}


@pytest.fixture
def tables(tmp_path):
    """Tables of twelve cars: three told a cause, one of them twice."""
    collector, rng = Collector(tmp_path / "out", "vans", 1e9), np.random.default_rng(5)
    day = 86_400 * 10**9
    for k, (centre, spread) in enumerate(zip(*fleet(rng, 12), strict=True)):
        car = car_of(f"car{k:02d}")
        memory = Memory(tmp_path / f"{k}.sqlite", car)
        tests = columns({"speed.V.high": (_Test(sign=1, limit=9.0), list(minutes(rng, centre, spread)))})
        head = {"event": "statistics", "t_ns": 20_000 * day, "begin_ns": 0, "part": 0, "condition": "", "block_s": 60.0}
        memory.post(head | {"seconds": 3600.0, "tests": tests})
        causes = [(), ("pump",), ("pump", "wire"), (), ("pump",)] if k == 0 else [("pump",)] if k < 3 else [()]
        memory.post(*(diagnosis(20_000 * day + n, *some) for n, some in enumerate(causes)))
        memory.commit()
        payload, _ = packed(car, memory.store.outgoing(), memory.store.tally())
        memory.close()
        collector.put(Came(car.car, payload, lambda digest: None))
    collector.run(lambda: True)
    collector.close()
    return tmp_path / "out"


def test_the_usual_questions_are_answered(tables):
    answers = Answers(tables)
    pump, wire = answers.rates(("model", "software"))
    assert (pump["cause"], pump["times"], pump["cars"], pump["hours"]) == ("pump", 4, 3, 12.0)
    assert (pump["model"], pump["software"]) == ("van", "7.1")
    assert (pump["per_hour"], pump["low"], pump["high"]) == pytest.approx((4 / 12, 0.1139, 0.7628), rel=1e-3)
    assert (wire["cause"], wire["times"]) == ("wire", 1)
    assert {str(row["week"]) for row in answers.rates()} == {"2024-09-30"}
    assert [(row["car"], row["times"]) for row in answers.cars("pump")] == [("car00", 2), ("car01", 1), ("car02", 1)]
    assert [row["causes"] for row in answers.history("car00")][1:3] == [["pump"], ["pump", "wire"]]
    assert answers.by_limits() == [(0, 5, 12.0)]
    ((sign, pooled, cars),) = answers.pooled(1e-4).values()
    assert (sign, pooled.cars, len(cars), pooled.own) == (1, 12, 12, True)
    assert rate(0, 10.0) == pytest.approx((0.0, 0.0, 0.29957), rel=1e-4)


def test_a_car_that_is_forgotten_is_nowhere_and_does_not_come_again(tables, tmp_path):
    before = {name: len(rows(tables, name)) for name in ("events", "tests")}
    gone = forget(tables, "car00")
    assert gone == {"inbox": 0, "events": 6, "tests": 1}
    assert {name: len(rows(tables, name)) for name in ("events", "tests")} == {
        "events": before["events"] - 6, "tests": before["tests"] - 1,
    }  # fmt: skip
    assert not [
        path
        for path in tables.rglob("*")
        if path.is_file() and b"car00" in path.read_bytes() and path.suffix == ".parquet"
    ]
    collector, said = Collector(tables, "vans", 1e9), []
    memory = Memory(tmp_path / "0.sqlite", car_of("car00"))
    payload, _ = packed(car_of("car00"), memory.store.outgoing(), memory.store.tally())
    memory.close()
    collector.put(Came("car00", payload, said.append))
    collector.run(lambda: True)
    collector.close()
    assert len(said) == 1
    assert said[0], "it is answered: the car need not keep it either"
    assert "car00" not in {row["car"] for row in rows(tables)}
    assert forget(tables, "car00") == {"inbox": 0, "events": 0, "tests": 0}
