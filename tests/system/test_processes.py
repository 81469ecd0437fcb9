"""Several processes over the loopback bus, as a user starts them."""

import json
import time
from contextlib import ExitStack

import can
import cantools
import pytest
from command import command
from processes import bus, gateway, process
from scenario_runs import unhurried

from gateway.faults.dtc import Dtc
from gateway_fdi.common.resources import shipped

pytestmark = pytest.mark.system


@pytest.mark.chain
def test_three_processes_end_well_and_a_wrong_expectation_does_not(tmp_path):
    with ExitStack() as stack:
        uri = stack.enter_context(bus(tmp_path))
        daemon = stack.enter_context(
            process("run", shipped("gateway.toml"), "--bus", uri, "--json", "--record", "r.log",
                    "--memory", "f.sqlite", cwd=tmp_path, ready="monitoring")
        )  # fmt: skip
        scenario = unhurried(shipped("scenarios/crank_missed_tooth.toml"), tmp_path)
        good = gateway("simulate", scenario, "--check", "--bus", uri, cwd=tmp_path)
        assert good.returncode == 0, good.stdout + good.stderr
        assert "P0336-39 set at" in good.stdout
        assert "healed" in good.stdout
        text = shipped("scenarios/crank_missed_tooth.toml").read_text()
        text = text.replace('"gateway.toml"', f'"{shipped("gateway.toml")}"')
        wrong = tmp_path / "wrong.toml"
        wrong.write_text(text.replace('dtc = "P0336-39"', 'dtc = "P0336-3A"'))
        bad = gateway("simulate", wrong, "--check", "--bus", uri, cwd=tmp_path)
        assert bad.returncode == 1, bad.stdout
        assert "P0336-39" in bad.stdout
        listed = gateway("faults", "list", "--memory", "f.sqlite", "--json", cwd=tmp_path)
        assert {e["dtc"]: e["occurrence"] for e in json.loads(listed.stdout)}["P0336-39"] == 2
        cleared = gateway("faults", "clear", "P0336-39", "--memory", "f.sqlite", cwd=tmp_path)
        assert cleared.stdout == "1 cleared\n"
    assert daemon.code == 0
    events = [json.loads(line) for line in (tmp_path / "run.out").read_text().splitlines()]
    assert events[-1]["event"] == "summary"
    live = [
        {k: v for k, v in e.items() if k not in ("status", "occurrence")}
        for e in events
        if e["event"] == "dtc" and e["fault"].startswith("crank")
    ]
    assert len(live) == 4
    # The daemon's recording of real time replays to the same events with the same time stamps.
    again = gateway("replay", "r.log", "--json", "-c", shipped("gateway.toml"), cwd=tmp_path)
    repeated = [
        {k: v for k, v in json.loads(line).items() if k not in ("status", "occurrence")}
        for line in again.stdout.splitlines()
    ]
    repeated = [e for e in repeated if e["event"] == "dtc" and e["fault"].startswith("crank")]
    assert repeated == live
    assert not (tmp_path / "faults.sqlite").exists(), "replay touches no fault memory"


def test_a_socketcand_client_of_python_can_sees_the_dtc_frames(tmp_path):
    message = cantools.database.load_file(shipped("dbc/gateway.dbc")).get_message_by_name("GW_DTC")
    with ExitStack() as stack:
        uri = stack.enter_context(bus(tmp_path))
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        tester = stack.enter_context(can.Bus(interface="socketcand", host=host, port=int(port), channel="can0"))
        stack.enter_context(
            process("run", shipped("gateway.toml"), "--bus", uri, "--memory", "f.sqlite",
                    cwd=tmp_path, ready="monitoring")
        )  # fmt: skip
        seen = []
        limit = time.monotonic() + 120
        while time.monotonic() < limit and "U0100-87" not in seen:
            got = tester.recv(1)
            if got is not None and got.arbitration_id == message.frame_id:
                values = message.decode(bytes(got.data))
                seen.append(str(Dtc(values["Dtc"])) if values["Dtc"] else "")
        assert seen[0] == "", "first the all-clear form"
        assert "U0100-87" in seen, "then the missing message"


