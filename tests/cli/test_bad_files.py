"""Each file argument of every command, with each kind of file that is none: one line with file and way on, no more."""

import io
import os
import resource
import shutil
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import typer
from amount import FULL
from command import command
from typer.main import get_command

from gateway.bus.frames import empty
from gateway.bus.logs import open_writer
from gateway.cli import app, main

DBC = 'BU_: A\n\nBO_ 256 M: 8 A\n SG_ S : 0|16@1+ (1,0) [0|100] "km/h" A\n'
CONFIG = """[[bus]]
name = "b"
uri = "virtual:b"
database = ["good.dbc"]

[[monitor]]
name = "s"
type = "signal"
signal = [{ signal = "M.S", plausible = [0, 50], code = "P0500" }]

[memory]
path = "new.sqlite"
"""
SCENARIO = 'name = "a"\nduration_s = 0.2\nconfig = "good.toml"\n[[ecu]]\ntype = "restbus"\ncycle_ms = 10.0\n'
KEYS = f'fleet = "a"\nserial = 1\nroot = ["{"00" * 32}"]\nsigner = ["{"00" * 32}"]\n'
MODEL = 'known = { u = {}, y = {} }\nunknown = { x = {} }\nfault = { f = {} }\n[[equation]]\nname = "e1"\n'
MODEL += 'expression = "x - u"\n[[equation]]\nname = "e2"\nexpression = "y - x - f"\n'
#: Command -> its arguments; ``<x`` is a file that it reads, ``>x`` one that it writes.
CALLS = {
    "check": ["<good.toml"],
    "run": ["<good.toml", "--duration", "0", "--memory", ">m.sqlite", "--record", ">r.log"],
    "serve": ["<good.toml", "--port", "0", "--read-token-file", "<token"],
    "watch": ["<good.toml", "--once"],
    "request": ["22F190", "-c", "<good.toml"],
    "mqtt": ["127.0.0.1:9", "-c", "<good.toml"],
    "doctor": ["<good.toml", "--memory", "<good.sqlite"],
    "trust": ["<code.py"],
    "learn": ["<good.dbc", "<good.log", "-o", ">c.toml", "--force"],
    "replay": ["<good.log", "-c", "<good.toml", "--memory", ">m.sqlite", "--html", ">r.html", "--signals", ">s.csv",
               "--plot", ">p.svg", "--junit", ">j.xml"],
    "decode": ["<good.log", "-o", ">lake", "--database", "<good.dbc"],
    "plot": ["<good.csv", "-o", ">p.png"],
    "convert log": ["<good.log", ">c.asc"],
    "import": ["<good.dbc", "-o", ">i.toml", "--request", "0x7E0", "--response", "0x7E8", "--force"],
    "fleet ask": ["<tables", "rates"],
    "fleet page": ["<tables", "-o", ">f.html"],
    "fleet id": ["1HGCM82633A004352", "--key", "<owner.key"],
    "fleet key": [">own.key"],
    "fleet sign": ["<campaign.toml", "--key", "<signer.key", "-o", ">c.signed"],
    "fleet signer": [">s.key"],
    "fleet run": ["<good.log", "-c", "<good.toml", "-o", ">verdicts", "--workers", "0"],
    "fleet report": ["<done", "--html", ">f.html", "--csv", ">f.csv"],
    "fleet diff": ["<done", "<done"],
    "fleet leave": ["-c", "<good.toml"],
    "faults list": ["--memory", "<good.sqlite"],
    "faults show": ["P0500-85", "--memory", "<good.sqlite"],
    "faults clear": ["--memory", "<good.sqlite"],
    "faults verify": ["--memory", "<good.sqlite"],
    "faults near-misses": ["--memory", "<good.sqlite"],
    "faults interventions": ["--memory", "<good.sqlite"],
    "faults recordings": ["P0500-85", "--memory", "<good.sqlite"],
    "faults export": ["<good.toml", "--out", ">f.json"],
    "report": ["s.S.high", "passed", "-c", "<good.toml"],
    "example": ["car", "--folder", ">own"],
    "new-monitor": ["own", "--folder", ">own"],
    "demo": ["<good_scenario.toml", "--speed", "0"],
    "simulate": ["<good_scenario.toml", "--bus", "inside", "--record", ">r.log", "--html", ">r.html", "--junit",
                 ">j.xml"],
    "control": ["<socket", "list"],
    "fit": ["<good.toml", "<good.log"],
    "structure": ["<model.toml", "--plot", ">m.png"],
    "evaluate drives": ["<vehicles", "--workers", "0", "--faults", "0"],
    "evaluate road": ["<vehicles"],
    "record": ["virtual:b", "--out", ">r.log", "--duration", "0"],
}  # fmt: skip
#: Commands that wait for others before they read, or whose file is read by the same lines as another one's.
UNTRIED = {"calibrate", "convert teeth", "evaluate senders", "fleet collect", "fleet forget", "fleet join",
           "fleet learn", "fleet next", "fleet publish", "survey"}  # fmt: skip
READ = ("missing", "empty", "folder", "binary", "unreadable", "bom")
WRITTEN = ("folder", "below a file", "no folder", "full")
#: Options of commands whose files are the same words as those of another one, or whose work is long.
BORROWED = {"status", "socket", "ring", "pdx", "ca", "certificate", "keys", "control", "output", "ecu", "data",
            "figures", "work", "write_to", "key", "cert", "config", "memory", "log", "plot", "junit", "html",
            "out"}  # fmt: skip


