"""A thread's slices of processor time, read back from the system."""

import os
import platform
import re
import subprocess
import sys
import threading

import pytest

from gateway.host import slice as slices

#: ``gateway run`` where real time is refused.
REFUSED = """
import os, sys
def refuse(*_):
    raise PermissionError
os.sched_setscheduler = refuse
from gateway.cli import main
main()
"""

#: Linux takes notice from 6.12 on.
TAKEN = tuple(int(part) for part in re.findall(r"\d+", platform.release())[:2]) >= (6, 12)


@pytest.mark.skipif(slices.slice_ns() is None, reason="this system does not tell")
def test_they_are_short_within_and_as_before_after_it():
    before = slices.slice_ns()
    with slices.short_slices(200_000):
        assert slices.slice_ns() == (200_000 if TAKEN else before)
    assert slices.slice_ns() == before


def test_where_there_are_none_nothing_happens(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    with slices.short_slices(200_000):
        assert slices.slice_ns() is None


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="this system has no such classes")
def test_a_thread_comes_first_if_its_user_may_and_none_that_it_begins():
    found = []

    def first():
        return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO

    def run():
        with slices.real_time() as may:
            found.append((may, first()))
            mine = threading.Thread(target=lambda: found.append(first()))
            mine.start()
            mine.join()
        found.append(first())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found in ([(True, True), False, False], [(False, False), False, False])
    assert os.sched_getscheduler(0) == os.SCHED_OTHER, "no other thread"


@pytest.mark.skipif(not hasattr(os, "SCHED_RESET_ON_FORK"), reason="this system has no such classes")
def test_a_thread_that_is_of_real_time_already_stays_as_it_is(monkeypatch):
    def change(*_):
        raise AssertionError("it was changed")

    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_RR | os.SCHED_RESET_ON_FORK)
    monkeypatch.setattr(os, "sched_setscheduler", change)
    with slices.real_time() as may:
        assert may


def test_who_may_not_come_first_goes_on(monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
    with slices.real_time() as may:
        assert not may


def test_a_daemon_that_may_not_is_told_so_and_monitors(tmp_path):
    (tmp_path / "car.toml").write_text('[[bus]]\nname = "b"\nuri = "virtual:x"\ndatabase = ["car.dbc"]\n')
    (tmp_path / "car.dbc").write_text('VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|255] "" A\n')
    command = [sys.executable, "-c", REFUSED, "run", "car.toml", "--realtime", "--duration", "0.1"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "--realtime: not granted" in ended.stderr
    assert "bus b open" in ended.stdout
