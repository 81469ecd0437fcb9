"""Frames that are shorter than their database says: what is in them is tested, the database is told of, once."""

import pytest
from car import Car, write

from gateway.monitors.contract import NOT_TESTED

MESSAGE = (
    'BO_ 256 M: 8 A\n SG_ First : 0|16@1+ (1,0) [0|0] "" B\n'
    ' SG_ Last : 48|16@1+ (1,0) [0|0] "" B\n SG_ Crc : 56|8@1+ (1,0) [0|0] "" B\n'
)
MONITORS = """[[bus.check]]
message = "M"
timeout_ms = 500
[[monitor]]
name = "first"
type = "signal"
signal = [{ signal = "M.First", plausible = [0, 10] }]
[[monitor]]
name = "last"
type = "signal"
signal = [{ signal = "M.Last", plausible = [0, 10] }]
"""


@pytest.fixture
def car(tmp_path):
    return Car(write(tmp_path, MESSAGE, MONITORS))


def stepped(car):
    return [int(count) for count in car.gateway.engine.tables.handlers["steps"]]


def test_what_is_in_short_frames_is_tested_and_the_sender_is_not_accused(car):
    car.feed([bytes([200, 0, 0, 0, 0, 0])] * 1500)
    assert [name.split(".")[-1] for name in car.failed()] == ["high"], "200 is beyond [0, 10]"
    tables = car.gateway.engine.tables
    of_last = [k for k, slot in enumerate(car.gateway.engine.faults) if slot.id.startswith("last.")]
    assert of_last
    assert (tables.debounces["last"][of_last] == NOT_TESTED).all()
    assert car.gateway.engine.counters()["results_no_number"] == 0
    (told,) = car.of("short_frames")
    del told["t_ns"]
    assert told == {
        "event": "short_frames", "bus": "b", "message": "M", "length": 6, "database": 8, "signals": ["Last"],
    }  # fmt: skip


def test_a_sender_whose_frames_become_shorter_is_accused_and_they_are_not_used(car):
    car.feed([bytes(8)] * 20 + [bytes([200, 0, 0, 0, 0, 0])] * 20)
    assert car.failed() == ["M.length"]
    assert stepped(car) == [20, 20]
    assert car.of("short_frames") == []


def test_frames_that_always_were_short_fail_where_the_configuration_names_that_fault(tmp_path):
    car = Car(write(tmp_path, MESSAGE, MONITORS + '[fault."b.M.length"]\ndtc = "U0401-81"\n'))
    car.feed([bytes([200, 0, 0, 0, 0, 0])] * 20)
    assert car.failed() == ["M.length"]
    assert stepped(car) == [0, 0], "they are not used"


def test_a_value_of_before_counts_no_more_when_frames_end_before_it(tmp_path):
    """Of a monitor of two messages: the other one comes, this one comes short."""
    other = 'BO_ 257 N: 8 A\n SG_ Value : 0|16@1+ (1,0) [0|0] "" B\n'
    rule = '[[monitor]]\nname = "r"\ntype = "rule"\nrule = [{ name = "both", holds = "M.Last == N.Value" }]\n'
    car = Car(write(tmp_path, MESSAGE + other, rule))
    car.feed([bytes(8)] * 5).feed([bytes(8)] * 5, can_id=257)
    before = stepped(car)
    assert before[0] > 0
    car.feed([bytes(6)] * 5).feed([bytes(8)] * 5, can_id=257)
    assert stepped(car) == before, "it is not tested"
    assert not car.failed()
    car.feed([bytes(8)] * 5)
    assert stepped(car) > before


@pytest.mark.parametrize("longer", [False, True])
def test_a_checksum_beyond_the_end_is_not_tested_but_cannot_be_left_away(tmp_path, longer):
    check = MONITORS.replace("timeout_ms = 500", 'length = false\nchecksum = { rule = "xor", signal = "Crc" }')
    car = Car(write(tmp_path, MESSAGE.replace(" SG_ Last : 48|16", " SG_ Last : 40|16"), check))
    car.feed([bytes(8)] * 40 * longer + [bytes(7)] * 40)
    assert stepped(car) == [40, 40], "after frames with a checksum those without one are not used"
    assert car.failed() == []
