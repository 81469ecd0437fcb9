"""Requests on an event: the start, conditions of signals that become met, a DTC that came."""

import pytest
from asking_rig import BUS, Car, Ecu, settled, write

from gateway_fdi.errors import InputError, InputErrors

STATE = 'VERSION ""\nBU_: A\nBO_ 256 State: 8 A\n SG_ Speed : 0|16@1+ (0.01,0) [0|655] "km/h" A\n'
ECU = """database = ["state.dbc"]
[[ecu]]
name = "engine"
request = 0x7E0
response = 0x7E8
signals = ["cells.dbc"]
read = [{{ {read} }}]
{more}
[clock]
watched = false
"""
ANSWERS = {
    "222101": "622101 0102", "1902AF": "5902FF", "19040133 00FF": "7F1931", "19060133 00FF": "7F1931",
    "22F40D": "7F2231", "010D": "410D32", "22F400": "62F40008080001",
}  # fmt: skip


def car(folder, read, answers=ANSWERS, more=""):
    (folder / "state.dbc").write_text(STATE)
    known = {bytes.fromhex(asked): bytes.fromhex(said) for asked, said in answers.items()}
    ecu = Ecu(0x7E0, 0x7E8, lambda request: [(2, known[request])] if request in known else [])
    return Car(write(folder, BUS + ECU.format(read=read, more=more)), [ecu]), known


def times(found, request="222101"):
    return [t for t, _, data in found.requests if data.hex() == request.lower()]


def speed(value, *milliseconds):
    return [(t, 0x100, round(100 * value).to_bytes(2, "little") + bytes(6)) for t in milliseconds]


def test_a_value_is_read_once_after_the_start_and_again_where_nobody_answered(tmp_path):
    found, known = car(tmp_path, 'did = 0x2101, on = "start"')
    found.run(3000)
    assert len(times(found)) == 1
    late, known = car(tmp_path, 'did = 0x2101, on = "start"', {})
    late.run(5000)
    assert 3 <= len(times(late)) <= 6, "no storm"
    known |= {bytes.fromhex("222101"): bytes.fromhex("6221010102")}
    asked = len(times(late))
    late.run(9000)
    assert len(times(late)) == asked + 1
    assert settled(late.state())


def test_a_value_is_read_each_time_that_a_signal_comes_into_a_range(tmp_path):
    found, _ = car(tmp_path, 'did = 0x2101, on = "when", when = [{ signal = "State.Speed", min = 50 }]')
    found.run(1000, *speed(0, *range(0, 1000, 50)))
    assert times(found) == []
    found.run(2000, *speed(60, *range(0, 2000, 50)))
    found.run(1000, *speed(0, *range(0, 1000, 50)))
    found.run(1000, *speed(60, *range(0, 1000, 50)))
    first, second = times(found)
    assert 1000 <= first <= 1250
    assert 4000 <= second <= 4250
    found.run(5000)
    assert len(times(found)) == 2, "values that are not fresh are none"


def test_an_event_that_comes_again_and_again_is_no_storm(tmp_path):
    """A speed that comes into the range five times a second, and a DTC that comes and goes each second."""
    flaps = sorted(speed(60, *range(0, 6000, 200)) + speed(0, *range(100, 6000, 200)))
    for bound, most in (("", 6), (", every_ms = 4500", 2)):
        found, _ = car(tmp_path, f'did = 0x2101, on = "when", when = [{{ signal = "State.Speed", min = 50 }}]{bound}')
        asked = times(found.run(6000, *flaps))
        assert most - 1 <= len(asked) <= most
        found, known = car(tmp_path, f'did = 0x2101, on = "dtc"{bound}', more="dtcs = { every_s = 1 }")
        for k in range(9):
            known[bytes.fromhex("1902AF")] = bytes.fromhex("5902FF 013300 2F" if k % 2 else "5902FF")
            found.run(1000)
        came = [e for e in found.events if e["event"] == "ecu_dtc" and e["state"] == "came"]
        assert (len(came), len(times(found))) == (4, 2 if bound else 4)


def test_a_value_is_read_by_time_while_conditions_are_met(tmp_path):
    found, _ = car(tmp_path, 'did = 0x2101, every_ms = 200, when = [{ signal = "State.Speed", min = 50 }]')
    found.run(2000, *speed(60, *range(0, 1000, 50)), *speed(0, *range(1000, 2000, 50)))
    assert 2 <= len(times(found)) <= 6
    assert max(times(found)) <= 1250


def test_a_value_is_read_when_a_dtc_of_the_ecu_comes(tmp_path):
    found, known = car(tmp_path, 'did = 0x2101, on = "dtc"', more="dtcs = { every_s = 1 }")
    found.run(3000)
    assert times(found) == []
    known[bytes.fromhex("1902AF")] = bytes.fromhex("5902FF 013300 2F")
    found.run(4000)
    assert [e["state"] for e in found.events if e["event"] == "ecu_dtc"] == ["came"]
    assert len(times(found)) == 1


def test_a_value_is_read_when_a_fault_of_ours_comes_by_the_protocol_that_answers(tmp_path):
    more = '[[bus.check]]\nmessage = "State"\ntimeout_ms = 300\n'
    toml = ECU.replace("[[ecu]]", more + "[[ecu]]", 1)
    (tmp_path / "state.dbc").write_text(STATE)
    known = {bytes.fromhex(asked): bytes.fromhex(said) for asked, said in ANSWERS.items()}
    ecu = Ecu(0x7E0, 0x7E8, lambda request: [(2, known[request])] if request in known else [])
    text = toml.format(read='pid = 0x0D, on = "dtc"', more="")
    found = Car(write(tmp_path, BUS + text), [ecu])
    found.run(2000, *speed(0, *range(0, 1000, 50)))
    asked = [data.hex() for *_, data in found.requests]
    assert "dtc" in {e["event"] for e in found.events}
    assert [asked.count(each) for each in ("22f40d", "010d")] == [1, 1], "refused, and asked in the other form once"


@pytest.mark.parametrize(
    ("read", "said"),
    [
        ("did = 5", "every_ms, or on"),
        ('did = 5, every_ms = 100, on = "start"', "every_ms, or on"),
        ('did = 5, on = "when", every_ms = 5', "every_ms"),
        ('did = 5, on = "when"', "needs its conditions"),
        ('did = 5, on = "start", when = [{ signal = "X.Y", min = 1 }]', "ecu[0].read[0].when[0].signal"),
    ],
)
def test_what_cannot_be_is_named(tmp_path, read, said):
    with pytest.raises((InputError, InputErrors)) as caught:
        car(tmp_path, read)
    assert said in str(caught.value)
