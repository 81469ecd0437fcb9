"""Events of a car, from its fault memory to the tables: each is there once, or counted as dropped, whatever ends."""

import json
import random
import re
import sqlite3
import zlib
from collections import Counter
from pathlib import Path

import pytest
from amount import amount
from duck import ask
from road import Memory, car_of, event, occurrences, rows

from gateway.faults.records import Changes
from gateway_fdi.errors import InputError
from gateway_fleet.live import tables
from gateway_fleet.live.batch import MOST_BYTES, packed, unpacked
from gateway_fleet.live.collect import Came, Collector
from gateway_fleet.live.queue import Queue

DOCS = Path(__file__).resolve().parents[2] / "docs" / "fleet.md"


class Killed(Exception):
    """A process ends here."""


class Road:
    """One car and its collector; each may be killed anywhere."""

    def __init__(self, folder, seed, most):
        self.draw, self.folder = random.Random(seed), folder
        self.car = car_of(bytes=most)
        self.path, self.out = folder / "faults.sqlite", folder / "out"
        self.memory, self.queue = Memory(self.path, self.car), Queue(self.path)
        self.collector = Collector(self.out, "vans", 1e9)
        self.written, self.count = set(), 0

    def step(self, monkeypatch):
        self.draw.choice([self.drive, self.drive, self.tell, lambda: self.keep(monkeypatch)])()

    def drive(self):
        new = range(self.count + 1, self.count + self.draw.randint(2, 6))
        self.count = new[-1]
        self.memory.post(*(event(n, self.draw.choice(["dtc", "dtc", "statistics"]), pad=40) for n in new))
        if self.draw.random() < 0.2:  # killed before it is written
            self.queue.close()
            self.memory.close()
            self.memory = Memory(self.path, self.car)
        else:
            assert self.memory.commit()
            self.written |= set(new)

    def tell(self):
        """Send a batch; it comes, comes twice, or is lost, and so is its answer."""
        found, tally = self.queue.read(self.draw.randint(1, 20))
        if not found:
            return
        payload, sent = packed(self.car, found, tally)
        said = []
        for _ in range(self.draw.choice([0, 1, 1, 2])):
            self.collector.put(Came(self.car.car, payload, said.append))
        self.collector._due_s = 1e18  # the tables are written by :meth:`keep`
        if not self.collector._waiting.empty():
            self.collector.turn()
        if said and self.draw.random() < 0.7:
            assert set(said) == {unpacked(payload).digest}
            self.queue.note(sent)
            if self.draw.random() < 0.8:
                self.memory.store.save(Changes(arrived=sent, outgoing_bytes=self.car.bytes))
        elif self.draw.random() < 0.3:
            self.queue = Queue(self.path)  # the process that sends is killed

    def keep(self, monkeypatch):
        """Write the tables, or be killed on the way."""
        at = self.draw.choice(["", "before", "between", "after"])
        write, left = tables.write_table, [1 if at == "between" else 0]

        def cut(path, columns, found):
            if left[0] == 0 and at in ("before", "between"):
                raise Killed
            left[0] -= 1
            write(path, columns, found)

        with monkeypatch.context() as patch:
            patch.setattr(tables, "write_table", cut)
            if at == "after":
                patch.setattr(type(self.collector.inbox), "done", lambda *_: (_ for _ in ()).throw(Killed))
            try:
                tables.export(self.collector.inbox, self.out, "2026-11-29/07")
            except Killed:
                self.collector.close()
                self.collector = Collector(self.out, "vans", 1e9)

    def end(self, monkeypatch):
        self.draw = random.Random(0)
        self.draw.random = lambda: 0.5
        self.draw.choice = lambda of: "" if "" in of else 1
        self.queue = Queue(self.path)
        for _ in range(1000):
            if not self.queue.read(1)[0]:
                break
            self.tell()
        self.keep(monkeypatch)
        dropped = self.memory.store.tally().dropped
        self.queue.close()
        self.memory.close()
        self.collector.close()
        return dropped


