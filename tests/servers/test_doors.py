"""One authority for every intervention: each door, while the vehicle stands and while it moves, and forced.

``python tests/servers/test_doors.py`` (with tests/support, tests/servers in PYTHONPATH) prints the table of
docs/security.md anew.
"""

import os
import tempfile
from pathlib import Path

import pytest
from command import command
from doors import Doors
from rig import Rig, write_config
from test_access import LEVEL

from gateway.faults import service
from gateway.runtime.app import Gateway
from gateway_serve.broker import Broker
from gateway_serve.hub import Hub
from gateway_serve.metrics import Metrics
from gateway_serve.mqtt import Published, Publisher

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/security.md"
STANDING = "gateway.monitoring_off"

_LOCAL = {
    "clear": ("clear", {}),
    "operation cycle": ("cycle", {}),
    "DTC setting off": ("settings", {"dtcs": False}),
    "reception off": ("settings", {"receive": False}),
    "sending off": ("settings", {"send": False}),
}
#: Switching off: what it changes, and its action.
_OFF = {
    "DTC setting off": ("results", "dtc_setting"),
    "reception off": ("receive", "communication"),
    "sending off": ("send", "communication"),
}
#: Door and intervention -> does it; those that cannot be forced take no keys.
ROWS = {
    **{
        (door, f"{what} ({request})"): lambda d, by=by, r=request: by(d, r)
        for door, by in (("UDS", Doors.by_uds), ("DoIP", Doors.by_doip), ("request", Doors.by_request))
        for what, request in {
            "clear": "14 FF FF FF", "reset": "11 01", "DTC setting off": "85 02", "reception off": "28 02 01",
            "sending off": "28 01 01",
        }.items()
    },
    ("OBD", "clear (04)"): lambda d: d.by_obd(),
    ("J1939", "clear (DM3)"): lambda d: d.by_j1939(0xFECC),
    ("J1939", "clear (DM11)"): lambda d: d.by_j1939(0xFED3),
    **{("status socket", w): lambda d, do=do, k=k, **f: d.by_status(do, **k, **f) for w, (do, k) in _LOCAL.items()},
    **{("page", w): lambda d, do=do, k=k, **f: d.by_page(do, **k, **f) for w, (do, k) in _LOCAL.items()},
    ("SOVD", "clear"): lambda d: d.by_sovd("DELETE", "faults"),
    ("SOVD", "operation cycle"): lambda d: d.by_sovd("PUT", "status/restart"),
    ("SOVD", "DTC setting off"): lambda d: d.by_sovd("PUT", "modes/dtcsetting", {"value": "off"}),
    ("command line", "clear (`gateway faults clear`)"): lambda d, **f: d.by_command(**f),
}  # fmt: skip
#: Doors at which whoever may open them may override the rules.
FORCED = ("status socket", "page", "command line")


def cell(folder, row, speed, *, force=False, **options):
    """Return what comes of an intervention, and see that it was done or not done."""
    with Doors(folder, **options) as doors:
        doors.rig.fail(0)
        doors.drive(speed)
        found = ROWS[row](doors, **({"force": True} if force else {}))
        done, controls = found == "done", doors.gateway.controls
        what = row[1].partition(" (")[0]
        if what == "clear" and row[1] != "clear (DM3)":  # which clears what was active before, and nothing was
            assert (doors.rig.status(0) == 0x50) == done
        elif what in ("operation cycle", "reset"):
            assert (doors.gateway.memory.cycle_number() == 2) == done
        elif row[0] in ("DoIP", "request"):  # it ended when the tester left
            assert [each.action for each in doors.gateway.memory.interventions() if not each.outcome] == (
                [_OFF[what][1], f"{_OFF[what][1]}_ended"] if done else []
            )
        elif what in _OFF:
            assert getattr(controls, _OFF[what][0]) != done
        return found


def matrix(folder):
    """Return the table as docs/security.md has it."""
    lines = ["| door | intervention | stands | moves | moves, forced |", "|---|---|---|---|---|"]
    for row in ROWS:
        forced = cell(folder, row, 50.0, force=True) if row[0] in FORCED else "-"
        cells = [cell(folder, row, 0.0), cell(folder, row, 50.0), forced]
        lines.append(f"| {row[0]} | {row[1]} | {' | '.join(cells)} |")
    return lines


