"""Budgets of doors and servers: a turn has its time, at least one peer its turn, and who had to wait comes first."""

import struct
from selectors import SelectorKey

import pytest
from doip_rig import GATEWAY, TESTER, message, net

from gateway.common import budget as module
from gateway.common.budget import Budget


@pytest.fixture
def clock(monkeypatch):
    """Processor time that passes when the test says so [s]."""
    now = [0.0]
    monkeypatch.setattr(module.time, "thread_time", lambda: now[0])
    return now


def ready(*descriptors):
    return [(SelectorKey(None, fd, 1, None), 1) for fd in descriptors]


def test_a_turn_ends_with_its_time_and_those_that_waited_come_first(clock):
    budget, served = Budget(0.01), []
    for _ in range(10):
        for key, _mask in budget.among(ready(4, 7, 9, 12)):
            served.append(key.fd)
            clock[0] += 0.006
    assert served == [4, 7, 9, 12] * 5
    assert budget.put_off == 10


def test_who_takes_all_the_time_keeps_nobody_from_its_turn(clock):
    budget, served = Budget(0.01), []
    for _ in range(8):
        for key, _mask in budget.among(ready(4, 7, 9)):
            served.append(key.fd)
            clock[0] += 5.0 if key.fd == 4 else 0.001
    assert min(served.count(7), served.count(9)) == 7


def test_all_are_served_while_there_is_time(clock):
    budget = Budget(0.01)
    assert [key.fd for key, _ in budget.among(ready(3, 5, 8))] == [3, 5, 8]
    assert [*budget.among([])] == []
    assert budget.put_off == 0


def test_requests_that_take_long_leave_others_their_turn(tmp_path, clock, monkeypatch):
    """Two testers by DoIP, one with sixteen requests of 20 ms each: the other waits for one of them, not for all."""
    with net(tmp_path) as made:
        slow, other = made.tester(TESTER), made.tester(TESTER + 1)
        answer, order = made.server.answered, []

        def answered(application, request, functional, t_ns):
            order.append(request)
            clock[0] += 0.02 if request == b"\x22\xf1\x86" else 0.0
            return answer(application, request, functional, t_ns)

        monkeypatch.setattr(made.server, "answered", answered)
        head = struct.pack(">HH", TESTER, GATEWAY)
        slow.send(message(0x8001, head + b"\x22\xf1\x86") * 16)
        assert len(order) == 1, "its turn is over"
        assert other("3E 00") == "7e00"
        for _ in range(100):
            made.rig.wait(1, step=1)
        assert len(order) == 17, "and all have their answers"
        assert slow.take()[-1][1][4:] == b"\x62\xf1\x86\x01"
