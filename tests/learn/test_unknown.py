"""Identifiers that no database has: what is claimed of their bytes, beside the truth, and that it runs."""

import tomllib

import numpy as np
import pytest
from cantools.database import load_file
from command import command
from learning import asked, drive, quiet

from gateway.bus.frames import EXTENDED
from gateway.config.load import load_config
from gateway.signals.decode import of_a_tester
from gateway_fleet.learn.car import Asking, asked_for, learned
from gateway_fleet.learn.learn import learn, write
from gateway_fleet.learn.lines import HEALTH
from gateway_fleet.learn.merge import read
from gateway_fleet.learn.protection_check import Payloads
from gateway_fleet.learn.unknown import message_of, with_counter
from gateway_fleet.study.learn.drive import Way
from gateway_fleet.study.learn.judge import healthy, judged
from gateway_fleet.study.learn.network import Network, network


@pytest.mark.long
@pytest.mark.parametrize("seed", [7100, 7101])
def test_no_claim_of_a_car_without_a_database_is_wrong(tmp_path, seed):
    """A third of a virtual car's messages, 4 % of the frames lost, pauses: claims beside what the sender does."""
    net = Network(network(seed).messages[::3])
    out, claims = judged(tmp_path, net, seed, 120.0, Way(lost=0.04, pauses=4), database=False)
    assert claims.wrong == [], f"seed {seed}"
    assert claims.true >= 15, f"seed {seed}"
    assert claims.found >= 0.9 * claims.true, f"seed {seed}: {claims.missed}"
    assert not healthy(out, net, seed + 1, 60.0, Way()), f"seed {seed}"


def frames(values, length=8):
    """Return payloads whose fields are given: (first bit, values)."""
    words = np.zeros((len(values[0][1]), 8), np.uint64)
    for start, column in values:
        words[:, 0] |= np.asarray(column).astype(np.uint64) << np.uint64(start)
    return Payloads(words, np.full(len(words), length))