@pytest.mark.long
def test_the_matrix_of_all_doors_is_that_of_the_page(tmp_path):
    page = PAGE.read_text().splitlines()
    made = matrix(tmp_path)
    begin = page.index(made[0])
    assert page[begin : begin + len(made)] == made


@pytest.mark.parametrize("row", [row for row in ROWS if row[0] in FORCED and row[1].startswith(("clear", "DTC"))])
def test_what_needs_security_is_refused_to_whoever_has_no_key(tmp_path, row):
    """0x33 at each door of this machine, unless the configuration says that it counts as unlocked, or it is forced."""
    assert cell(tmp_path, row, 0.0, uds=LEVEL) == "33"
    assert cell(tmp_path, row, 0.0, uds=LEVEL, force=True) == "done"
    unlocked = "local_unlocked = true\n"
    assert cell(tmp_path, row, 0.0, uds=LEVEL, more=unlocked) == "done"
    assert cell(tmp_path, row, 50.0, uds=LEVEL, more=unlocked) == "22"


# What was switched off ends like a tester's


@pytest.fixture
def doors(tmp_path):
    with Doors(tmp_path, watched=True) as made:
        made.drive(0.0)
        yield made


def blind(doors):
    """Whether a failure is not seen."""
    doors.rig.fail(2)
    seen = doors.rig.status(2) & 1
    doors.rig.heal(2)
    return not seen


def test_it_ends_when_the_reader_leaves(doors):
    reader = doors.reader()
    assert reader.ask("settings", dtcs=False)["ok"]
    assert blind(doors)
    reader.leave()
    assert not blind(doors)


def test_it_ends_with_s3_unless_the_reader_says_that_it_is_there(doors):
    reader, other = doors.reader(), doors.reader()
    assert reader.ask("settings", dtcs=False)["ok"]
    for _ in range(12):
        doors.drive(0.0)
        doors.turn(0.9)
        assert reader.ask("present")["ok"]
    assert blind(doors)
    for _ in range(6):
        doors.drive(0.0)
        doors.turn(0.9)
        reader.ask("values", signals=[])
        other.ask("present")
    assert not blind(doors), "who only looks, or is somebody else, keeps nothing"
    assert [i.action for i in doors.gateway.memory.interventions()] == ["dtc_setting", "dtc_setting_ended"]


@pytest.mark.parametrize("off", [{"dtcs": False}, {"receive": False}])
def test_it_ends_when_the_vehicle_moves(doors, off):
    reader = doors.reader()
    assert reader.ask("settings", **off)["ok"]
    assert blind(doors)
    doors.drive(30.0)
    doors.turn(0.15)
    assert not blind(doors)
    assert reader.ask("present")["monitoring"]["on"]


def test_what_is_forced_does_not_end_with_the_condition_but_with_s3(doors):
    reader = doors.reader()
    doors.drive(30.0)
    assert reader.ask("settings", dtcs=False, force=True, why="brake bench 3")["ok"]
    for _ in range(10):
        doors.drive(30.0)
        doors.turn(0.3)
    assert blind(doors)
    doors.turn(3.0)
    assert not blind(doors)


@pytest.mark.parametrize(("off", "undoing"), [("dtcs", "8501"), ("receive", "280001"), ("dtcs", "1101")])
def test_a_tester_switches_it_on_again(doors, off, undoing):
    """D: 0x85 01 was answered positively and changed nothing."""
    reader = doors.reader()
    assert reader.ask("settings", **{off: False})["ok"]
    assert blind(doors)
    doors.tester("1003")
    doors.drive(0.0)
    assert not doors.tester(undoing).startswith("7f")
    assert not blind(doors)