@pytest.mark.parametrize("most", [10_000, 10**6])
def test_each_event_is_in_the_tables_once_or_counted_as_dropped(tmp_path, monkeypatch, most):
    dropped = 0
    for seed in range(amount(300, 3, 2)):
        (tmp_path / str(seed)).mkdir()
        road = Road(tmp_path / str(seed), seed, most)
        for _ in range(40):
            road.step(monkeypatch)
        gone = road.end(monkeypatch)
        found = rows(road.out)
        ids = [(row["car"], row["origin"], row["number"]) for row in found]
        assert len(set(ids)) == len(ids), f"seed {seed}: there twice"
        there = {json.loads(row["body"])["t_ns"] for row in found if row["body"]}
        there |= {row["blocks"] for row in rows(road.out, "tests")}
        assert there <= road.written, f"seed {seed}"
        assert len(road.written - there) <= gone, f"seed {seed}: lost, and not counted"
        dropped += gone
        if most == 10**6:
            assert gone == 0
            assert there == road.written
    assert (dropped > 0) == (most == 10_000)
    (query,) = re.findall(r"```sql\n(select fault.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    failed = [row["fault"] for row in found if row["kind"] == "dtc" and row["status"] % 2 == 1]
    answer = ask(query.replace("'tables/", f"'{road.out}/"))
    assert {fault: count for fault, count, _ in answer} == Counter(failed)
    assert failed


def test_where_the_bytes_do_not_suffice_the_oldest_details_go_first(tmp_path):
    memory = Memory(tmp_path / "faults.sqlite", car_of(bytes=10_000))
    memory.post(*(event(n) for n in range(1, 39)))
    memory.commit()
    for n in range(39, 44):
        memory.post(event(n, "statistics", pad=1000))
        memory.commit()
    left = [json.loads(row.body) for row in memory.store.outgoing()]
    tally = memory.store.tally()
    kinds = [each["event"] for each in left]
    details = kinds.count("statistics")
    assert kinds == ["dtc"] * 38 + ["statistics"] * details, "no event went before a detail, older as it was"
    assert 0 < details < 5
    assert [each["t_ns"] for each in left[38:]] == list(range(44 - details, 44)), "the oldest of them went"
    assert tally.dropped == 5 - details
    assert tally.bytes == sum(len(row.body) for row in memory.store.outgoing()) <= 10_000
    for n in range(44, 200):
        memory.post(event(n))
        memory.commit()
    left = [json.loads(row.body)["t_ns"] for row in memory.store.outgoing()]
    assert left == list(range(200 - len(left), 200)), "then the oldest of all"
    memory.close()


def test_a_queue_goes_along_where_a_damaged_file_is_given_up(tmp_path):
    """Ids stay: what had arrived before, and was not said to have, is known again."""
    path = tmp_path / "faults.sqlite"
    memory = Memory(path, car_of())
    memory.post(event(1), event(2))
    memory.commit()
    before = [row.id for row in memory.store.outgoing()]
    memory.store._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    memory.close()
    pages = path.stat().st_size // 4096
    with path.open("r+b") as file:
        for page in range(1, pages):  # all tables' roots but those of the queue
            file.seek(4096 * page)
            if file.read(1) == b"\x0d" and b"P0301-11" not in (content := file.read(4095)) and content.strip(b"\0"):
                file.seek(4096 * page)
                file.write(b"\x77")
                break
    memory = Memory(path, car_of())
    assert [m.kind for m in memory.store.incidents()] == ["damaged"]
    memory.post(event(3))
    memory.commit()
    after = [row.id for row in memory.store.outgoing()]
    assert after[:2] == before
    assert len(set(after)) == 3
    assert after[2].split("-")[0] != before[0].split("-")[0]
    memory.close()


def test_while_the_file_cannot_be_written_the_bytes_are_kept_to_and_what_goes_is_counted(tmp_path, monkeypatch):
    memory = Memory(tmp_path / "faults.sqlite", car_of(bytes=10_000))
    save = type(memory.store).save
    from gateway.faults.store import StoreError

    def full(self, changes, whole=None):
        raise StoreError(self.path, "disk full", full=True)

    monkeypatch.setattr(type(memory.store), "save", full)
    for n in range(1, 301):
        memory.post(event(n))
    assert not memory.commit()
    pending = memory.memory.ledger._pending
    assert sum(len(each.body) for each in pending.outgoing) <= 10_000
    monkeypatch.setattr(type(memory.store), "save", save)
    assert memory.commit()
    left = memory.store.outgoing()
    assert [json.loads(row.body)["t_ns"] for row in left][-1] == 300
    assert memory.store.tally().dropped == 300 - len(left)
    memory.close()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda told: zlib.compress(b"[" * 100_000), "goes too deep|not compressed JSON"),
        (lambda told: zlib.compress(b"0" * (MOST_BYTES + 1)), "more than"),
        (lambda told: b"{}", "not compressed JSON"),
        (lambda told: zlib.compress(json.dumps(told | {"fleet": "others"}).encode()), "another fleet"),
        (lambda told: zlib.compress(json.dumps(told | {"car": "../../etc"}).encode()), "car"),
        (lambda told: zlib.compress(json.dumps(told | {"car": "c0ffee02"}).encode()), "another car than its sender"),
        (lambda told: zlib.compress(json.dumps(told | {"contract": 9}).encode()), "contract 9"),
        (lambda told: zlib.compress(json.dumps(told | {"events": [{}] * 201}).encode()), "at most 200"),
        (lambda told: zlib.compress(json.dumps(told | {"events": [{"id": "x", "limits": 0}]}).encode()), "id"),
    ],
)
def test_a_batch_that_is_none_is_refused_told_and_costs_nobody_else(tmp_path, change, reason):
    memory = Memory(tmp_path / "faults.sqlite", car_of())
    memory.post(event(1))
    memory.commit()
    payload, _ = packed(car_of(), memory.store.outgoing(), memory.store.tally())
    memory.close()
    collector, said = Collector(tmp_path / "out", "vans", 1e9), []
    for each in (change(json.loads(zlib.decompress(payload))), payload):
        collector.put(Came("c0ffee01", each, said.append))
    collector.run(lambda: True)
    assert said == ["", unpacked(payload).digest]
    (refused,) = collector.inbox._db.execute("SELECT reason FROM refused").fetchone()
    assert re.search(reason, refused)
    collector.close()
    assert occurrences(tmp_path / "out") == {1: 1}


