"""One thread writes a memory at a time; whoever reads meanwhile sees whole commits, and never bends a write."""

import sqlite3
import threading

import pytest
from amount import amount

from gateway.faults import service
from gateway.faults.ledger import Ledger
from gateway.faults.records import Changes, Cycle
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.store import Store, StoreError


def in_thread(work):
    """Do something in another thread, and return what it raised."""
    raised = []

    def run():
        try:
            work()
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(60)
    assert not thread.is_alive()
    return raised


def test_a_reload_reads_while_a_thread_writes_and_no_row_is_lost(tmp_path):
    """Reading and writing shared one connection: a write became several commits, or was rolled back by the reader."""
    path, ok, raised = tmp_path / "m.sqlite", set(), []
    store = ResilientStore(path)

    def work():
        for n in range(amount(400, 150)):
            try:
                store.save(Changes(facts={f"a{n}.{k}": n for k in range(8)}))
                ok.add(n)
            except StoreError as error:
                raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    read = 0
    while thread.is_alive():
        ledger = Ledger(store)
        seen = [name.partition(".")[0] for name in ledger._facts]
        assert all(seen.count(name) == 8 for name in set(seen)), "whole commits"
        read += 1
    thread.join()
    assert store.verify().broken == []
    store.close()
    db = sqlite3.connect(path)
    have = {name for (name,) in db.execute("SELECT name FROM fact")}
    db.close()
    assert raised == []
    assert {f"a{n}.{k}" for n in ok for k in range(8)} <= have
    assert read > 3
    assert service.verify(path)["whole"]


@pytest.mark.parametrize("kind", [Store, ResilientStore])
def test_a_transaction_within_that_of_another_thread_is_an_error(tmp_path, kind):
    """It was taken for a part of that one, which may be undone."""
    store = kind(tmp_path / "m.sqlite")
    with store.transaction():
        store.save(Changes(facts={"ours": 1}))
        for work in (
            lambda: store.save(Changes(facts={"theirs": 1})),
            lambda: store.transaction().__enter__(),
            store.compact,
        ):
            (error,) = in_thread(work)
            assert isinstance(error, StoreError)
            assert "another thread writes it now" in str(error)
        assert store.facts() == {"ours": 1}, "its own thread sees what it writes"
        seen = []
        assert in_thread(lambda: seen.append(store.facts())) == []
        assert seen == [{}], "others see the last commit"
    assert in_thread(lambda: store.save(Changes(facts={"theirs": 1}))) == []
    assert store.facts() == {"ours": 1, "theirs": 1}
    store.close()


def test_a_reading_has_one_commit_however_long_it_takes(tmp_path):
    store = ResilientStore(tmp_path / "m.sqlite")
    store.save(Changes(facts={"n": 1}, cycles={"power": Cycle(1, True, 0)}))
    with store.reading():
        assert store.facts() == {"n": 1}
        assert in_thread(lambda: store.save(Changes(facts={"n": 2}, cycles={"power": Cycle(2, True, 0)}))) == []
        assert (store.facts(), store.cycles()["power"].number) == ({"n": 1}, 1)
    assert (store.facts(), store.cycles()["power"].number) == ({"n": 2}, 2)
    store.close()


def test_a_memory_of_this_process_has_one_thread_at_a_time_too():
    store, over = Store(None), threading.Event()

    def read():
        while not over.is_set():
            Ledger(store)

    thread = threading.Thread(target=read)
    thread.start()
    for n in range(200):
        store.save(Changes(cycles={"power": Cycle(n, True, 0)}, facts={f"f{n}": n}))
    over.set()
    thread.join(60)
    assert len(store.facts()) == 200
    store.close()
