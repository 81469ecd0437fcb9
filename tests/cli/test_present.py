"""What people see of events."""

import pytest

from gateway.cli.present import EventPrinter


def test_the_seconds_that_people_see_go_on_where_the_clock_was_set(capsys):
    printer = EventPrinter(as_json=False, start_ns=10 * 10**9)
    bus = {"event": "bus", "bus": "b", "uri": "test:b", "state": "open", "reason": ""}
    printer({**bus, "t_ns": 11 * 10**9})
    printer({"event": "clock", "t_ns": (12 - 3600) * 10**9, "step_s": -3600.0})
    printer({**bus, "t_ns": (13 - 3600) * 10**9})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in lines] == ["1.0000", "2.0000", "3.0000"]
    assert lines[1][2:] == ["clock", "set", "by", "-3600.000000", "s"]


@pytest.mark.parametrize(
    ("faults", "text"),
    [(["a.length", "b[0]"], "a.length, b[0]"), ([], "no entry was there")],
)
def test_a_clear_names_the_entries_that_went(capsys, faults, text):
    EventPrinter(as_json=False)({"event": "clear", "t_ns": 2 * 10**9, "faults": faults})
    assert capsys.readouterr().out.split(maxsplit=2)[2].strip() == f"cleared: {text}"