def test_the_page_cannot_blind_for_ever(doors):
    """D: POST /api/settings, no page open; faults were not seen until SIGHUP."""
    assert doors.by_page("settings", dtcs=False) == "done"
    assert blind(doors)
    for _ in range(7):
        doors.drive(0.0)
        doors.turn(0.9)
        assert doors.by_page("present") == "done"
    assert blind(doors)
    for _ in range(7):
        doors.drive(0.0)
        doors.turn(0.9)
    assert not blind(doors)


def test_the_page_needs_its_control_token_to_override(doors):
    doors.drive(50.0)
    for token in ("", "wrong"):
        code, _ = doors.post("/api/settings", {"dtcs": False, "force": True}, token)
        assert code == 401
        assert doors.gateway.controls.monitoring
    assert doors.post("/api/settings", {"dtcs": False})[0] == 409
    assert doors.post("/api/settings", {"dtcs": False, "force": True})[0] == 200


def test_who_is_not_the_owner_of_the_socket_overrides_nothing(doors):
    doors.drive(50.0)
    commands = doors.status._commands
    commands.enter(77, uid=54321)
    answer = commands.answer(b'{"do": "settings", "dtcs": false, "force": true}', 77)
    assert "only the owner" in answer["error"]
    assert doors.gateway.controls.monitoring


def test_who_and_why_are_noted(doors, tmp_path, capsys, monkeypatch):
    doors.drive(50.0)
    doors.by_status("clear")
    doors.by_status("clear", force=True, why="brake bench 3", by="Anna")
    doors.by_page("cycle", force=True, why="end of line")
    doors.by_command(force=True, why="night shift")
    doors.turn()
    found = [(each.protocol, each.action, each.outcome, each.role) for each in doors.gateway.memory.interventions()]
    uid = f"uid {os.getuid()}"
    assert found == [
        ("local", "clear", 0x22, uid),
        ("local", "clear", 0, f"{uid}, Anna; forced over 0x22: brake bench 3"),
        ("local", "reset", 0, f"{uid}, page 127.0.0.1; forced over 0x22: end of line"),
        ("local", "clear", 0, f"{uid}, command line; forced over 0x22: night shift"),
    ]
    ended = command(capsys, monkeypatch, "faults", "interventions", "--memory", doors.memory)
    assert "bench" in ended.out


def test_the_command_takes_force_and_why(tmp_path, capsys, monkeypatch):
    with Doors(tmp_path) as doors:
        doors.rig.fail(0)
        doors.turn()
    ended = command(
        capsys, monkeypatch, "faults", "clear", "--memory", doors.memory, "--force", "--why", "on the bench"
    )
    assert ended.out == "1 cleared\n"
    assert service.interventions(doors.memory)[-1]["role"].endswith("command line: on the bench")


# While monitoring is off, everything says so


def standing(doors):
    return int(doors.gateway.memory.status(STANDING)) & 1


@pytest.mark.evidence("Nothing is silent: blind")
def test_while_monitoring_is_off_a_code_a_metric_the_page_and_every_answer_say_so(doors):
    doors.by_page("present")
    metrics = Metrics(doors.hub)
    reader, other = doors.reader(), doors.reader()

    def told():
        doors.drive(0.0)
        doors.turn(0.6)
        doors.loop.run_until_complete(
            doors._until(lambda: doors.hub.monitoring["on"] == doors.gateway.controls.monitoring)
        )
        return {
            "code": not standing(doors),
            "metric": b"gateway_monitoring_on 1.0" in metrics.text(),
            "page": '"monitoring":{"on":true' in doors.hub._state().replace(" ", ""),
            "answer": other.ask("values", signals=[])["monitoring"]["on"],
            "refusal": other.ask("nothing")["monitoring"]["on"],
            "hello": doors.reader().latest("hello")["monitoring"]["on"],
            "buses": other.latest("buses")["monitoring"]["on"],
        }

    assert set(told().values()) == {True}
    assert reader.ask("settings", dtcs=False)["monitoring"]["by"] == [f"reader 2, uid {os.getuid()}"]
    assert set(told().values()) == {False}
    assert reader.ask("settings", dtcs=True)["ok"]
    assert set(told().values()) == {True}


