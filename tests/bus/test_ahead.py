"""Batches that a thread makes while the one before is worked on."""

import threading

import numpy as np
import pytest

from gateway.bus.ahead import read_ahead
from gateway.bus.frames import empty
from gateway.errors import InputError


def numbered(k):
    frames = empty(3)
    frames["t_ns"] = k
    return frames


def test_batches_come_in_their_order_and_the_error_behind_them():
    made = [numbered(k) for k in range(50)]

    def source():
        yield from made
        raise InputError("damaged after frame 150")

    got = []
    with pytest.raises(InputError, match="after frame 150"):
        got.extend(read_ahead(source()))
    assert len(got) == 50
    assert all(np.array_equal(a, b) for a, b in zip(got, made, strict=True))


def test_one_batch_is_made_while_another_is_worked_on_and_no_more():
    begun, asked = [threading.Event() for _ in range(5)], []

    def source():
        for k, event in enumerate(begun):
            asked.append(k)
            event.set()
            yield numbered(k)

    for k, _ in enumerate(read_ahead(source())):
        if k + 1 < len(begun):
            assert begun[k + 1].wait(60)  # made by the thread: nobody asks for it here
        assert len(asked) <= k + 2


def test_who_stops_early_ends_the_thread():
    closed = threading.Event()

    def source():
        try:
            for k in range(1000):
                yield numbered(k)
        finally:
            closed.set()

    before = threading.active_count()
    batches = read_ahead(source())
    next(batches)
    batches.close()
    assert threading.active_count() == before
    del batches
    assert closed.wait(60)


def test_no_batch_at_all():
    assert list(read_ahead([])) == []
