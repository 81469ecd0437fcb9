"""DM20, DM21, infotype 08 and the PIDs of distance and time, measured by signals; bytes by hand from the standards.

DM20 (J1939-73, 5.7.20): ignition cycles and general denominator, two bytes each, the low one first; then systems of
seven bytes: SPN, numerator, denominator. DM21 (5.7.21): km with the MIL on, km since the clear, minutes likewise.
"""

import pytest
from rig import FUNCTIONAL, MS, Rig, Tester, write_config
from test_j1939 import ALL, Bus, coded, pgn_id

from gateway.bus.frames import empty, put
from gateway.config.load import load_config
from gateway.runtime.usage_meter import UsageMeter
from gateway_fdi.errors import InputErrors

DM20, DM21, DM11 = 0xC200, 0xC100, 0xFED3
#: Speed is M1 [km/h], engine speed M0, distance M2 [km].
USAGE = """
[usage]
running = [{ signal = "M0.Value", min = 400.0 }]
%s
denominator = [
    { signal = "M0.Value", min = 400.0, seconds = 20.0 },
    { signal = "M1.Value", min = 40.0, seconds = 10.0 },
    { signal = "M1.Value", max = 1.0, seconds = 3.0, at_a_stretch = true },
]
[output.j1939]
address = 0
[output.obd]
"""
SPEED = 'speed = "M1.Value"'
RELATED = "emission_related = true\n"
FAULTS = {
    0: coded(100, 1, RELATED + 'readiness = "egr"\nindicator = true\n'),
    1: coded(101, 1, RELATED + 'readiness = "catalyst"\n'),
    2: coded(102, 1, RELATED + 'readiness = "catalyst"\n'),
    3: coded(103, 1, RELATED + 'readiness = "heated_catalyst"\n'),
}


class Car(Bus):
    """A bus on which a car is driven."""

    def drive(self, seconds, kmh, rpm=2000.0, odometer_km=None):
        """Drive for some time, at 5 frames a second."""
        for n in range(round(seconds * 5)):
            self.value(0, rpm)
            self.value(1, kmh)
            if odometer_km is not None:
                self.value(2, odometer_km + kmh * n / 18_000)
            self.wait(200 - 2 - (odometer_km is not None))

    def heard(self, pgn):
        """Ask all for a message; returns it."""
        (data,) = self.of(pgn, self.request(pgn, destination=ALL, milliseconds=500))
        return data

    def obd(self, request):
        (answer,) = Tester(self).exchange(bytes.fromhex(request))
        return answer.hex()


@pytest.fixture
def make(tmp_path):
    cars = []

    def build(usage=USAGE % SPEED, more="", memory=None):
        cars.append(Car(write_config(tmp_path, 4, extra=usage + more, faults=FAULTS), memory))
        cars[-1].wait(300)
        return cars[-1]

    yield build
    for car in cars:
        car.close()


def system(spn, numerator, denominator):
    return (spn | 0xF80000).to_bytes(3, "little") + numerator.to_bytes(2, "little") + denominator.to_bytes(2, "little")


def head(ignition, conditions):
    return ignition.to_bytes(2, "little") + conditions.to_bytes(2, "little")


def driven(*values):
    return b"".join(value.to_bytes(2, "little") for value in values)


@pytest.mark.evidence("SAE J1939-73: DM20")
def test_a_cycle_counts_when_all_of_the_denominator_is_met(make):
    car = make()
    assert car.heard(DM20) == head(1, 0) + system(3050, 0, 0) + system(3058, 0, 0)
    car.heal(1)
    car.fail(0)
    assert car.heard(DM20) == head(1, 0) + system(3050, 0, 0) + system(3058, 1, 0), "one catalyst was not tested"
    car.heal(2)
    assert car.heard(DM20) == head(1, 0) + system(3050, 1, 0) + system(3058, 1, 0)
    car.drive(12, 50)
    car.drive(2, 0)
    car.drive(1, 20)
    car.drive(2, 0)
    car.drive(5, 20)
    assert car.heard(DM20)[:4] == head(1, 0), "it has never stood for three seconds at a stretch"
    car.drive(4, 0)
    once = head(1, 1) + system(3050, 1, 1) + system(3058, 1, 1)
    assert car.heard(DM20) == once
    car.drive(20, 50)
    car.drive(4, 0)
    assert car.heard(DM20) == once, "once a cycle"
    car.cycle()
    car.drive(1, 50)
    assert car.heard(DM20)[:4] == head(2, 1), "each cycle begins anew"
    car.drive(12, 50)
    car.drive(12, 0)
    assert car.heard(DM20)[:4] == head(2, 2)


