"""J1939: sources of one parameter group are apart. Two healthy ones set no code, and one that falls silent is named."""

import pyarrow.parquet as pq
import pytest
from car import Car, write

from gateway.bus.frames import EXTENDED, empty, put
from gateway.config.load import load_config
from gateway.config.resolve import load_databases
from gateway.signals.database import load_database
from gateway_fleet.learn.observe import Observer
from gateway_logs.decode.parquet_tables import Lake

GROUP = 0x18FEF100
MESSAGE = f'BO_ {(GROUP | 0xFE) | EXTENDED} CCVS: 8 A\n SG_ Speed : 8|16@1+ (0.00390625,0) [0|250] "km/h" B\n'
MESSAGE += 'BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
MESSAGE += 'BA_DEF_DEF_  "VFrameFormat" "J1939PG";\n'
CHECK = '[[bus.check]]\nmessage = "CCVS"\ntimeout_ms = 500\n'
MONITOR = '[[monitor]]\nname = "s"\ntype = "signal"\n'
MONITOR += 'signal = [{ signal = "CCVS.Speed", plausible = [0, 130], gradient = 50 }]\n'
SPEEDS = {0x00: 80, 0x17: 20, 0x21: 50, 0x42: 110}


def drive(car, begin_s, end_s, sources):
    """Feed a frame of each source ten times a second."""
    count = round((end_s - begin_s) * 10)
    frames = empty(count * len(sources))
    for k in range(count):
        for j, source in enumerate(sources):
            data = bytes([0xFF, 0, SPEEDS[source], *[0xFF] * 5])
            t_ns = round((begin_s + k * 0.1 + j * 0.01) * 1e9) + 1
            put(frames, k * len(sources) + j, t_ns, GROUP | source | EXTENDED, data)
    car.gateway.feed(frames)
    return car


@pytest.mark.long
def test_two_healthy_sources_set_no_code_in_an_hour(tmp_path):
    car = drive(Car(write(tmp_path, MESSAGE, CHECK + MONITOR)), 0, 3600, [0x00, 0x17])
    assert car.of("dtc") == []
    assert [event["source"] for event in car.of("source")] == [0x17]


@pytest.mark.parametrize("silent", SPEEDS)
def test_each_of_four_sources_that_falls_silent_is_named_and_heals(tmp_path, silent):
    car = drive(Car(write(tmp_path, MESSAGE, CHECK + MONITOR)), 0, 10, SPEEDS)
    assert car.of("dtc") == []
    drive(car, 10, 12, [source for source in SPEEDS if source != silent])
    (set_,) = [event for event in car.of("dtc") if event["status"] & 1]
    assert set_["fault"] == "b.CCVS.timeout"
    assert set_["evidence"]["source address"] == silent
    assert 10.4e9 < set_["t_ns"] < 10.7e9
    drive(car, 12, 15, SPEEDS)
    assert not car.of("dtc")[-1]["status"] & 1, "all are there again"


def test_after_a_gap_of_the_whole_bus_no_source_is_accused(tmp_path):
    car = drive(Car(write(tmp_path, MESSAGE, MONITOR)), 0, 5, SPEEDS)
    drive(car, 60, 65, SPEEDS)
    assert car.of("dtc") == []


def test_sources_that_a_configuration_names_have_a_mailbox_and_a_timeout_each(tmp_path):
    exact = f"CCVS_0x{GROUP | 0x17:X}"
    tables = CHECK + CHECK.replace("CCVS", exact) + MONITOR.replace("CCVS", exact).replace("130", "10")
    car = drive(Car(write(tmp_path, MESSAGE, tables, more='codes = "own"\n')), 0, 5, [0x00, 0x17])
    assert car.failed() == ["Speed.high"], "20 is beyond [0, 10]"
    assert car.of("source") == []
    drive(car, 5, 7, [0x00])
    assert car.failed()[-1] == f"{exact}.timeout"


def test_learned_is_from_one_source_and_all_are_listed(tmp_path):
    config = load_config(write(tmp_path, MESSAGE, ""))
    observer = Observer(config, load_databases(config), [None])
    frames = empty(200)
    for k in range(200):
        put(frames, k, k * 10**8, GROUP | (0x00, 0x17)[k % 2] | EXTENDED, bytes([0xFF, 0, 80 - k % 2 * 60, 0, 0]))
    observer.read(tmp_path, iter([(frames, 1.0)]), 0.0, lambda *_: None)
    (seen,) = observer.result().seen.values()
    assert seen.sources == {0x00: 100, 0x17: 100}
    assert seen.frames == 100
    assert (seen.courses.each[0].lowest, seen.courses.each[0].highest) == (80, 80)


def test_what_is_sent_by_several_is_one_table_with_its_source(tmp_path):
    write(tmp_path, MESSAGE, "")
    lake = Lake(tmp_path / "lake", [load_database([tmp_path / "car.dbc"])])
    frames = empty(2)
    for k, source in enumerate((0x00, 0x17)):
        put(frames, k, k, GROUP | source | EXTENDED, bytes([0xFF, 0, SPEEDS[source], *[0xFF] * 5]))
    tables = lake.begin("car", "a")
    tables.add(frames)
    rows = pq.read_table(tables.finish().files[0]).drop(["t"]).to_pylist()
    assert rows == [{"sa": 0x00, "Speed": 80.0}, {"sa": 0x17, "Speed": 20.0}]
