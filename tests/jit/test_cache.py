"""Compiled kernels in files: damaged, of another version, not to be read or written, written by two at once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gateway_fdi.common import progress
from gateway_fdi.jit import COMPILED, cache
from gateway_fdi.jit.cache import Code

pytestmark = pytest.mark.skipif(not COMPILED, reason="not COMPILED: there is no cache")

CODE = Code("gateway_1", "i", ("sqrt",), b"\x00code\n\xff" * 50, {"kernel": "a:b"})

#: A process that compiles a kernel of a file, says what it said, and prints 5.
PROGRAM = """
import sys
from gateway_fdi.common import progress
import mine
said = []
progress.say = said.append
compiled = []
progress.listen(lambda name, done, total: compiled.append(name) if done == 0 else None)
assert mine.plus(2, 3) == 5
print(len(compiled), said)
"""
MINE = "from gateway_fdi.jit import kernel\n\n\n@kernel\ndef plus(a, b):\n    return a + b\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("GATEWAY_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(cache, "_said", set())
    return tmp_path / "kernels"


@pytest.fixture
def said(monkeypatch):
    lines = []
    monkeypatch.setattr(progress, "say", lines.append)
    return lines


def run(tmp_path, program=PROGRAM, **environment):
    (tmp_path / "mine.py").write_text(MINE)
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
            "GATEWAY_CACHE_DIR": str(tmp_path / "cache"),
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.strip()


def test_a_file_that_another_process_forgets_meanwhile_is_not_counted(folder, monkeypatch):
    folder.mkdir(parents=True)
    (folder / "here.kernel").write_bytes(b"12345")
    seen = Path.glob
    monkeypatch.setattr(Path, "glob", lambda self, pattern: [*seen(self, pattern), folder / "gone.kernel"])
    assert cache.size() == (1, 5)


def test_what_was_written_is_read(folder, said):
    cache.write("a.b", "1", CODE)
    assert cache.read("a.b", "1") == CODE
    assert cache.read("a.b", "2") is None
    assert not said


@pytest.mark.parametrize("cut", [0, 5, 20, 40, 200])
def test_a_file_that_is_cut_off_or_changed_is_said_once_and_not_used(folder, said, cut):
    cache.write("a.b", "1", CODE)
    path = folder / "a.b-1.kernel"
    data = path.read_bytes()
    for damaged in (data[:cut], data[:cut] + bytes([data[cut] ^ 1]) + data[cut + 1 :]):
        path.write_bytes(damaged)
        assert cache.read("a.b", "1") is None
    assert len(said) == 1
    assert "a.b-1.kernel: damaged" in said[0]


def give_to_another(path, how, monkeypatch):
    """Have something belong to another user, or be writable by others."""
    if how == "mode":
        path.chmod(path.stat().st_mode | 0o022)
    elif os.geteuid() == 0:
        os.chown(path, 65534, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda mine=os.geteuid(): mine + 1)


@pytest.mark.parametrize("how", ["owner", "mode"])
def test_what_another_could_have_written_is_not_loaded(folder, said, monkeypatch, how):
    cache.write("a.b", "1", CODE)
    path = folder / "a.b-1.kernel"
    give_to_another(path, how, monkeypatch)
    assert cache.read("a.b", "1") is None
    (line,) = said
    assert str(path) in line


@pytest.mark.parametrize("how", ["owner", "mode"])
@pytest.mark.parametrize("home", [True, False])
def test_a_folder_of_another_is_not_used_but_a_private_one(folder, said, monkeypatch, tmp_path, how, home):
    cache._private.cache_clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home") if home else "/proc/none")
    cache.write("a.b", "1", CODE)
    give_to_another(folder, how, monkeypatch)
    assert cache.read("a.b", "1") is None
    cache.write("a.b", "1", CODE)
    cache.write("a.b", "2", CODE)
    if how == "mode" or os.getuid() == 0:  # else all that we write is another's, too
        assert cache.read("a.b", "2") == CODE
    assert not (folder / "a.b-2.kernel").exists()
    assert (str(tmp_path / "home") in str(cache.folder())) == home
    assert len([line for line in said if f"{folder}: not used" in line]) == 1
    cache._private.cache_clear()


def test_a_wide_umask_does_not_make_our_files_foreign(folder, said):
    before = os.umask(0)
    try:
        cache.write("a.b", "1", CODE)
    finally:
        os.umask(before)
    assert cache.read("a.b", "1") == CODE
    assert not said


def test_a_folder_that_cannot_be_made_costs_one_line(tmp_path, monkeypatch, said):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GATEWAY_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr(cache, "_said", set())
    cache.write("a.b", "1", CODE)
    cache.write("a.c", "1", CODE)
    assert cache.read("a.b", "1") is None
    assert len([line for line in said if "kept" in line]) == 1


def test_a_full_disk_leaves_no_half_file(folder, monkeypatch, said):
    def full(path, data):
        with path.open("wb") as file:
            file.write(data[:10])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    cache.write("a.b", "1", CODE)
    assert list(folder.iterdir()) == []
    assert "No space left" in said[0]


def test_the_newest_of_a_kernel_are_kept(folder):
    for k in range(cache.KEPT + 5):
        cache.write("a.b", str(k), CODE)
    cache.write("a.c", "1", CODE)
    assert len(list(folder.glob("a.b-*"))) == cache.KEPT
    assert cache.read("a.c", "1") == CODE


@pytest.mark.long
def test_the_second_process_loads_what_the_first_has_compiled(tmp_path):
    assert run(tmp_path) == "1 []"
    assert run(tmp_path) == "0 []"
    (file,) = (tmp_path / "cache/kernels").glob("mine.plus-*")
    file.write_bytes(file.read_bytes()[:-1])
    assert run(tmp_path).startswith("1 ['")  # compiled again, and said
    assert run(tmp_path) == "0 []"


@pytest.mark.long
def test_a_comment_compiles_nothing_and_an_edit_compiles(tmp_path, monkeypatch):
    assert run(tmp_path) == "1 []"
    monkeypatch.setattr(sys.modules[__name__], "MINE", MINE + "# a comment\n")
    assert run(tmp_path) == "0 []"
    monkeypatch.setattr(sys.modules[__name__], "MINE", MINE.replace("a + b", "b + a"))
    assert run(tmp_path) == "1 []"


@pytest.mark.full("4 s")
def test_many_processes_at_once_compile_the_same(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
        "GATEWAY_CACHE_DIR": str(tmp_path / "cache"),
    }
    started = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    for one in started:
        out, err = one.communicate()
        assert one.returncode == 0, err
        assert out.strip().endswith("[]")
    assert run(tmp_path) == "0 []"


@pytest.mark.full("2 s")
def test_code_of_other_libraries_is_not_loaded(tmp_path):
    assert run(tmp_path) == "1 []"
    newer = "import importlib.metadata as m\nold = m.version\n"
    newer += "m.version = lambda name: '99.0' if name == 'numba' else old(name)\n"
    assert run(tmp_path, newer + PROGRAM) == "1 []"


@pytest.mark.full("2 s")
def test_with_bounds_checks_an_index_outside_is_an_error_and_without_what_is_kept_is_another(
    tmp_path,
):
    program = """
import numpy as np
from gateway_fdi.errors import KernelError
from jit_kernels import at
try:
    print(at(np.zeros(4)[:2], 2))
except KernelError as error:
    print(error)
"""
    assert run(tmp_path, program) == "0.0"
    told = run(tmp_path, program, GATEWAY_BOUNDSCHECK="1")
    assert "the kernel at failed" in told
    assert "NUMBA_DISABLE_JIT=1" in told
