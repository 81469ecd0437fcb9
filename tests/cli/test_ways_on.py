"""Slips that strangers made: each is one line with file, key, value and the way on. And how commands are stopped."""

import os
import signal
import subprocess
import sys
import time

import pytest
from amount import amount
from command import command

from gateway.cli.failure import ended_by
from gateway.common.extras import EXTRAS, extra_with

BUS = '[[bus]]\nname = "b"\nuri = "virtual:b"\n'


@pytest.fixture
def gateway(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.dbc").write_text('BU_: A\n\nBO_ 256 M: 8 A\n SG_ S : 0|16@1+ (1,0) [0|100] "km/h" A\n')
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


#: Text of a configuration -> the whole line about it.
SLIPS = {
    "[[bus]]\nname = can0\n": "c.toml:2: name: 'name = can0': no value of TOML: a text is in quotes",
    "[[bus]]\nname = True\n": "c.toml:2: name: 'name = True': no value of TOML: a text is in quotes",
    "name b\n": "c.toml:1: 'name b': a line is KEY = VALUE, or a table's [NAME]",
    "= 3\n": "c.toml:1: '= 3': no line of TOML",
    'name = "a"\nname = "b"\n': "c.toml:2: name: 'name = \"b\"': this key or table is here twice",
    "[bus]\n[[bus]]\n": "c.toml:2: '[[bus]]': this ",
    'name = "a\n': "c.toml:1: name: 'name = \"a': a quote is missing at the end",
    'name = "C:\\dbc"\n': "c.toml:1: name: 'name = \"C:\\\\dbc\"': a backslash in a text",
    "bus = [\n": "c.toml:1: bus: 'bus = [': ",
    'name = "a" "b"\n': 'c.toml:1: name: \'name = "a" "b"\': one value a line',
    BUS + 'bitrate = "500k"\n': "bus[0].bitrate = '500k': a whole number: write it without a unit and without quotes",
    BUS + "bitrate = 0.5\n": "bus[0].bitrate = 0.5: a whole number",
    BUS + 'match = "pgm"\n': "bus[0].match = 'pgm': there are id, pgn; did you mean pgn?",
    BUS + "listen_only = 3\n": "bus[0].listen_only = 3: true or false",
    BUS + "[memory]\nentries = 0\n": "memory.entries = 0: a number of 1 at least",
    BUS + "[memory]\npath = 3\n": "memory.path = 3: the name of a file: write it in quotes",
    BUS + '[[did]]\nid = 70000\nname = "x"\nsignal = "M.S"\n': "did[0].id = 70000: a number of 65279 (0xFEFF) at most",
    BUS
    + 'database = ["smal.dbc"]\n': "bus[0].database = 'smal.dbc': No such file or directory; did you mean small.dbc",
    BUS + 'database = ["empty.dbc"]\n': "empty.dbc: the file is empty (named by bus[0].database)",
    BUS + 'database = ["none/small.dbc"]\n': "bus[0].database = 'none/small.dbc': No such file or directory",
}


@pytest.mark.parametrize("text", SLIPS)
def test_a_slip_is_one_line_with_the_way_on(gateway, tmp_path, text):
    (tmp_path / "c.toml").write_text(text)
    (tmp_path / "empty.dbc").touch()
    ended = gateway("check", "c.toml")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert ended.err.startswith("error: ")
    assert SLIPS[text] in ended.err


def test_notepads_mark_at_the_begin_is_no_slip(gateway, tmp_path):
    (tmp_path / "c.toml").write_bytes(b"\xef\xbb\xbf" + BUS.encode())
    assert gateway("check", "c.toml").code == 0


def test_where_no_configuration_is_the_shipped_one_is_told(gateway):
    assert gateway("check").err.startswith("no gateway.toml in this folder: the shipped bench")


@pytest.mark.parametrize("words", [("watch", "c.toml"), ("request", "VIN", "-c", "c.toml")])
def test_no_gateway_is_told_at_once(gateway, tmp_path, words):
    (tmp_path / "c.toml").write_text(BUS)
    begun = time.process_time()
    ended = gateway(*words)
    assert ended.code == 2
    assert ended.err.startswith(
        "error: no gateway runs here (faults.sqlite.status: No such file or directory); start one"
    )
    assert time.process_time() - begun < 5.0


def test_a_missing_extra_is_no_bug_of_the_gateway(capsys):
    for package in ("sympy", "sklearn.svm", "starlette", "udsoncan", "paho", "dask.array"):
        assert ended_by(ModuleNotFoundError(name=package)) == 2
        assert "pip install '.[" in capsys.readouterr().err
    assert ended_by(ModuleNotFoundError(name="numpyy")) == 70
    assert {extra for extra, package in EXTRAS.items() if not extra_with(package)} == set()


def test_an_expectation_that_no_fault_can_meet_is_an_error(gateway, tmp_path):
    (tmp_path / "c.toml").write_text(BUS + 'database = ["small.dbc"]\n')
    scenario = 'name = "a"\nduration_s = 1.0\nconfig = "c.toml"\n[[ecu]]\ntype = "restbus"\ncycle_ms = 10.0\n'
    (tmp_path / "s.toml").write_text(scenario + '[[expect]]\ndtc = "U0001-89"\n')
    for words in (("demo", "s.toml", "--speed", "0"), ("simulate", "s.toml", "--bus", "inside", "--check")):
        ended = gateway(*words)
        assert ended.code == 2
        assert "error: s.toml: expect[0].dtc = 'U0001-89': the configuration's faults have" in ended.err
        assert "did you mean U0001-88" in ended.err


def begun(tmp_path, *words):
    return subprocess.Popen(
        [sys.executable, "-m", "gateway", *words], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip


@pytest.mark.system
def test_ctrl_c_at_any_moment_is_one_line(tmp_path):
    """While it is imported, while workers start, while it works: one line each, and the next run goes on."""
    from fleet_logs import write_config, write_fleet

    write_config(tmp_path)
    write_fleet(tmp_path / "logs", 40, frames=4000)
    for wait_s in amount((0.1, 1.0, 2.5), (2.5,)):
        words = ("fleet", "run", "logs/**", "-c", "car.toml", "-o", f"out{wait_s}", "--workers", "1")
        started = begun(tmp_path, *words)
        time.sleep(wait_s)
        os.killpg(started.pid, signal.SIGINT)
        out, err = started.communicate(timeout=120)
        if started.returncode not in (0, -signal.SIGINT):  # it was done; or Python itself had not begun yet
            assert started.returncode == 130, out + err
            assert "Traceback" not in err
            assert err.splitlines()[-1].startswith("stopped: ")


def test_a_pipe_whose_reader_has_enough_is_no_error(tmp_path):
    (tmp_path / "c.toml").write_text(BUS)
    script = f"{sys.executable} -m gateway check c.toml | head -1; exit ${{PIPESTATUS[0]}}"
    ended = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
