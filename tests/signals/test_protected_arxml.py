"""ARXML files that say how messages are protected: protection = "auto", frames by autosar-e2e."""

import random

import e2e
import pytest
from arxml import arxml
from car import Car, write
from secured import secured, write_key

from gateway.signals.database import load_database
from gateway_fdi.errors import InputError, InputErrors

IDS = [3 * k + 1 for k in range(16)]
#: Identifier, name, length, first bit of its signal, what the file calls the profile, data ids, by signal group.
MESSAGES = (
    (0x101, "First", 8, 16, "PROFILE_01", [0x1234], False),
    (0x102, "Second", 8, 16, "Profile2", IDS, True),
    (0x104, "Fourth", 16, 96, "PROFILE_04", [0xABCDEF], True),
    (0x105, "Fifth", 8, 24, "PROFILE_05", [0x4321], False),
    (0x106, "Sixth", 8, 40, "P06", [0x77], True),
)
PROTECT = {
    "First": lambda data: e2e.p01.e2e_p01_protect(data, 0x1234),
    "Second": lambda data: e2e.p02.e2e_p02_protect(data, bytes(IDS)),
    "Fourth": lambda data: e2e.p04.e2e_p04_protect(data, 0xABCDEF),
    "Fifth": lambda data: e2e.p05.e2e_p05_protect(data, 0x4321),
    "Sixth": lambda data: e2e.p06.e2e_p06_protect(data, 0x77),
}


@pytest.fixture
def config(tmp_path):
    checks = "".join(f'    {{ message = "{name}", protection = "auto" }},\n' for _, name, *_ in MESSAGES)
    path = write(tmp_path, "", "", more=f'codes = "own"\ncheck = [\n{checks}]\n', name="car.dbc")
    (tmp_path / "car.arxml").write_text(arxml(MESSAGES))
    path.write_text(path.read_text().replace("car.dbc", "car.arxml"))
    return path


def frames(name, length, at, count, seed=1):
    """Return frames as autosar-e2e protects them, with random signals behind the header."""
    rng, data, made = random.Random(f"{name} {seed}"), bytearray(length), []
    for _ in range(count):
        data[at // 8 :] = rng.randbytes(length - at // 8)
        PROTECT[name](data)
        made.append(bytes(data))
    return made


def test_what_cantools_reads_of_such_a_file(config):
    database = load_database([config.parent / "car.arxml"])
    for _, name, length, _, profile, ids, _ in MESSAGES:
        said = database.message(name).autosar.e2e
        assert (said.category, said.data_ids, said.payload_length) == (profile, ids, length)


def test_it_says_what_was_taken_and_what_such_a_file_does_not_tell(config):
    first, second, fourth, *_ = Car(config).gateway.notes
    assert first == (
        'b.First: e2e = { profile = "P01", data_id = 4660 }, as the ARXML file says: PROFILE_01; '
        'data_id_mode and offset are not read of it: "both" and 0'
    )
    assert second.startswith('b.Second: e2e = { profile = "P02", data_ids = [1, 4, 7,')
    assert fourth.endswith("as the ARXML file says: PROFILE_04; offset is not read of it: 0")


@pytest.mark.parametrize(("can_id", "name", "length", "at"), [message[:4] for message in MESSAGES])
def test_frames_of_autosar_e2e_are_accepted_and_flipped_bits_refused(config, can_id, name, length, at):
    car = Car(config)
    car.feed(frames(name, length, at, 300), can_id=can_id)
    assert car.failed() == []
    assert car.gateway.engine.counters()["crc_failed"] == 0
    good = frames(name, length, at, 301)[-1]
    for bit in range(8 * length):
        broken = bytearray(good)
        broken[bit // 8] ^= 1 << bit % 8
        car.feed([broken], can_id=can_id)
        assert car.gateway.engine.counters()["crc_failed"] == bit + 1, f"bit {bit}"
    assert car.failed() == [f"{name}.crc"]


def test_another_mode_than_the_one_taken_is_named(config):
    data, made = bytearray(8), []
    for k in range(40):
        data[5] = k
        e2e.p01.e2e_p01_protect(data, 0x1234, data_id_mode=e2e.p01.E2E_P01_DATAID_LOW)
        made.append(bytes(data))
    car = Car(config).feed(made, can_id=0x101)
    assert car.failed() == ["First.rule"]
    (told,) = car.of("protection")
    assert 'e2e = { profile = "P01", data_id = 4660, data_id_mode = "low" }' in told["fits"]


def secured_car(folder, *, mac=24, keys='profile = "database", key = "key"'):
    """Return the configuration of a message whose SecOC an ARXML file says: 48 of 56 bits are no profile's."""
    write_key(folder)
    path = write(folder, "", f'[[bus.check]]\nmessage = "M"\nsecoc = {{ {keys} }}\n', name="car.dbc")
    what = {"M": (12, 0x2F, 48, 16, mac)}
    (folder / "car.arxml").write_text(arxml([(0x101, "M", 4, 0, "", [], False)], what))
    path.write_text(path.read_text().replace("car.dbc", "car.arxml"))
    return path


def test_secoc_is_what_the_arxml_file_says(tmp_path):
    car = Car(secured_car(tmp_path))
    rng = random.Random(7)
    made = [
        secured(rng.randbytes(4), k, data_id=0x2F, length=12, bits=48, truncated=16, mac=24) for k in range(60)
    ]  # seed 7; by cantools and cryptography
    car.feed(made[:50], can_id=0x101)
    assert car.failed() == []
    assert car.gateway.engine.counters()["crc_failed"] == 0
    wrong = [frame[:7] + bytes([frame[7] ^ 1]) + frame[8:] for frame in made[50:]]
    assert [fault.rpartition(".")[2] for fault in car.feed(wrong, can_id=0x101).failed()] == ["mac"]


def test_auto_says_that_secoc_wants_a_key(tmp_path):
    path = secured_car(tmp_path)
    text = path.read_text()
    path.write_text(text[: text.index("secoc")] + 'protection = "auto"\n')
    assert Car(path).gateway.notes[0] == 'b.M: nothing: SecOC wants a key, secoc = { profile = "database", key = ... }'


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"mac": None}, "does not say mac of M"),
        ({"mac": 8}, "SecOC of M: Input should be greater than or equal to 16"),
        ({"keys": 'profile = 1, key = "key"'}, "data_id: 16 bits"),
    ],
)
def test_what_the_arxml_file_lacks_of_secoc_is_told(tmp_path, how, said):
    with pytest.raises((InputError, InputErrors), match=said):
        Car(secured_car(tmp_path, **how))
