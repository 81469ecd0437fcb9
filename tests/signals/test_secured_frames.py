"""SecOC through a whole gateway: frames that other programs made, and what may happen to them."""

import random

import numpy as np
import pytest
from car import Car as AnyCar
from car import write as write_tables
from secured import KEY, secured, tag, write_key

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_commands.validation import mistakes

M = 'BO_ 256 M: 8 A\n SG_ Speed : 0|16@1+ (1,0) [0|0] "" B\n'
SYNC = 'BO_ 512 FV: 8 A\n SG_ Trip : 7|16@0+ (1,0) [0|0] "" B\n'
ONE = 'profile = 1, data_id = 0x12, key = "key"'
SPEED = '[[monitor]]\nname = "s"\ntype = "signal"\nsignal = [{ signal = "M.Speed", plausible = [0, 1000] }]\n'
TRIP, RESET = 16, 20


class Car(AnyCar):
    """A car whose checks are told by their names alone, and whose used frames can be counted."""

    def failed(self):
        return [fault.split(".", 1)[1] for fault in super().failed()]

    def count(self, name):
        return self.gateway.engine.counters()[name]


def write(folder, secoc=ONE, more=""):
    write_key(folder)
    tables = f'[[bus.check]]\nmessage = "M"\nsecoc = {{ {secoc} }}\n{more}'
    return write_tables(folder, M + SYNC, tables)


def frames(values, seed=1, **keys):
    rng = random.Random(seed)
    return [secured(rng.randbytes(4), value, **keys) for value in values]


@pytest.fixture
def car(tmp_path):
    return Car(write(tmp_path))


def test_a_healthy_sender_is_silent_over_every_roll_over(car):
    car.feed(frames(range(1200)))
    assert car.failed() == []
    assert car.count("crc_failed") == car.count("repeated") == car.count("unsynchronised") == 0


