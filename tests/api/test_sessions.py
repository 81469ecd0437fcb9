"""Sessions and replays from Python: the same gateway as the command line's, in a host that stays as it was."""

import json
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from command import command

import gateway_api as api
from gateway.bus.frames import empty, put_message, to_message
from gateway.bus.logs import LogReader, open_writer
from gateway.servers.dtc_frame import read_dtc_frame
from gateway_fdi.common.resources import shipped

MISSED = "crank.missed_pulse"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Return the log of a crankshaft that misses a tooth, and the run that made it."""
    path = tmp_path_factory.mktemp("log") / "drive.log"
    return path, api.simulate("crank_missed_tooth", record=str(path), series=True)


def dtcs(events):
    return [(e["t_ns"], e["dtc"], e["status"]) for e in events if e["event"] == "dtc"]


def messages(path):
    return [to_message(frame) for frames in LogReader(path) for frame in frames]


def test_a_replay_is_that_of_the_command_line(log, capsys, monkeypatch):
    path, _ = log
    inject = ["drop CTW_PT4 @2..3"]
    run = api.open("gateway.toml").replay(str(path), inject=inject)
    arguments = ("replay", path, "--config", shipped("gateway.toml"), "--json", "--inject", *inject)
    told = command(capsys, monkeypatch, *arguments).events
    mine = json.loads(json.dumps(list(run.events)))
    assert mine == [event for event in told if event["event"] not in ("log", "summary")]
    assert "U0100-87" in run.dtcs["dtc"]


def test_messages_make_the_events_of_their_log_one_by_one_or_all_at_once(log):
    path, made = log
    setup = api.open("gateway.toml")
    whole = setup.replay(path)
    with setup.session() as session:
        events = [event for message in messages(path) for event in session.feed(message)]
        events += session.feed([])
    assert session.run.frames == whole.frames == made.frames
    assert dtcs(events) == dtcs(whole.events)
    assert list(session.run.events) == list(whole.events)
    assert session.unsent > 0
    assert dict(zip(session.run.verdicts["fault"], session.run.verdicts["verdict"], strict=True))[MISSED] == "failed"


def test_two_gateways_in_one_process_do_not_know_each_other(log):
    path, _ = log
    frames = np.concatenate(list(LogReader(path)))
    setup = api.open("gateway.toml")
    alone = setup.replay(frames)
    with setup.session() as one, setup.session(inject=["drop CTW_PT4 @2..3"]) as other:
        for k in range(0, len(frames), 100):
            one.feed(frames[k : k + 100])
            other.feed(frames[k : k + 100])
    assert dtcs(one.run.events) == dtcs(alone.events)
    assert "U0100-87" in other.run.dtcs["dtc"]
    assert "U0100-87" not in one.run.dtcs["dtc"]


def test_time_passes_without_messages():
    with api.open("gateway.toml").session() as session:
        with pytest.raises(api.GatewayError, match="feed one"):
            session.advance(1.0)
        session.feed(can.Message(timestamp=1.0, arbitration_id=0x700, is_extended_id=False, data=bytes(8)))
        assert "U0100-87" in {event.get("dtc") for event in session.advance(20.0)}
        assert session.advance(5.0) == []
    with pytest.raises(api.GatewayError, match="over"):
        session.feed([])


def test_a_host_with_python_can_is_served(log):
    path, _ = log
    database = shipped("dbc/gateway.dbc")
    with (
        can.Bus("api-test", interface="virtual", receive_own_messages=False) as host,
        can.Bus("api-test", interface="virtual") as tester,
        api.open("gateway.toml").session(send=host.send) as session,
    ):
        session.feed(messages(path))
        reports = []
        while (heard := tester.recv(timeout=0.0)) is not None:
            assert type(heard).__module__.startswith(("can", "gateway.bus"))
            batch = empty(1)
            put_message(batch, 0, heard)
            reports.append(read_dtc_frame(batch[0], database))
    assert session.unsent == 0
    assert "P0336-39" in {str(report.dtc) for report in reports if report is not None and report.dtc is not None}


def test_importing_leaves_the_host_as_it_is():
    code = """
import gc, logging, os, signal, sys, threading
import can, numpy
def state():
    handlers = [signal.getsignal(k) for k in (signal.SIGINT, signal.SIGTERM)]
    return (list(sys.meta_path), list(sys.path_hooks), handlers, logging.root.handlers[:], logging.root.level,
        threading.enumerate(), sys.excepthook, dict(os.environ), numpy.geterr(), gc.get_threshold(), list(sys.path))