def test_an_inbox_that_cannot_be_written_is_answered_by_nothing_and_ends_nothing(tmp_path):
    memory = Memory(tmp_path / "faults.sqlite", car_of())
    memory.post(event(1))
    memory.commit()
    payload, _ = packed(car_of(), memory.store.outgoing(), memory.store.tally())
    memory.close()
    collector, said = Collector(tmp_path / "out", "vans", 1e9), []
    collector.inbox._db.execute("PRAGMA busy_timeout = 0")
    other = sqlite3.connect(tmp_path / "out" / "inbox.sqlite", isolation_level=None)
    for held in (True, False):
        other.execute("BEGIN IMMEDIATE" if held else "ROLLBACK")
        for each in (b"none", payload):
            collector.put(Came("c0ffee01", each, said.append))
            collector.turn()
            collector._due_s = 0.0
        assert len(said) == (0 if held else 2)
    other.close()
    collector.close()
    assert occurrences(tmp_path / "out") == {1: 1}


def test_an_event_that_is_none_of_the_contract_is_refused_and_the_rest_of_its_batch_kept(tmp_path):
    memory = Memory(tmp_path / "faults.sqlite", car_of())
    huge = event(2) | {"occurrence": 10**30}
    memory.post(
        event(1),
        huge,
        {"event": "run", "code": "x"},
        event(4, "statistics") | {"tests": {"fault": ["m.f"], "values": "a"}},
    )
    memory.commit()
    payload, _ = packed(car_of(), memory.store.outgoing(), memory.store.tally())
    memory.close()
    collector, said = Collector(tmp_path / "out", "vans", 1e9), []
    collector.put(Came("c0ffee01", payload, said.append))
    collector.run(lambda: True)
    assert said == [unpacked(payload).digest]
    assert (collector.kept.new, collector.kept.refused) == (2, 2)
    collector.close()
    assert [row["kind"] for row in rows(tmp_path / "out")] == ["dtc", "statistics"]
    assert rows(tmp_path / "out", "tests") == []


def test_a_strange_file_is_no_inbox(tmp_path):
    (tmp_path / "inbox.sqlite").write_bytes(b"no database at all" * 100)
    with pytest.raises(InputError, match="not usable as an inbox"):
        Collector(tmp_path, "vans")