@pytest.mark.parametrize("bit", range(0, 64, 9))
def test_a_flipped_bit_is_the_mac_s_fault(car, bit):
    good = frames(range(40))
    for k in (20, 21, 22):
        broken = bytearray(good[k])
        broken[bit // 8] ^= 1 << bit % 8
        good[k] = bytes(broken)
    assert car.feed(good).failed() == ["mac"]
    assert car.count("crc_failed") == 3


def test_lost_frames_are_no_fault_as_many_as_attempts_reach(car):
    car.feed(frames([*range(100), *range(100 + 3 * 256 - 10, 900)]))
    assert car.failed() == []
    assert car.count("crc_failed") == 0


@pytest.mark.evidence("AUTOSAR E2E: SecOC freshness")
def test_a_replay_is_the_freshness_s_fault_and_is_not_used(car):
    sent = frames(range(300))
    car.feed(sent).feed(sent[280:290])
    assert car.failed() == ["freshness"]
    assert car.count("repeated") == 10
    car.feed(frames(range(300, 360)))
    assert not car.gateway.engine.tables.debounces["active"].any(), "the true sender heals it"


def test_a_replay_beyond_what_is_tried_is_not_used_either(car):
    sent = frames(range(3000))
    car.feed(sent).feed(sent[300:310])
    assert car.failed() == ["mac"], "no value that was tried is right"
    assert car.count("crc_failed") == 10


def test_a_counter_that_begins_anew_is_told_so(car):
    car.feed(frames(range(1000))).feed(frames(range(30), seed=2))
    assert car.failed() == ["freshness"]


def test_a_wrong_key_accuses_the_configuration_and_a_changed_one_the_sender(tmp_path):
    other = Car(write(tmp_path, f"{ONE}, start = 0")).feed(frames(range(1100), key=bytes(16)))
    assert other.failed() == ["rule"]
    assert other.of("protection")[0]["fits"] == []
    car = Car(write(tmp_path)).feed(frames(range(50))).feed(frames(range(50, 60), key=bytes(16)))
    assert car.failed() == ["mac"]


@pytest.mark.evidence("AUTOSAR E2E: SecOC forged")
def test_what_is_forged_never_reaches_a_monitor(tmp_path):
    path = write(tmp_path, more=SPEED)
    good = [secured((5).to_bytes(2, "little") + b"\0\0", k) for k in range(300)]
    forged = [b"\xff\xff" + each[2:] for each in good[30:]]
    assert Car(path).feed(good[:30]).feed(forged).failed() == ["mac"]
    high = [secured(b"\xff\xff\0\0", k) for k in range(30, 300)]
    assert Car(path).feed(good[:30]).feed(high).failed() == ["high"], "or the test shows nothing"


@pytest.mark.evidence("AUTOSAR E2E: SecOC restart")
def test_freshness_survives_a_restart(tmp_path):
    memory, sent = tmp_path / "faults.sqlite", frames(range(400))
    first = Car(write(tmp_path), memory=memory).feed(sent[:350])
    first.gateway.stop(first.t_ns)
    first.gateway.close()
    again = Car(tmp_path / "gateway.toml", memory=memory).feed(sent[300:340])
    assert again.failed() == ["freshness"], "what was sent before is not new"
    assert again.feed(sent[350:]).count("repeated") == 40
    assert again.count("unsynchronised") == 0


@pytest.mark.evidence("Healthy parts: SecOC sender")
def test_a_sender_that_went_on_unheard_is_found_again_and_never_accused(tmp_path):
    memory = tmp_path / "faults.sqlite"
    first = Car(write(tmp_path), memory=memory).feed(frames(range(50)))
    first.gateway.stop(first.t_ns)
    first.gateway.close()
    far = 50_000
    car = Car(tmp_path / "gateway.toml", memory=memory).feed(frames(range(far, far + 60)))
    assert car.failed() == []
    assert 1 <= car.count("unsynchronised") <= far // 256 // 64 + 3
    assert car.feed(frames(range(far + 60, far + 400))).failed() == []


def test_losses_on_our_side_are_no_fault_of_the_sender(car):
    car.feed(frames(range(50)))
    car.gateway.engine.hear_again()
    car.feed(frames(range(5000, 5200)))
    assert car.failed() == []


def test_a_reload_goes_on(tmp_path):
    path, sent = write(tmp_path), frames(range(100))
    config = load_config(path)
    old = Car(path).feed(sent[:50])
    old.gateway.finish(old.t_ns)
    new = Gateway(config, parts=prepare(config), store=old.gateway.store)
    new.succeed(old.gateway)
    old.gateway = new
    new.listen(old.events.append)
    old.feed(sent[40:50])
    assert old.failed() == ["freshness"]
    old.feed(sent[50:])
    assert old.count("repeated") == 10
    assert old.count("unsynchronised") == 0


def epoch(trip, reset):
    return trip << RESET | reset


def synced(value, number):
    return value << 28 | number << 2 | value & 3


def master(value, key=KEY):
    made = tag(key, b"\0\x99" + (value << 4).to_bytes(5, "big"))
    return (value << 28 | int.from_bytes(made, "big") >> 100).to_bytes(8, "big")


THREE = 'profile = 3, data_id = 0x12, key = "key", sync = "FV"'
FV = """[[bus.check]]
message = "FV"
lost = "U0102"
invalid = "U0403"
secoc = { profile = "sync", data_id = 0x99, key = "key" }
"""


@pytest.fixture
def three(tmp_path):
    return Car(write(tmp_path, THREE, FV))


def of(value, numbers, seed=1):
    return frames([synced(value, n) for n in numbers], seed, truncated=4, mac=28)


def test_profile_3_over_resets_trips_and_late_master_messages(three):
    three.feed(of(epoch(7, 3), range(1, 4)))
    assert three.count("unsynchronised") == 3, "nothing is known before the master's message"
    three.feed([master(epoch(7, 3))], 0x200)
    three.feed(of(epoch(7, 3), range(4, 30)))
    three.feed(of(epoch(7, 4), range(1, 12)))  # the sender knows of the reset before we do
    three.feed([master(epoch(7, 4))], 0x200)
    three.feed(of(epoch(7, 4), range(12, 20)))
    three.feed([master(epoch(7, 5))], 0x200)
    three.feed(of(epoch(7, 4), range(20, 24)))  # or after we do
    three.feed(of(epoch(7, 5), range(1, 9)))
    three.feed([master(epoch(8, 1))], 0x200)
    three.feed(of(epoch(7, 5), range(9, 11)))  # the trip before
    three.feed(of(epoch(8, 1), range(1, 40)))
    assert three.failed() == []
    assert three.count("crc_failed") == three.count("repeated") == 0


def test_profile_3_replays_and_forgeries(three):
    three.feed([master(epoch(7, 3))], 0x200)
    sent = of(epoch(7, 3), range(1, 40))
    three.feed(sent).feed(sent[-4:])
    assert three.failed() == ["freshness"]
    three.feed([master(epoch(7, 3))] * 2, 0x200)
    assert [e["fault"] for e in three.of("dtc")][-1] == "b.FV.freshness", "an old master's message"
    three.feed([master(epoch(9, 1), bytes(16))] * 3, 0x200)
    three.feed(of(epoch(7, 3), range(40, 60)))
    assert three.count("unsynchronised") == 0


def test_profile_2_has_no_freshness_so_a_replay_passes(tmp_path):
    car, rng = Car(write(tmp_path, ONE.replace("1", "2", 1))), random.Random(3)
    payloads = [rng.randbytes(5) for _ in range(50)]
    sent = [each + tag(KEY, b"\0\x12" + each)[:3] for each in payloads]
    assert car.feed(sent).feed(sent[:10]).failed() == []
    assert car.feed([bytes([each[0] ^ 1]) + each[1:] for each in sent[:3]]).failed() == ["mac"]


WRONG = {
    ONE.replace('"key"', '"nokey"'): ("secoc.key = ", "no key can be read here"),
    ONE.replace('"key"', '"open"'): ("secoc.key = ", "others can read this key: chmod 600"),
    ONE.replace('"key"', '"short"'): ("secoc.key = ", "a key is 32 hex digits"),
    f"{ONE}, mac = 64": ("secoc.mac = 64", "have 9 bytes, the message 8"),
    f"{ONE}, authentic = 5": ("secoc.authentic = 5", "have 4 bytes, the message 8"),
    f"{ONE}, truncated = 9, freshness = 8": ("secoc", "truncated: 9 of 8 bits"),
    f"{ONE}, trip = 3": ("secoc", "profile 1 has no trip"),
    ONE.replace("1", "3", 1): ("secoc", "profile 3 needs sync"),
    THREE: ("secoc.sync = 'FV'", 'no check of a message of that name with secoc = { profile = "sync"'),
    f'{ONE} }}\ncounter = {{ signal = "Speed"': ("check[0]", "secoc a freshness value"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_mistakes_are_told_in_one_line(wrong, tmp_path):
    path = write(tmp_path, wrong)
    write_key(tmp_path, name="open", mode=0o644)
    write_key(tmp_path, bytes(8), name="short")
    (found,) = mistakes(path)
    key, text = WRONG[wrong]
    assert "gateway.toml: bus[0].check[0]" in str(found)
    assert key in str(found)
    assert text in str(found)


SCENARIO = """
name = "secured"
seed = 5
duration_s = 6.0
config = "gateway.toml"
[[ecu]]
type = "restbus"
messages = ["M", "FV"]
cycle_ms = 10
[[ecu.message]]
name = "FV"
period_ms = 100
"""


@pytest.mark.parametrize(
    ("secoc", "fault", "failed"),
    [
        (ONE, "", []),
        (THREE, "", []),
        (ONE, 'kind = "offset"\nsignal = "M.Speed"\nsize = 3.0', []),
        (ONE, 'kind = "checksum"\nmessage = "M"', ["mac"]),
        (ONE, 'kind = "counter"\nmessage = "M"\nsize = -1', ["freshness"]),
        (THREE, 'kind = "counter"\nmessage = "M"\nsize = 0', ["freshness"]),
        (ONE, 'kind = "lost"\nmessage = "M"\nprobability = 0.5', []),
    ],
)
def test_virtual_ecus_send_it_and_break_it(secoc, fault, failed, tmp_path):
    write(tmp_path, secoc, FV)
    text = SCENARIO + (f"[[fault]]\n{fault}\nfrom_s = 2.0\nto_s = 3.0\n" if fault else "")
    (tmp_path / "scenario.toml").write_text(text)
    scenario = load_scenario(tmp_path / "scenario.toml")
    config = load_config(scenario.config)
    sent = player_of(scenario, config).frames
    gateway, events = Gateway(config), []
    gateway.listen(events.append)
    gateway.start(0)
    gateway.feed(sent)
    told = [e["fault"] for e in events if e["event"] == "dtc" and e["status"] & 1]
    assert list(dict.fromkeys(each.rpartition(".")[2] for each in told)) == failed
    assert np.isin([0x100, 0x200], sent["can_id"]).all()
