"""Errors of the gateway itself, of the machine, and signals while it starts: one line, and an exit code that
says it.
"""

import importlib
import io
import os
import signal
import subprocess
import sys
import threading
from importlib.metadata import metadata
from pathlib import Path

import pytest
from command import command
from rich.table import Table

from gateway import cli
from gateway.cli import failure
from gateway.cli.folding import FoldingConsole

ROOT = Path(cli.__file__).parents[2]


@pytest.fixture
def gateway(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    monkeypatch.delenv(failure.DEBUG, raising=False)
    return lambda *arguments: command(capsys, monkeypatch, *arguments)


def broken(*_, **__):
    raise KeyError("volts")


@pytest.mark.evidence("Nothing is silent: bug")
def test_a_bug_is_one_line_that_says_where_to_report_it(gateway, monkeypatch):
    importlib.import_module("gateway_commands.check")
    monkeypatch.setattr(sys.modules["gateway_commands.check"], "load_config", broken)
    ended = gateway("check", "gateway.toml")
    assert ended.code == failure.BUG
    (line,) = ended.err.splitlines()
    assert "this is a bug of the gateway" in line
    assert "KeyError: 'volts' (packages/gateway_commands/check.py:" in line
    assert failure.report_to() in line
    assert "gateway --debug" in line


@pytest.mark.long
@pytest.mark.parametrize("how", ["option", "variable"])
def test_the_traceback_is_there_for_who_asks(tmp_path, how):
    code = (
        "from gateway.common.lazy_modules import postpone; postpone()\n"
        "import gateway_commands.check as c, gateway.cli as cli\n"
        "def broken(*a, **k): raise KeyError('volts')\n"
        "c.load_config = broken\ncli.main()\n"
    )
    options, more = (["--debug"], {}) if how == "option" else ([], {failure.DEBUG: "1"})
    ended = subprocess.run(
        [sys.executable, "-c", code, *options, "check"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), **more},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == failure.BUG
    assert "Traceback" in ended.stderr
    assert "this is a bug of the gateway" in ended.stderr


def test_where_to_report_comes_from_the_package(monkeypatch):
    found = metadata("numpy")
    monkeypatch.setattr(failure, "metadata", lambda _: found)
    assert failure.report_to().startswith("https://")

    class Bare:
        def get_all(self, _):
            return None

    monkeypatch.setattr(failure, "metadata", lambda _: Bare())
    assert failure.report_to() == "where you have it from"


def test_what_the_machine_refuses_is_no_bug(gateway, tmp_path):
    ended = gateway("faults", "export", "--out", tmp_path / "no" / "such" / "folder.json")
    assert ended.code == 2
    said = f"{tmp_path}/no/such/folder.json: --out: No such file or directory; there is no folder {tmp_path}/no/such"
    assert said in ended.err


def test_a_thread_that_fails_says_so_in_one_line(gateway, capsys):
    gateway("--version")
    thread = threading.Thread(target=broken)
    thread.start()
    thread.join()
    said = capsys.readouterr().err
    assert "this is a bug of the gateway" in said
    assert "Traceback" not in said


def test_tables_fold_and_cut_nothing():
    table = Table("actuator", "production", "principle of decision", title="A title " * 20)
    table.add_row("aileron" * 5, "x" * 30, "a long explanation in several words")
    out = io.StringIO()
    console = FoldingConsole(file=out, width=30)
    console.print(table)
    text = out.getvalue()
    assert "…" not in text
    assert text.startswith("A title A title")
    cells = [[], [], []]
    for line in text.splitlines():
        parts = [part.strip() for part in line.strip("│┃").replace("┃", "│").split("│")]
        if len(parts) == 3:
            for cell, part in zip(cells, parts, strict=True):
                cell.append(part)
    assert "aileron" * 5 in "".join(cells[0])
    assert "x" * 30 in "".join(cells[1])


#: Stands for a compiler: a call into C that holds the main thread, and in which no handler of Python runs.
COMPILING = """
import ctypes, sys, time
from gateway.common.lazy_modules import postpone
postpone()
import {module} as module
def compiling(*a, **k):
    print("compiling", file=sys.stderr, flush=True)
    ctypes.CDLL(None).sleep.argtypes = [ctypes.c_uint]
    end = time.monotonic() + 900
    while time.monotonic() < end:
        ctypes.CDLL(None).sleep(900)
module.{name} = compiling
from gateway.cli import main
main()
"""


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    ("arguments", "module", "name", "code"),
    [
        (("run",), "gateway.live.daemon", "prepare", 0),
        (("simulate", "crank_healthy", "--bus", "inside", "--check"), "gateway_bench.cli.simulate", "Gateway", 143),
    ],
)  # fmt: skip
def test_a_signal_while_it_compiles_ends_it_at_once(tmp_path, arguments, module, name, code, number):
    started = subprocess.Popen(
        [sys.executable, "-c", COMPILING.format(module=module, name=name), *arguments],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while "compiling" not in (line := started.stderr.readline()):
            assert line
        started.send_signal(number)
        assert started.wait(200) == code, "not when the compiler is done, a quarter of an hour later"
    finally:
        started.kill()
        started.wait(10)
        started.stderr.close()


def test_a_simulation_that_is_stopped_is_not_judged(gateway, monkeypatch):
    """SIGTERM during the run ends it there, and a check that saw half of it is no pass."""
    from gateway_bench import drive

    arriving = drive.arriving

    def arriving_and_stop(frames):
        os.kill(os.getpid(), signal.SIGTERM)
        return arriving(frames)

    monkeypatch.setattr(drive, "arriving", arriving_and_stop)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        ended = gateway("simulate", "crank_healthy", "--bus", "inside", "--check", "--json")
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert ended.code == 128 + signal.SIGTERM
    assert "stopped by a signal before its end: nothing is judged" in ended.err
    assert [e for e in ended.events if e["event"] == "expectation"] == []
    assert ended.event("summary")["frames"] < 100


@pytest.mark.parametrize(
    "arguments",
    [
        ("check",),
        ("doctor",),
        ("structure", "machine"),
        ("structure", "machine", "--residual", "unique"),
        ("bus", "127.0.0.1:0", "--duration", "0"),
    ],
)
def test_json_is_a_document_a_line(gateway, arguments):
    ended = gateway(*arguments, "--json")
    assert ended.code == 0
    assert len(ended.events) == (2 if arguments[0] == "bus" else 1)
