"""The journal: its records, its thread, and what becomes of frames that it does not send."""

import os
import threading
import zlib

import pytest
from amount import amount
from journalled import Bus, putter

from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.faults import journal_file, journal_steps
from gateway.faults.journal import NO_JOURNAL, Journal
from gateway.faults.journal_file import RECORD, SLOT, SLOTS, LastVerdict, name_of, records, waiting

HEAD, OTHER = bytes(range(32)), bytes(range(1, 33))


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "m.sqlite"
    path.write_bytes(b"SQLite")
    path.chmod(0o640)
    return path


@pytest.fixture
def journal(database):
    made = Journal(database)
    yield made
    made.close()


@pytest.fixture
def held(database, monkeypatch):
    """A journal whose thread has not begun: a disk that takes its time."""
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", lambda thread: None)
        return Journal(database)


@pytest.fixture
def bus():
    made = Bus()
    yield made
    made.close()


def put(put_one, number, bus, place=0, kind=QUALIFIED_FAILED, t_ns=5):
    return put_one(place, kind, t_ns, 0x2F, 3, -128, Bus.wire(number), 16, bus.inside.fileno())


@pytest.mark.evidence("Durability: journal frame")
def test_a_verdict_is_in_the_file_when_its_frame_comes(journal, database, bus):
    hand_over = putter(journal)
    journal.arm(HEAD)
    number = put(hand_over, 7, bus, place=2, kind=QUALIFIED_PASSED, t_ns=-(10**18))
    assert bus.next() == 7
    expected = LastVerdict(number, HEAD, name_of("m.f2"), -(10**18), QUALIFIED_PASSED, 0x2F, 3, -128)
    assert waiting(database, HEAD) == [expected]
    assert waiting(database, OTHER) == [], "another commit has it"
    assert journal.withdraw(number)
    place = number % SLOTS * SLOT
    content = journal_file.path_of(database).read_bytes()[place : place + RECORD]
    assert int.from_bytes(content[-8:], "little") == zlib.crc32(content[:-8]), "our CRC is the usual one"
    assert journal_file.path_of(database).stat().st_mode & 0o777 == 0o640


def test_it_takes_nothing_unless_it_is_armed(journal, bus):
    hand_over = putter(journal)
    assert put(hand_over, 1, bus) == 0
    journal.arm(HEAD)
    assert put(hand_over, 2, bus) == 1
    journal.arm(b"")
    assert put(hand_over, 3, bus) == 0
    assert bus.next() == 2
    args = (0, QUALIFIED_FAILED, 0, 0, 0, 0, Bus.wire(0), 16, 0)
    assert journal_steps.journal_put(NO_JOURNAL, *args) == 0
    assert bus.silent()


def test_records_go_round_and_those_of_one_commit_are_never_overwritten(journal, database, bus):
    hand_over = putter(journal)
    for commit in range(3):
        head = bytes([commit]) * 32
        journal.arm(head)
        for k in range(SLOTS):
            assert put(hand_over, k, bus) == SLOTS * commit + k + 1
            assert bus.next() == k
        assert put(hand_over, 99, bus) == 0, "there is no room for it beside the others"
        assert [record.number for record in waiting(database, head)] == list(
            range(SLOTS * commit + 1, SLOTS * (commit + 1) + 1)
        )


def test_numbers_go_on_at_the_next_start_and_what_waits_stays(database, bus):
    first = Journal(database)
    first.arm(HEAD)
    put(putter(first), 1, bus)
    first.close()
    again = Journal(database)
    assert [record.number for record in waiting(database, HEAD)] == [1]
    again.arm(OTHER)
    assert put(putter(again), 2, bus) == 2
    again.close()
    assert [bus.next(), bus.next()] == [1, 2]


def test_a_frame_that_is_withdrawn_is_never_sent_and_its_verdict_is_kept(held, database, bus):
    held.arm(HEAD)
    hand_over = putter(held)
    first, second, third = (put(hand_over, k, bus) for k in (1, 2, 3))
    assert not held.withdraw(second)
    held._thread.start()
    assert [bus.next(), bus.next()] == [1, 3]
    assert held.withdraw(first)
    assert not held.withdraw(second)
    held.close()
    assert held.withdraw(third)
    assert bus.silent()
    assert [record.number for record in waiting(database, HEAD)] == [1, 2, 3]


