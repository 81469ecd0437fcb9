"""Copies of a process that has imported the gateway are processes as any other (tests/support/warm.py)."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import warm

PYTHON = [sys.executable, "-c"]
#: Says what differs between processes, and what one has changed before.
WHO = """
import os, random, sys
import gateway.cli.run as imported
print(os.getpid(), os.getcwd(), *sys.argv[1:], random.random(), __name__, vars(imported).setdefault("seen", "first"))
imported.seen = "again"
sys.exit(int(sys.argv[1]))
"""


def said(arguments, **options):
    ended = warm.run([*PYTHON, *arguments], capture_output=True, text=True, **options)
    assert ended.stderr == ""
    return ended.returncode, ended.stdout.split()


def test_each_is_one_of_its_own_and_ends_with_its_own_code(tmp_path):
    code, one = said([WHO, "3"], cwd=tmp_path)
    assert (code, one[1:3], one[4:]) == (3, [str(tmp_path), "3"], ["__main__", "first"])
    code, other = said([WHO, "0"])
    assert (code, other[1:3], other[4:]) == (0, [str(Path.cwd()), "0"], ["__main__", "first"])
    assert len({os.getpid(), int(one[0]), int(other[0])}) == 3
    assert one[3] != other[3], "their own random numbers"
    with pytest.raises(subprocess.CalledProcessError):
        warm.run([*PYTHON, "raise SystemExit(1)"], check=True)


def test_signals_end_it_and_are_told():
    waits = "import time; print('there', flush=True); time.sleep(600)"
    for number in (signal.SIGKILL, signal.SIGTERM):
        with warm.Popen([*PYTHON, waits], stdout=subprocess.PIPE, text=True) as started:
            assert started.stdout.readline() == "there\n"
            assert started.poll() is None
            with pytest.raises(subprocess.TimeoutExpired):
                started.wait(0.01)
            started.send_signal(number)
            assert started.wait(60) == started.poll() == -number


def test_it_has_no_file_of_another_and_only_of_the_same_environment_it_is_a_copy():
    shows = (
        "import os, sys; print(len(os.listdir('/proc/self/fd')), 'gateway.cli.run' in sys.modules, os.environ.get('X'))"
    )
    with warm.Popen([*PYTHON, "input()"], stdin=subprocess.PIPE) as waiting:
        # three of its own, and the folder that is listed
        assert said([shows], env=warm.ENVIRONMENT) == (0, ["4", "True", "None"])
        assert said([shows], env={**warm.ENVIRONMENT, "X": "1"}) == (0, ["4", "False", "1"])
        waiting.communicate(b"\n")
    assert waiting.returncode == 0