def test_neither_a_clear_nor_a_restart_resets_ratios(make, tmp_path):
    memory = tmp_path / "f.sqlite"
    car = make(memory=memory)
    car.heal(1)
    car.heal(2)
    car.drive(12, 50)
    car.drive(12, 0)
    counted = head(1, 1) + system(3050, 1, 1) + system(3058, 1, 1)
    assert car.heard(DM20) == counted
    car.request(DM11, milliseconds=50)
    assert car.heard(DM20) == counted
    car.gateway.stop(car.now)
    car.close()
    car = make(memory=memory)
    assert car.heard(DM20) == head(2, 1) + counted[4:]


@pytest.mark.evidence("SAE J1939-73: DM21", "SAE J1979: 01 21, 31")
def test_distance_and_time_since_the_clear_and_with_the_mil_on(make):
    car = make()
    assert car.heard(DM21) == driven(0, 0, 0, 0)
    car.drive(150, 72)
    assert car.heard(DM21) == driven(0, 3, 0, 2)
    car.fail(0)
    car.value(0, 2000)
    car.drive(100, 72)
    assert car.heard(DM21) == driven(2, 5, 1, 4)
    assert [car.obd(f"01{pid}") for pid in ("21", "31", "4d", "4e")] == ["41210002", "41310005", "414d0001", "414e0004"]
    car.drive(60, 0)
    assert car.heard(DM21) == driven(2, 5, 2, 5), "it stands, and the engine runs"
    car.drive(60, 0, rpm=0)
    assert car.heard(DM21) == driven(2, 5, 2, 5)
    assert car.obd("0100")[4:] != car.obd("0120")[4:]
    car.request(DM11, milliseconds=50)
    assert car.heard(DM21) == driven(0, 0, 0, 0)


def test_silence_is_neither_distance_nor_time(make):
    car = make()
    car.drive(61, 72)
    before = car.gateway.memory.usage.driven()
    car.wait(600_000, step=100)
    after = car.gateway.memory.usage.driven()
    assert after.cleared_s - before.cleared_s <= 1.1, "until the signal is too old"
    assert after.cleared_m - before.cleared_m <= 22


def test_a_replay_counts_the_same_whatever_comes_at_once(make):
    """60 s of a drive in one batch, in tens of frames, and one by one."""
    rows = 600
    counted = []
    for size in (1, 10, rows * 2):
        car = make()
        frames = empty(rows * 2)
        for n in range(rows):
            at = car.now + n * 100 * MS + n * n % 90 * MS
            put(frames, 2 * n, at, 256, (4000 if n % 100 < 80 else 0).to_bytes(2, "little") + bytes(6))
            put(frames, 2 * n + 1, at, 257, (2 * (60 if 100 < n < 400 else 0)).to_bytes(2, "little") + bytes(6))
        for at in range(0, len(frames), size):
            car.gateway.feed(frames[at : at + size])
        car.gateway.advance(car.now + 70_000 * MS)
        counted.append((car.gateway.memory.usage.driven(), car.gateway.memory.performance.conditions))
    assert counted[0] == counted[1] == counted[2]
    assert counted[0][0].cleared_m == pytest.approx(500, abs=5)
    assert counted[0][1] == 1


def test_years_of_silence_are_not_looked_through(make, monkeypatch):
    car = make()
    looks = []
    monkeypatch.setattr(UsageMeter, "look", lambda _: looks.append(car.gateway.engine.now_ns))
    for year in (1, 2):
        car.now = year * 365 * 86_400 * 1000 * MS
        car.value(0, 2000.0)
        car.value(0, 2000.0)
    car.gateway.advance(3 * 365 * 86_400 * 1000 * MS)
    assert 0 < len(looks) < 60


def test_an_odometer_counts_what_it_goes_on_by(make):
    car = make(usage=USAGE % 'odometer = "M2.Value"')
    car.drive(300, 72, odometer_km=1000.0)
    assert car.heard(DM21)[2:4] == driven(6), "in steps of the half kilometres that this signal has"
    car.value(2, 9000.0)
    car.wait(200)
    car.value(2, 500.0)
    car.wait(200)
    assert car.heard(DM21)[2:4] == driven(6), "a new instrument cluster"