def test_a_socket_that_is_closed_gets_no_frame_though_another_file_has_its_number(held, bus, tmp_path):
    held.arm(HEAD)
    number = put(putter(held), 1, bus)
    fd = bus.inside.fileno()
    held.settle()
    other = Bus()
    os.dup2(other.inside.fileno(), fd)
    held._thread.start()
    held.close()
    assert other.silent()
    assert bus.silent()
    assert not held.withdraw(number)
    other.close()


def test_a_full_ring_takes_no_more(held, bus):
    hand_over = putter(held)
    for k in range(SLOTS + 2):
        held.arm(bytes([k]) * 32)
        assert bool(put(hand_over, k, bus)) == (k < SLOTS)
    held._thread.start()
    assert [bus.next() for _ in range(SLOTS)] == list(range(SLOTS))
    held.close()


def test_a_frame_that_the_bus_does_not_take_is_python_s(journal, database, bus):
    journal.arm(HEAD)
    closed = os.dup(0)
    os.close(closed)
    number = putter(journal)(0, QUALIFIED_FAILED, 0, 0x2F, 1, 127, Bus.wire(1), 16, closed)
    put(putter(journal), 2, bus)
    assert bus.next() == 2
    assert not journal.withdraw(number)
    assert len(waiting(database, HEAD)) == 2


@pytest.mark.parametrize(
    ("instead", "reason"),
    [("/dev/null", "synchronised"), ("pipe", "written")],
)
def test_if_a_record_cannot_be_kept_nothing_is_sent_and_nothing_taken_any_more(held, bus, instead, reason):
    ends = (os.open(instead, os.O_RDWR), None) if instead != "pipe" else os.pipe()[::-1]
    held._state[0].file = ends[0]
    held.arm(HEAD)
    hand_over = putter(held)
    numbers = [put(hand_over, 1, bus), put(hand_over, 2, bus)]
    held._thread.start()
    held.settle()
    assert not any(map(held.withdraw, numbers))
    while not (why := held.look()):
        pass
    assert reason in why
    assert held.look() == "", "it is told once"
    held.arm(OTHER)
    assert put(hand_over, 3, bus) == 0
    held.close()
    assert bus.silent()
    for end in ends:
        if end is not None:
            os.close(end)


def test_a_journal_that_is_gone_takes_no_more(journal, database, bus):
    assert journal.look() == ""
    journal.arm(HEAD)
    journal_file.path_of(database).unlink()
    assert "No such file" in journal.look()
    journal.arm(HEAD)
    assert put(putter(journal), 1, bus) == 0


def test_garbage_is_no_record(database, bus):
    made = Journal(database)
    made.arm(HEAD)
    hand_over = putter(made)
    for k in range(3):
        put(hand_over, k, bus)
    made.close()
    path = journal_file.path_of(database)
    whole = path.read_bytes()
    assert len(records(whole)) == 3
    for place in range(RECORD):
        for bit in range(8):
            broken = bytearray(whole)
            broken[2 * SLOT + place] ^= 1 << bit
            assert [record.number for record in records(bytes(broken))] == [1, 3], (place, bit)
    for length in (0, 1, SLOT, SLOT + RECORD - 1):
        assert records(whole[:length]) == []
    path.write_bytes(os.urandom(3 * SLOT + 7))
    again = Journal(database)
    assert len(path.read_bytes()) == journal_file.LENGTH
    again.arm(HEAD)
    assert put(putter(again), 1, bus)
    again.close()
    assert len(waiting(database, HEAD)) == 1


def obstacle(kind, path):
    if kind == "folder":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(path.with_name("elsewhere"))
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(b"")
        os.chown(path, os.getuid() + 4321, -1)
        path.write_bytes(b"theirs")


@pytest.mark.parametrize("kind", ["folder", "link", "pipe", "of another user"])
def test_a_place_that_is_taken_is_refused_and_nothing_is_read_there(database, kind):
    if kind == "of another user" and os.geteuid() != 0:
        pytest.skip("only root can give a file away")
    obstacle(kind, journal_file.path_of(database))
    with pytest.raises(OSError, match="directory|symbolic|no file|another user"):
        Journal(database)
    assert waiting(database, HEAD) == []


def test_verdicts_leave_while_a_thread_of_python_computes(journal, bus):
    """The thread asks for no lock of Python's: nothing of what it does is Python."""
    hand_over, over = putter(journal), threading.Event()

    def compute():
        while not over.is_set():
            sum(range(1000))

    busy = threading.Thread(target=compute)
    busy.start()
    count = amount(200, 50, 20)
    for k in range(count):
        journal.arm(bytes([k]) * 32)
        assert put(hand_over, k, bus)
        assert bus.next() == k
    over.set()
    busy.join()
    assert int(journal._state[0].kept) == count
