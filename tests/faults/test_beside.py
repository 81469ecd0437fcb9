"""The thread that works beside the gateway."""

import threading

import pytest

from gateway.faults.writer_thread import WriterThread


@pytest.fixture
def writer():
    made = WriterThread("test")
    yield made
    made.shutdown()


def test_work_is_done_one_after_the_other_in_another_thread(writer):
    done = []
    pieces = [writer.submit(lambda k: done.append((k, threading.current_thread().name)), k) for k in range(100)]
    for piece in pieces:
        piece.result()
        assert piece.done()
    assert done == [(k, "test") for k in range(100)]


def test_who_waits_is_told_that_it_takes_longer_and_can_wait_again(writer):
    gate = threading.Event()
    piece = writer.submit(gate.wait)
    with pytest.raises(TimeoutError):
        piece.exception(0.001)
    assert not piece.done()
    gate.set()
    assert piece.exception(60) is None
    assert piece.exception() is None
    assert piece.done()


def test_what_it_raises_is_raised_where_it_is_waited_for_and_the_thread_goes_on(writer):
    def fail():
        raise ValueError("no")

    piece = writer.submit(fail)
    assert isinstance(piece.exception(60), ValueError)
    with pytest.raises(ValueError, match="no"):
        piece.result()
    writer.submit(lambda: None).result(60)


def test_the_end_comes_after_all_that_was_asked_for():
    writer = WriterThread("test")
    gate, done = threading.Event(), []
    writer.submit(gate.wait)
    writer.submit(done.append, 1)
    timer = threading.Timer(0.05, gate.set)
    timer.start()
    writer.shutdown()
    timer.join()
    assert done == [1]