def places(call):
    return [k for k, word in enumerate(call) if word[0] in "<>"]


def cases():
    for name, call in CALLS.items():
        for k in places(call):
            for kind in READ if call[k][0] == "<" else WRITTEN:
                if name not in ("mqtt", "serve") or kind != "bom":  # good, and it goes on until it is stopped
                    yield name, k, kind


def made(folder, *words):
    """Have a command make files of the folder."""
    before = Path.cwd()
    os.chdir(folder)
    sys.argv = ["gateway", *words]
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), pytest.raises(SystemExit) as ended:
            main()
    finally:
        os.chdir(before)
    assert not ended.value.code


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder with a good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    frames = empty(400)
    frames["t_ns"] = 1_700_000_000 * 10**9 + 10_000_000 * np.arange(400)
    frames["can_id"], frames["length"] = 256, 8
    frames["data"][:, 0] = 20 + np.arange(400) % 9
    frames["data"][200:250, 0] = 90
    with open_writer(folder / "good.log") as writer:
        writer.write(frames)
    for name, text in {
        "good.dbc": DBC, "good.toml": CONFIG, "good_scenario.toml": SCENARIO, "model.toml": MODEL, "token": "abc\n",
        "code.py": "A = 1\n", "owner.key": "00" * 32, "campaign.toml": KEYS, "socket": "",
    }.items():  # fmt: skip
        (folder / name).write_text(text)
        (folder / name).chmod(0o600)
    for name in ("tables", "vehicles"):
        (folder / name).mkdir()
    made(folder, "replay", "good.log", "-c", "good.toml", "--memory", "good.sqlite", "--signals", "good.csv")
    made(folder, "fleet", "run", "good.log", "-c", "good.toml", "-o", "done", "--workers", "0")
    made(folder, "fleet", "signer", "signer.key")
    return folder


def spoilt(path, kind):
    """Put a file of a kind in the place of a good one."""
    text = path.read_bytes() if path.is_file() else b""
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    if kind == "empty":
        path.touch()
    elif kind == "folder":
        path.mkdir()
    elif kind == "binary":
        path.write_bytes(bytes(range(256)) * 8)
    elif kind == "unreadable":  # for root, too: reading fails with EIO
        path.symlink_to("/proc/self/mem")
    elif kind == "bom":
        path.write_bytes(b"\xef\xbb\xbf" + text)


@contextmanager
def full_disk(wanted):
    """Let no file grow beyond some bytes, as a full disk does."""
    before, wrote = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    if wanted:
        sys.dont_write_bytecode = True  # Python would keep the first 16 bytes of it, for all processes after this one
        resource.setrlimit(resource.RLIMIT_FSIZE, (16, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = wrote


def called(name, k, kind, good, tmp_path, run):
    """Call a command with one file that is none; returns its end, and the name of the file."""
    words = []
    for place, word in enumerate(CALLS[name]):
        if word[0] not in "<>":
            words.append(word)
            continue
        path = tmp_path / word[1:]
        if word[0] == "<" and (good / path.name).exists() and not path.exists():
            copy = shutil.copytree if (good / path.name).is_dir() else shutil.copy
            copy(good / path.name, path)
        if place == k:
            if word[0] == "<":
                spoilt(path, kind)
            elif kind == "folder":
                path.mkdir()
            elif kind == "below a file":
                (tmp_path / "file").write_text("")
                path = tmp_path / "file" / path.name
            elif kind == "no folder":
                path = tmp_path / "none" / path.name
            asked = path.name
        words.append(os.path.relpath(path, tmp_path))
    for file in ("good.dbc", "good.toml"):  # that others name
        if not (tmp_path / file).exists() and f"<{file}" not in CALLS[name]:
            shutil.copyfile(good / file, tmp_path / file)
    with full_disk(kind == "full"):
        return run(*name.split(), *words), asked


#: Each sixth in CI, all in the full size.
CASES = [case for n, case in enumerate(cases()) if FULL or n % 6 == 0]


@pytest.mark.parametrize(("name", "k", "kind"), CASES)
def test_a_file_that_is_none_is_one_line(name, k, kind, good, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    ended, asked = called(name, k, kind, good, tmp_path, lambda *words: command(capsys, monkeypatch, *words))
    assert ended.code in (0, 1, 2), ended.err
    said = [line for line in ended.err.splitlines() if line.startswith("error: ")]
    if ended.code == 2 and kind != "bom":
        if name not in ("fleet run", "evaluate drives"):  # they tell of each log, and go on with the others
            assert 1 <= len(said) <= 4, ended.err
        told = f"{ended.out}{ended.err}"
        assert Path(asked).stem in told or (kind == "below a file" and "error: file: " in told), told
        assert not any("Errno" in line for line in said), said


def test_each_command_with_a_file_is_tried():
    group = get_command(app)

    def of(node, names, context):
        if hasattr(node, "list_commands"):
            for name in node.list_commands(context):
                below = node.get_command(context, name)
                yield from of(below, (*names, name), typer.Context(below))
        else:
            yield " ".join(names), {p.name for p in node.params if "Path" in type(p.type).__name__} - BORROWED

    found = {name: files for name, files in of(group, (), typer.Context(group)) if files}
    assert sorted(set(found) - set(CALLS) - UNTRIED) == []