def test_what_no_signal_tells_is_not_available(make):
    car = make(usage="[output.j1939]\naddress = 0\n[output.obd]\n")
    assert car.heard(DM21) == b"\xff" * 8
    ((_, _, refused),) = car.messages(car.request(DM20))
    assert refused[0] == 1, "not acknowledged: nobody counts"
    assert car.obd("0908") == "7f0912"
    assert car.obd("0121") == "7f0112"
    car = make(usage='[usage]\nrunning = [{ signal = "M0.Value", min = 400.0 }]\n[output.j1939]\naddress = 0\n')
    assert car.heard(DM21) == bytes.fromhex("FFFFFFFF00000000")


@pytest.mark.evidence("SAE J1979: 09 08")
def test_infotype_08(make):
    car = make()
    car.heal(1)
    car.heal(2)
    car.heal(0)
    car.drive(12, 50)
    car.drive(12, 0)
    one, none = "0001" * 2, "0000" * 2
    #      general, ignition; catalysts; oxygen sensors; EGR; air; evaporative; secondary oxygen sensors
    expected = "00010001" + one + none + none * 2 + one + none + none + none * 2
    assert car.obd("0908") == "49081 4".replace(" ", "") + expected
    assert Tester(car).exchange(b"\x09\x00", functional=FUNCTIONAL)[0].hex() == "490001000000"


def test_a_reload_goes_on_counting(make, tmp_path):
    car = make(memory=tmp_path / "f.sqlite")
    car.drive(12, 50)
    old = car.gateway
    old.finish(car.now)
    car.gateway = type(old)(old.config, store=old.store)
    car.gateway.succeed(old)
    car.drive(12, 0)
    assert car.heard(DM20)[:4] == head(1, 1), "what was met before the reload counts"
    assert car.gateway.memory.usage.driven().cleared_s == pytest.approx(24, abs=1.1)


@pytest.mark.parametrize(
    ("usage", "key"),
    [
        ('cycle = "drivng"', "usage.cycle"),
        ('speed = "M9.Value"', "usage.speed"),
        ('odometer = "M1.Valu"', "usage.odometer"),
        ('speed = "M1.Value"\nodometer = "M2.Value"', "usage"),
        ('running = [{ signal = "M8.Value", min = 1.0 }]', r"usage.running\[0\].signal"),
        ('denominator = [{ signal = "M8.Value", min = 1.0 }]', r"usage.denominator\[0\].signal"),
        ('running = [{ signal = "M1.Value", min = 1.0, rise = 2.0 }]', "rise is for operation cycles"),
        ('denominator = [{ signal = "M1.Value", min = 1.0, secnds = 2.0 }]', "secnds"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, usage, key):
    with pytest.raises(Exception, match=key):
        Rig(write_config(tmp_path, 3, extra=f"[usage]\n{usage}\n")).close()


def test_a_wrong_cycle_is_told_with_the_nearest_right_one(tmp_path):
    cycle = (
        '[cycle.driving]\nbegins = { signal = "M0.Value", min = 9.0 }\nends = { signal = "M0.Value", max = 1.0 }\n'
        '[usage]\ncycle = "drivng"\n'
    )
    with pytest.raises(InputErrors, match="driving") as caught:
        load_config(write_config(tmp_path, 3, extra=cycle))
    assert "did you mean driving" in str(caught.value)


def test_ratios_go_by_a_cycle_of_signals(make):
    cycle = (
        '[cycle.driving]\nbegins = { signal = "M0.Value", min = 400.0 }\nends = { signal = "M0.Value", max = 50.0 }\n'
    )
    usage = USAGE.replace("[usage]", '[usage]\ncycle = "driving"') % SPEED
    car = make(usage=usage, more=cycle)
    assert car.heard(DM20) == head(0, 0) + b"\xff" * 4, "no fault is of this cycle"
    for trip in (1, 2):
        car.drive(12, 50)
        car.drive(12, 0)
        assert car.heard(DM20)[:4] == head(trip, trip)
        car.drive(2, 0, rpm=0)


@pytest.mark.evidence("SAE J1939-73: DM20")
def test_the_id_of_dm20_is_the_one_of_the_standard(make):
    car = make()
    frames = car.request(DM20, milliseconds=0)
    announced = [data for can_id, data in frames if can_id == pgn_id(0xEC00, 0, 0xF9, 7)]
    assert announced[0][5:] == (0xC200).to_bytes(3, "little")
    assert announced[0][1:3] == (4 + 2 * 7).to_bytes(2, "little")