before = state()
import gateway, gateway_fdi
import gateway_api as api
api.open("gateway.toml").session().close()
assert state() == before, [pair for pair in zip(state(), before) if pair[0] != pair[1]]
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    bare = "import gateway, gateway_fdi, sys; print(sorted(sys.modules.keys() & {'can', 'numpy', 'pydantic'}))"
    assert subprocess.check_output([sys.executable, "-c", bare], text=True).split() == ["[]"]


def test_an_interrupt_leaves_nothing_behind(log, tmp_path):
    path, _ = log
    setup, before = api.open("gateway.toml"), threading.enumerate()
    memory = tmp_path / "faults.sqlite"

    def stop(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        setup.replay(path, memory=memory, progress=stop)
    with pytest.raises(KeyboardInterrupt):
        api.simulate("crank_missed_tooth", progress=stop)
    assert threading.enumerate() == before
    shares = []
    assert "P0336-39" in setup.replay(path, memory=str(memory), progress=shares.append).dtcs["dtc"]  # nobody holds it
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def of_bus(number):
    frames = empty(1)
    frames["bus"] = number
    return frames


WRONG = {
    "an object": (lambda s, p: api.open(3), r"config = 3: a path, tables, or a Config; this is int"),
    "no file": (lambda s, p: s.replay("gone.log"), r"gone\.log: No such file"),
    "a number": (lambda s, p: s.replay(3), r"log = 3: a path, or frames"),
    "another array": (lambda s, p: s.replay(np.zeros(3)), r"messages: frames are an array"),
    "no message": (lambda s, p: s.session().feed([1]), r"messages\[0\] = 1: a message of python-can"),
    "frames of no bus": (lambda s, p: s.replay(of_bus(3)), r"messages: frames of bus 3; the buses are 0 to 0"),
    "an endless bus": (lambda s, p: s.session().feed(SimpleNamespace(recv=None)), r"messages: a bus has no end"),
    "a bus": (lambda s, p: s.session().feed([], bus="pt"), r"bus = 'pt': the buses are powertrain"),
    "an injection": (lambda s, p: s.replay(p, inject=["drop Nix"]), r"inject = 'drop Nix': no message 'Nix'"),
    "one text": (lambda s, p: s.replay(p, inject="drop Nix"), r"inject = 'drop Nix': a list"),
    "a map": (lambda s, p: s.replay(p, maps=["can0"]), r"maps = 'can0': channel=bus"),
    "a channel": (lambda s, p: s.replay(p, maps=["vcan9=powertrain"]), r'maps=\["[^ ]+=powertrain"\]'),
    "a signal": (lambda s, p: s.session(signals=["X.y"]), r"signals = 'X.y': no message 'X'"),
    "a table": (lambda s, p: api.open({"buss": []}), r"buss: unknown key; did you mean bus\?"),
    "a model": (lambda s, p: api.Config(bus=[{"nam": "x"}]), r"bus\[0\]\.nam: unknown key; did you mean name\?"),
    "a shape": (lambda s, p: s.frames([0.0, 1.0], {"CTW_PT4": {"Interval0": [1, 2, 3]}}), r"CTW_PT4: values of shape"),
    "a learned log": (lambda s, p: api.learn([], [], "x.toml"), r"logs: name a log"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_are_of_one_family_in_the_callers_words(name, log):
    call, text = WRONG[name]
    with pytest.raises(api.GatewayError, match=text) as caught:
        call(api.open("gateway.toml"), log[0])
    assert "--" not in str(caught.value)


def test_names_that_are_not_there_are_keys_that_are_missing(log):
    _, run = log
    assert MISSED in run.series
    assert run.series.get("crank.misse") is None
    with pytest.raises(KeyError, match="did you mean"):
        run.dtcs["dct"]
    with pytest.raises(api.GatewayError, match="series=True"):
        _ = api.open("gateway.toml").replay(log[0]).series


def test_series_are_those_of_the_command_line(log, tmp_path, capsys, monkeypatch):
    path, run = log
    out = tmp_path / "out.parquet"
    command(capsys, monkeypatch, "replay", path, "--config", shipped("gateway.toml"), "--signals", out)
    told = pd.read_parquet(out)
    mine = pd.DataFrame.from_arrow(api.open("gateway.toml").replay(path, series=True).series)
    assert mine.columns.tolist() == told.columns.tolist()
    assert len(mine) == len(told) > 1000
    for column in ("t_ns", "value", "limit"):
        np.testing.assert_array_equal(mine[column].to_numpy(float), told[column].to_numpy(float))
    for column in ("monitor", "name", "result", "unit"):
        assert mine[column].tolist() == told[column].tolist()
    one = run.series[MISSED]
    assert one.failed.any()
    assert (one.value[one.failed] > one.limit[one.failed]).all()


def test_tables_are_arrow_and_html(log):
    _, run = log
    table = pa.table(run.dtcs)
    assert table["dtc"].to_pylist() == list(run.dtcs["dtc"]) == ["P0336-39"]
    assert [row["dtc"] for row in run.dtcs.records()] == ["P0336-39"]
    shown = api.Table.of({"a<b": str, "n": float}, [("<script>", None)] * 30)
    assert "<script>" not in shown._repr_html_()
    assert "... 30 rows" in shown._repr_html_()
    assert "P0336-39" in run._repr_html_()
    assert "P0336-39" in repr(run)


@pytest.mark.long
def test_thresholds_are_found_and_kept(log, tmp_path):
    file, healthy = tmp_path / "tanks.toml", tmp_path / "healthy.log"
    file.write_text(shipped("configs/tanks.toml").read_text())
    t, rng = np.arange(0.0, 1000.0, 0.25), np.random.default_rng(5)
    levels = np.array([1.476, 1.085, 0.694]) + rng.normal(0.0, 0.002, (len(t), 3))  # at rest, seed 5
    sensors = {f"Level{k + 1}": levels[:, k] for k in range(3)}
    with open_writer(healthy) as writer:
        writer.write(api.open(file).frames(t, {"Command": {"Pump": 50.0}, "Sensors": sensors}))
    found = api.open(file).calibrate([str(healthy)])
    assert not found.failed
    assert (found.thresholds["proposed"] > 2.0 * found.thresholds["largest"] - 1e-9).all()
    assert found.write(str(tmp_path / "copy.toml")) == tmp_path / "copy.toml"
    assert file.read_text() == shipped("configs/tanks.toml").read_text()
    source = f"{found.seconds:.0f} s of healthy logs, sha256 {found.facts['data']}"
    assert source in (tmp_path / "copy.toml").read_text()
    setup = api.open("gateway.toml")
    with pytest.raises(api.GatewayError, match="monitor: no monitor here"):
        setup.calibrate([log[0]])
    with pytest.raises(api.GatewayError, match="made of tables"):
        api.open(setup.config).calibrate([log[0]])


def test_a_session_that_failed_is_over(log):
    with pytest.raises(ZeroDivisionError), api.open("gateway.toml").session() as session:
        session.feed(messages(log[0])[:100])
        raise ZeroDivisionError
    with pytest.raises(api.GatewayError, match="closed|over"):
        session.feed(messages(log[0])[100:200])
    assert session.run.frames == 100


@pytest.mark.long
def test_ecus_are_asked_and_testers_answered_where_something_takes_the_messages():
    sent = []
    setup = api.open("configs/obd_port.toml")
    with setup.session(send=sent.append) as session:
        session.feed(can.Message(timestamp=1.0, arbitration_id=0x7FF, is_extended_id=False, data=bytes(8)))
        for k in range(1, 300):
            session.advance(1.0 + 0.01 * k)
    assert {message.arbitration_id for message in sent} & {0x7DF, *range(0x7E0, 0x7E8)}
    with setup.session() as silent:
        silent.feed(can.Message(timestamp=1.0, arbitration_id=0x7FF, is_extended_id=False, data=bytes(8)))
        silent.advance(4.0)
    assert silent.unsent < len(sent)


def test_a_setup_names_its_faults_and_signals(log):
    setup = api.open("gateway.toml")
    assert setup.faults[MISSED] == "P0336-39"
    name = next(name for name in setup.signals if name.startswith("CTW_PT4."))
    run = setup.replay(log[0], signals=[name])
    assert len(run.series[name]) > 10


def test_paths_are_text_or_paths():
    assert api.open(str(shipped("gateway.toml"))).faults == api.open(Path(shipped("gateway.toml"))).faults