def test_the_code_is_told_whoever_switches_off_and_stays_over_a_clear(doors):
    doors.tester("1003")
    assert doors.tester("8502") == "c502"
    doors.turn()
    assert standing(doors)
    assert "f00053" in doors.tester("190201"), "U3000-53"
    doors.drive(0.0)
    assert doors.tester("14ffffff") == "54"
    doors.turn()
    assert standing(doors), "it was cleared, and is so still"
    assert doors.tester("8501") == "c501"
    doors.turn()
    assert not standing(doors)


def test_the_code_stays_over_an_operation_cycle(doors):
    reader = doors.reader()
    assert reader.ask("settings", dtcs=False)["ok"]
    doors.turn()
    assert reader.ask("cycle")["number"] == 2
    doors.turn()
    assert standing(doors)
    assert blind(doors)


def test_the_code_goes_with_the_next_start_where_the_gateway_was_killed(doors):
    assert doors.reader().ask("settings", dtcs=False)["ok"]
    doors.turn()
    assert standing(doors)
    doors.gateway.store.close()  # as kill -9: nothing is ended
    rig = Rig(doors.config, doors.memory, watched=True)
    assert int(rig.gateway.memory.status(STANDING)) & 1
    rig.wait(100)
    assert not int(rig.gateway.memory.status(STANDING)) & 1
    rig.close()


@pytest.mark.parametrize("file", ["m.sqlite", None])
def test_a_reload_switches_it_on_and_notes_that_it_did(tmp_path, file):
    rig = Rig(write_config(tmp_path, extra="[output.uds]\n"), file and tmp_path / file, watched=True)
    rig.gateway.authority.holder("reader 1", lambda action: None, yields=True).set_dtcs(False)
    rig.wait(10)
    old = rig.gateway
    assert int(old.memory.status(STANDING)) & 1
    old.finish(rig.now)
    rig.gateway = Gateway(old.config, store=old.store)
    rig.gateway.succeed(old)
    rig.wait(10)
    assert not int(rig.gateway.memory.status(STANDING)) & 1
    assert [(i.action, i.role) for i in rig.gateway.memory.interventions()] == [("dtc_setting_ended", "reader 1")]
    rig.close()


def test_a_reload_changes_nothing_that_a_rule_guards(doors):
    """SIGHUP: while the vehicle moves as while it stands no DTC goes, no cycle begins, and nothing is switched off."""
    for speed in (50.0, 0.0):
        doors.rig.fail(0)
        doors.drive(speed)
        old = doors.gateway
        before = [(entry.fault, int(old.memory.status(entry.fault))) for entry in old.memory.entries()]
        old.finish(doors.rig.now)
        doors.rig.gateway = Gateway(old.config, store=old.store)
        doors.rig.gateway.succeed(old)
        memory = doors.gateway.memory
        assert before == [(entry.fault, int(memory.status(entry.fault))) for entry in memory.entries()]
        assert doors.gateway.controls.monitoring
        assert memory.cycle_number() == 1
        assert memory.interventions() == []


def test_sending_that_is_off_blinds_nobody(doors):
    reader = doors.reader()
    answer = reader.ask("settings", send=False)
    assert (answer["monitoring"]["on"], answer["monitoring"]["send"]) == (True, False)
    doors.turn()
    assert not standing(doors)


# MQTT


def test_a_broker_can_ask_for_nothing(tmp_path):
    """What MQTT has: it tells. There is no topic that it listens to, so that no rule can be gone around."""
    hub = Hub(tmp_path / "nobody")
    publisher = Publisher(hub, Broker(host="127.0.0.1"), Published(), "x")
    assert publisher._client.on_message is None
    source = (ROOT / "packages/gateway_serve/mqtt.py").read_text()
    assert ".subscribe(" not in source
    assert [line.split('ask("')[1].split('"')[0] for line in source.splitlines() if 'ask("' in line] == ["values"]
    assert publisher.states()[f"{publisher.base}/monitoring"] == "on"
    hub.monitoring = {**hub.monitoring, "on": False}
    assert publisher.states()[f"{publisher.base}/monitoring"] == "off"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        print(*matrix(Path(made)), sep="\n")
