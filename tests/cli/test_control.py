"""Signals and faults set while virtual ECUs run, by the control socket and its command."""

import itertools
import json
import socket
import threading
from contextlib import suppress

import cantools
import pytest
from typer.testing import CliRunner

from gateway.bus.frames import payload
from gateway.cli import app
from gateway.config.load import load_config
from gateway_bench.cli.control import Control, ask, request_of
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.errors import InputError

DBC = """VERSION ""
BU_: A
BO_ 256 Drive: 8 A
 SG_ COUNTER : 0|4@1+ (1,0) [0|15] "" A
 SG_ Speed : 8|16@1- (0.01,0) [-300|300] "km/h" A
 SG_ Gear : 24|4@1+ (1,0) [0|6] "" A
BO_ 257 Other: 8 A
 SG_ Value : 0|8@1+ (1,0) [0|255] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
VAL_ 256 Gear 0 "Park" 4 "Drive";
"""
DATABASE = cantools.database.load_string(DBC, strict=False)


@pytest.fixture
def player(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "gateway.toml").write_text('[[bus]]\nname = "can"\nuri = "virtual:x"\ndatabase = ["car.dbc"]\n')
    (tmp_path / "s.toml").write_text(
        'name = "s"\nduration_s = 10\nconfig = "gateway.toml"\n[[ecu]]\ntype = "restbus"\n[ecu.signals]\n'
        '"Drive.Speed" = 50\n'
    )
    scenario = load_scenario(tmp_path / "s.toml")
    return player_of(scenario, load_config(scenario.config), stepwise=True)


class Asked:
    """A simulation that goes on while somebody asks."""

    def __init__(self, path, player):
        self.player, self.path, self.now_ns = player, path, 0
        self.control = Control(path, player, lambda: self.now_ns / 1e9)

    def frames(self, ns=100_000_000):
        self.now_ns += ns
        return [
            (DATABASE.get_message_by_frame_id(int(frame["can_id"])).name,
             DATABASE.decode_message(int(frame["can_id"]), payload(frame), decode_choices=False))
            for frame in self.player.take(self.now_ns)
        ]  # fmt: skip

    def speeds(self):
        return {values["Speed"] for name, values in self.frames() if name == "Drive"}

    def ask(self, *words):
        found = []

        def work():
            try:
                found.append(ask(self.path, request_of(words)))
            except InputError as error:
                found.append(error)

        thread = threading.Thread(target=work)
        thread.start()
        while not found:
            self.control.turn()
        thread.join()
        if isinstance(found[0], InputError):
            raise found[0]
        return found[0]


@pytest.fixture
def asked(tmp_path, player):
    made = Asked(tmp_path / "control", player)
    yield made
    made.control.close()
    assert not made.path.exists()


def test_signals_are_set_and_let_go(asked):
    assert asked.speeds() == {50}
    answer = asked.ask("set", "Drive.Speed=-12.5", "Drive.Gear=Drive")
    assert answer == {"now_s": 0.1, "set": {"Drive.Speed": -12.5, "Drive.Gear": 4.0}}
    frames = [values for name, values in asked.frames() if name == "Drive"]
    assert {values["Speed"] for values in frames} == {-12.5}
    assert {values["Gear"] for values in frames} == {4}
    counters = [values["COUNTER"] for values in frames]
    assert [(b - a) % 16 for a, b in itertools.pairwise(counters)] == [1] * (len(frames) - 1)
    assert asked.ask("release", "Drive.Speed")["set"] == {"Drive.Gear": 4.0}
    assert asked.speeds() == {50}
    assert asked.ask("release")["set"] == {}
    assert asked.ask()["set"] == {}


def test_faults_come_and_end(asked):
    asked.frames()
    asked.ask("inject", "kind=lost", "message=Drive")
    assert {name for name, _ in asked.frames()} == {"Other"}
    asked.ask("heal")
    assert {name for name, _ in asked.frames()} == {"Drive", "Other"}
    asked.ask("inject", "kind=offset", "signal=Drive.Speed", "size=10", "when=Drive.Gear == 4")
    assert asked.speeds() == {50}
    asked.ask("set", "Drive.Gear=4")
    asked.frames()
    assert asked.speeds() == {60}
    assert [fact.kind for fact in asked.player.truth] == ["lost", "offset"]


def test_the_first_word_without_a_value_is_named():
    with pytest.raises(InputError, match="NAME=VALUE") as refused:
        request_of(["set", "Drive.Speed=1", "Drive.Gear", "Other.Value"])
    assert refused.value.value == "Drive.Gear"


WRONG = {
    ("set", "Drive.Sped=1"): "did you mean Speed?",
    ("set", "Drive.Speed=400"): "it can carry -327.68 to 327.67",
    ("set", "Drive.Gear=Driv"): "did you mean Drive?",
    ("set", "Drive.Speed"): "set NAME=VALUE",
    ("release", "Drive.Speed"): "set are",
    ("inject", "kind=lots", "message=Drive"): "kind",
    ("inject", "kind=lost", "message=Drve"): "did you mean Drive?",
    ("sett", "a=1"): "did you mean set?",
}


@pytest.mark.parametrize("words", WRONG)
def test_mistakes_are_told(words, asked):
    with pytest.raises(InputError) as told:
        asked.ask(*words)
    assert WRONG[words] in str(told.value)
    assert asked.speeds() == {50}, "nothing has changed"


REQUESTS = {  # not what our own command sends
    b'{"release": [5]}': "names of signals",
    b'{"set": {"Drive.Speed": 1' + 400 * b"0" + b"}}": "a number",
    b'{"set": {"Drive.Speed": NaN}}': "a number",
    b'{"set": {"Drive.Speed": true}}': "a number",
    b'{"set": [1]}': "not what it wants",
    b"[" * 50_000: "no JSON",
    b"\xff": "no JSON",
    b'{"inject": {"kind": ["lost"]}}': "kind",
}


@pytest.mark.parametrize("request_", REQUESTS, ids=range(len(REQUESTS)))
def test_what_anybody_writes_does_not_end_the_simulation(request_, asked):
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as peer:
        peer.connect(str(asked.path))
        peer.sendall(request_ + b"\n")
        peer.setblocking(False)
        heard = b""
        while not heard.endswith(b"\n"):
            asked.control.turn()
            with suppress(BlockingIOError):
                heard += peer.recv(65536)
    assert REQUESTS[request_] in json.loads(heard)["error"]
    assert asked.speeds() == {50}


def test_of_several_values_one_that_is_wrong_leaves_all_as_they_were(asked):
    with pytest.raises(InputError, match="it can carry"):
        asked.ask("set", "Drive.Gear=4", "Drive.Speed=400")
    assert asked.ask()["set"] == {}
    assert asked.speeds() == {50}


def test_the_command(asked, tmp_path):
    found = []
    thread = threading.Thread(
        target=lambda: found.append(CliRunner().invoke(app, ["control", str(asked.path), "set", "Drive.Speed=7"]))
    )
    thread.start()
    while not found:
        asked.control.turn()
    thread.join()
    assert json.loads(found[0].stdout)["set"] == {"Drive.Speed": 7}
    assert asked.speeds() == {7}
    with pytest.raises(InputError, match="no simulation with --control listens here"):
        ask(tmp_path / "nobody", {"show": True})