def counted(payloads):
    message, note = with_counter(message_of(0x123, ()), payloads, np.ones(len(payloads) - 1, np.bool_), None)
    return [(signal.name, signal.start, signal.length) for signal in message.signals], note


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_which_bits_count(seed):
    rng, k = np.random.default_rng(seed), np.arange(1200)
    noise, slow = rng.integers(0, 256, 1200), k // 100
    for start, bits, modulus in ((48, 4, 16), (52, 4, 15), (50, 2, 4), (48, 8, 256), (49, 3, 8)):
        other = [(0, noise), (8, slow), (40, noise)]
        other += [(52, slow % 16)] if start + bits <= 52 else []
        found, note = counted(frames([*other, (start, k % modulus)]))
        assert found == [("BYTE6_COUNTER", start, bits)], f"seed {seed}: {modulus} values {note}"
    assert counted(frames([(0, noise), (8, k % 60)])) == ([], ""), "a clock"
    assert counted(frames([(0, noise), (8, k % 200)])) == ([], ""), "nor a part of what goes up"
    assert counted(frames([(0, noise), (8, 5 * k % 256)])) == ([], ""), "its lowest two bits go up by one"
    assert counted(frames([(0, noise), (8, k // 2 % 256)])) == ([], ""), "each value twice"
    found, note = counted(frames([(8, k % 16), (16, (k + 5) % 16)]))
    assert not found
    assert "count alike" in note, "a sum of constants and the counter counts, too"


def test_frames_of_a_tester_are_no_messages():
    """They come when somebody asks."""
    assert [of_a_tester(can_id) for can_id in (0x7DF, 0x7E8, 0x6FF, EXTENDED | 0x18DAF110, EXTENDED | 0x18FF0110)] == [
        True, True, False, True, False,
    ]  # fmt: skip
    assert message_of(EXTENDED | 0x18FF0110, ()).is_extended_frame
    assert message_of(0x140, {"ID_140"}).name == "ID_140_"


def alive(k):
    body = [k * k * 7 >> 2 & 0xFF, (k >> 8) * 7 & 0xFF, (k * k >> 3) & 0xFF, 0, 0, 0, k % 16]
    return bytes([*body, sum(body) + 9 & 0xFF])


def odd(k):
    return bytes([3, k // 40 % 2]) if k != 77 else bytes([3])


MESSAGES = [
    (0x140, 0.02, alive, 0.0), (EXTENDED | 0x18FF0142, 0.05, lambda k: bytes([k // 9 % 5] * 4), 0.003),
    (0x333, 0.1, odd, 0.001), (0x7E8, 0.1, lambda k: bytes([2, 0x41, 0, 0, 0, 0, 0, 0]), 0.002),
]  # fmt: skip


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


def health_after(out, rows):
    """Return the bus's health after another drive was added, and what is told of the update."""
    log = out.with_name("drive.log")
    drive(log, 16.0, rows)
    result = learned(asked_for((), [log], out, Asking(update=out.exists())), quiet)
    return tomllib.loads(out.read_text())["bus"][0].get("health"), result.changes


@pytest.mark.long
@pytest.mark.parametrize("own", [False, True])
def test_an_update_knows_what_came_and_keeps_a_person_s_health(own, tmp_path):
    out, seldom = tmp_path / "car.toml", MESSAGES[1][2]
    first, _ = health_after(out, [MESSAGES[0], (0x2AA, 7.0, seldom, 0.0)])
    assert first == {"sleeps": True, "unknown": "tell", "known": [0x2AA]}
    if own:
        out.write_text(out.read_text().replace('unknown = "tell"', 'unknown = "fault"'))
    now, changes = health_after(out, [MESSAGES[0], (0x2AB, 7.0, seldom, 0.0)])
    told = [change for change in changes if "0x2AB" in change]
    if own:
        assert now == {"sleeps": True, "unknown": "fault", "known": [0x2AA]}
        assert told == ["can0: 0x2AB came, and `health`, a person's, does not know it"]
        return
    assert now == {"sleeps": True, "unknown": "tell", "known": [0x2AA, 0x2AB]}
    text = out.read_text()
    out.write_text("".join(line for line in text.splitlines(True) if not line.startswith("health")))
    assert health_after(out, [MESSAGES[0]])[0] is None, "taken out by hand: it stays out"


def test_a_person_s_table_of_health_is_found():
    lines = '[[bus]]\nname = "a"\nhealth = { unknown = "tell" }  # x\n[[bus]]\nname = "b"\n[bus.health]\nknown = [1]\n'
    found = read(lines).found
    assert found["a", HEALTH, HEALTH].keys == {"unknown": "tell"}
    assert found["b", HEALTH, HEALTH].number == -1


@pytest.mark.long
def test_a_log_alone_makes_a_configuration_that_runs_and_is_updated(tmp_path, run):
    drive(tmp_path / "drive.log", 40.0, MESSAGES)
    said = run("learn", "drive.log", "-o", "car.toml")
    assert said.code == 0, said.err
    (bus,) = tomllib.loads((tmp_path / "car.toml").read_text())["bus"]
    assert bus["database"] == ["car.learned.can0.dbc"]
    checks = {check.pop("message"): check for check in bus["check"]}
    assert set(checks) == {"ID_140", "ID_18FF0142x", "ID_333"}
    assert checks["ID_140"]["counter"] == {"signal": "BYTE6_COUNTER"}
    assert checks["ID_140"]["checksum"]["signal"] == "byte 7"
    assert 100.0 <= checks["ID_140"]["timeout_ms"] <= 200.0
    assert checks["ID_140"]["length"] == 8, "the only one that came"
    assert checks["ID_333"]["length"] is False, "it came shorter"
    own = {message.name: message for message in load_file(tmp_path / "car.learned.can0.dbc").messages}
    assert (own["ID_18FF0142x"].frame_id, own["ID_18FF0142x"].is_extended_frame) == (0x18FF0142, True)
    assert [own[name].length for name in ("ID_140", "ID_18FF0142x", "ID_333")] == [8, 4, 2]
    page = (tmp_path / "car.md").read_text()
    assert "0x7E8" in page, "told, and nothing is asked of it"
    assert "ID_140" in page
    assert run("check", "car.toml").code == 0
    said = run("replay", "drive.log", "-c", "car.toml").out
    assert not [line for line in said.splitlines() if "can0.ID" in line and "short frames" not in line]
    for fault, kind in (
        ("drop ID_140 @10..12", "timeout"),
        ("flip ID_140 @10..12", "crc"),
        ("freeze ID_140 @9", "counter"),
    ):
        said = run("replay", "drive.log", "-c", "car.toml", "--inject", fault)
        assert f"can0.ID_140.{kind}" in said.out, said.out
    # A person gives a message a signal; another drive brings an identifier that the first had not.
    own_file = tmp_path / "car.learned.can0.dbc"
    text = own_file.read_text().replace(
        "BO_ 819 ID_333: 2 Vector__XXX\n",
        'BO_ 819 ID_333: 2 Vector__XXX\n SG_ Mine : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n',
    )
    assert "Mine" in text
    own_file.write_text(text)
    drive(tmp_path / "second.log", 40.0, [*MESSAGES[:3], (0x222, 0.02, alive, 0.004)])
    said = run("learn", "--update", "second.log", "-o", "car.toml")
    assert said.code == 0, said.err
    (bus,) = tomllib.loads((tmp_path / "car.toml").read_text())["bus"]
    now = {check.pop("message"): check for check in bus["check"]}
    assert {**now, "ID_222": None} == {**checks, "ID_222": None}
    assert now["ID_222"]["counter"] == {"signal": "BYTE6_COUNTER"}
    assert "Mine" in own_file.read_text()
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")], "nothing is left beside"


def test_each_channel_of_a_log_without_a_database_is_a_bus(tmp_path, run):
    """One identifier on two buses, each with a counter of its own."""
    one = drive(tmp_path / "one.log", 40.0, MESSAGES[:2]).read_text()
    two = drive(tmp_path / "two.log", 40.0, MESSAGES[:1]).read_text().replace(" can0 ", " can3 ")
    (tmp_path / "drive.log").write_text("\n".join(sorted((one + two).splitlines())) + "\n")
    assert run("learn", "drive.log", "-o", "car.toml").code == 0
    buses = {bus.name: bus for bus in load_config(tmp_path / "car.toml").bus}
    assert [each.message for each in buses["can0"].check] == ["ID_140", "ID_18FF0142x"]
    assert [each.message for each in buses["can3"].check] == ["ID_140"]
    assert all(bus.check[0].counter is not None for bus in buses.values())
    assert "can3.ID_140.timeout" in run("replay", "drive.log", "-c", "car.toml", "--inject", "drop can3.ID_140 @10").out
    named = run("learn", "drive.log", "--bus", "pt", "--bus", "body", "--map", "can3=body", "-o", "named.toml")
    assert named.code == 0, named.err
    assert [bus.name for bus in load_config(tmp_path / "named.toml").bus] == ["pt", "body"]


def test_beside_a_database_others_are_messages_of_their_own(tmp_path):
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 512 Known: 8 A\n SG_ X : 0|8@1+ (1,0) [0|255] "" A\n'
    )
    known = (512, 0.02, lambda k: bytes([k % 7] * 8), 0.001)
    log = drive(tmp_path / "drive.log", 30.0, [known, MESSAGES[0]])
    out = tmp_path / "car.toml"
    result = learn(asked(out, log, databases=(tmp_path / "car.dbc",)), quiet)
    assert {line.name for line in result.learned.of("can0", "check")} == {"Known", "ID_140"}
    assert any("ID_140" in note for note in result.learned.notes)
    write(result.files(out))
    assert load_config(out).bus[0].database[-1].name == "car.learned.can0.dbc"
    kinds = {o.trial.injection.kind: o.named for o in result.outcomes if o.trial.message == "can0.ID_140"}
    assert kinds == dict.fromkeys(("drop", "freeze", "repeat", "flip"), True)
