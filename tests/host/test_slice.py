"""A thread's slices of processor time, read back from the system."""

import os
import platform
import re
import threading

import pytest

from gateway.host import slice as slices

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


@pytest.mark.skipif(not hasattr(os, "sched_setscheduler"), reason="this system has no such classes")
def test_a_thread_comes_first_if_its_user_may():
    found = []

    def run():
        found.append((slices.come_first(), os.sched_getscheduler(0) == os.SCHED_FIFO))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found in ([(True, True)], [(False, False)])
    assert os.sched_getscheduler(0) == os.SCHED_OTHER, "no other thread"