def test_bad_usage_and_bad_input_end_with_2_and_one_clear_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text('[[bus]]\nname = "x"\nuri = "loopback:"\nfoo = 1\n')
    (tmp_path / "bad.log").write_text("nonsense\n")
    cases = [
        (("run", "none.toml"), "none.toml"),
        (("check", "bad.toml"), "bus[0].foo: unknown key"),
        (("replay", "bad.log"), "bad.log:1"),
        (("replay", "none.blf"), "none.blf"),
        (("simulate", "nosuch"), "shipped: battery_"),
        (("demo", "nosuch.toml"), "nosuch.toml"),
        (("bus", "10.0.0.1:5"), "stays on this machine"),
        (("run", "--bus", "nonsense:x"), "no such kind of bus"),
        (("faults", "list", "--memory", "none.sqlite"), "none.sqlite"),
        (("faults", "show", "Q", "--memory", "none.sqlite"), "a DTC is a letter"),
        (("convert", "teeth", "none.csv", "o.log"), "none.csv"),
        (("convert", "teeth", "none.csv", "o.log", "--edge", "up"), "--edge"),
        (("nonsense",), "No such command"),
        (("simulate",), "Missing argument"),
    ]
    for arguments, said in cases:
        ended = command(capsys, monkeypatch, *arguments)
        assert ended.code == 2, (arguments, ended)
        assert said in ended.err, (arguments, ended)
    ended = gateway("check", "bad.toml", cwd=tmp_path)  # and so ends the process
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1


def test_the_demo_shows_the_whole_chain(tmp_path):
    ended = gateway("demo", "--speed", "0", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    text = ended.stdout
    places = [
        text.index(part)
        for part in (
            "healthy so far: 1553 frames",
            "INJECTED: sensor misses pulses, 1 at tooth 20",
            "DTC P0336-39 SET  crank.missed_pulse  0.913 ms after the fault",
            "meaning   pulses of the crankshaft sensor missed",
            "evidence  pulse away from its place: 0.992, limit 0.5 [pitch]",
            "tooth 20  speed [rpm] 1504",
            "to do     check the sensor",
            "sent on CAN  P0336-39  status 0x2F (failed now, confirmed)",
            "DTC P0336-39 healed",
            "status 0x2E (not failed now, confirmed)",
            "as expected: P0336-39 healed",
            "1 fault injected, 1 DTC set: all as expected",
            "gateway demo crank_missed_tooth --json",
        )
    ]
    assert places == sorted(places)
    assert max(map(len, text.splitlines())) <= 80
    assert "\x1b" not in text, "colours are for terminals"


def test_commands_for_scripts(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        return command(capsys, monkeypatch, *arguments)

    inside = run("simulate", "crank_missed_tooth", "--bus", "inside", "--check", "--json",
                     "--record", "d.log")  # fmt: skip
    assert inside.code == 0, inside.err
    kinds = [json.loads(line)["event"] for line in inside.out.splitlines()]
    assert kinds.count("dtc") == 2
    assert kinds[-1] == "expectation"
    for flag, code in (((), 0), (("--fail-on-dtc",), 1)):
        ended = run("replay", "d.log", "--memory", "f.sqlite", *flag)
        assert ended.code == code, ended.err
        assert "DTCs: P0336-39" in ended.out
    shown = run("faults", "show", "P0336-39", "--memory", "f.sqlite")
    assert "freeze frame 1 (first failure)" in shown.out
    healthy = run("simulate", "crank_healthy", "--bus", "inside", "--record", "h.log")
    assert healthy.code == 0
    assert run("replay", "h.log", "--fail-on-dtc").code == 0
    good = json.loads(run("check", "--json").out)
    assert good["ok"]
    assert {"fault": "crank.missed_pulse", "dtc": "P0336-39"}.items() <= good["faults"][0].items()
    assert "properties" in json.loads(run("check", "--schema").out)
    facts = json.loads(run("doctor", "--json").out)
    assert facts["kernels"]["compiled"] is True
    assert facts["kernels"]["shipped"] > 20
    assert gateway("--version", cwd=tmp_path).stdout.startswith("gateway ")
