"""What was committed is there after anything: restart, kill -9, readers beside, foreign files."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from fault_examples import AtOnce, catalogue, event, frame, nothing

from gateway.faults import service
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.dtc import Dtc
from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status
from gateway.faults.store import Store
from gateway_fdi.errors import GatewayError, InputError


@pytest.mark.evidence("Durability: restart")
def test_everything_survives_a_restart(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.start_cycle(5)
    memory.apply(event(0, True, 10, value=2.5), frame({"a.B.C": 4.0, "a.B.D": float("nan")}))
    memory.apply(event(0, False, 11), nothing)
    memory.apply(event(0, True, 12, value=3.5), frame({"a.B.C": 5.0, "a.B.D": 1.0}))
    memory.commit()
    store.close()
    again = FaultMemory(catalogue(), Store(path))
    (entry,) = again.entries()
    assert (str(entry.dtc), entry.fault) == ("P0300-11", "m.f0")
    assert (entry.record.occurrence, entry.record.first_ns, entry.record.last_ns) == (2, 10, 12)
    assert int(entry.status) == 0x2F
    assert entry.record.evidence == {"value": 3.5, "threshold": 1.0, "residual": 7.0, "tooth": 3.0}
    assert [(f.number, f.t_ns, f.content) for f in entry.freeze_frames] == [
        (1, 10, {"a.B.C": 4.0, "a.B.D": None}),
        (2, 12, {"a.B.C": 5.0, "a.B.D": 1.0}),
    ]


@pytest.mark.evidence("Durability: commit")
def test_nothing_is_durable_before_commit(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    assert service.list_entries(path) == []
    memory.commit()
    assert [e["dtc"] for e in service.list_entries(path)] == ["P0300-11"]
    store.close()


def test_a_cycle_that_was_never_ended_goes_on_at_the_next_start(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue((1,)), store)
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    memory.end_cycle(1)
    memory.start_cycle(2)
    memory.apply(event(0, False), nothing)
    memory.commit()
    store.close()  # as a kill would leave it: the cycle is open
    again = FaultMemory(catalogue((1,)), Store(path))
    again.start_cycle(3)
    assert again.cycle_number() == 2
    assert again.status("m.f0") & Status.PENDING_DTC
    again.end_cycle(4)
    assert not again.status("m.f0") & Status.PENDING_DTC, "the second cycle was complete and good"


def test_entries_of_faults_no_longer_configured_are_kept_and_can_be_cleared(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.apply(event(2, True), nothing)
    memory.commit()
    store.close()
    store = Store(path)
    memory = FaultMemory(catalogue((1,)), store)
    assert [e.fault for e in memory.entries()] == ["m.f2"]
    assert memory.clear(Dtc.parse("P0302-11").value) == ["m.f2"]
    assert memory.entries() == []
    store.close()


WRITER = """
import sys
sys.path[:0] = [{folder!r}]
from pathlib import Path
from fault_examples import AtOnce, catalogue, event, frame, nothing
from gateway.faults.memory import FaultMemory
from gateway.faults.store import Store
memory = FaultMemory(catalogue((1,) * 9), Store(Path({path!r})))
memory.start_cycle(0)
for k in range(10**9):
    memory.apply(event(k % 9, (k // 9) % 2 == 0, k), frame({{"x": float(k)}}))
    memory.commit()
    status = {{e.fault: (e.record.occurrence, e.record.last_ns) for e in memory.entries()}}
    print(k, status, flush=True)
"""


@pytest.mark.evidence("Durability: kill -9")
@pytest.mark.long
def test_kill_9_at_random_moments_loses_nothing_that_was_committed(tmp_path):
    rng = random.Random(41)
    print("seed 41")
    path = tmp_path / "f.sqlite"
    for _ in range(12):
        code = WRITER.format(path=str(path), folder=str(Path(__file__).parent))
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        lines = [process.stdout.readline()]
        timer = threading.Timer(rng.uniform(0, 0.15), os.kill, (process.pid, signal.SIGKILL))
        timer.start()
        lines += process.stdout.readlines()
        process.wait(20)
        last = next(line for line in reversed(lines) if line.endswith("\n"))
        said = eval(last.partition(" ")[2])  # our own output
        store = Store(path, write=False)
        kept = {r.id: (r.occurrence, r.last_ns) for r in store.load() if r.occurrence}
        store.close()
        for fault, (occurrence, last_ns) in said.items():
            assert kept[fault][0] >= occurrence
            assert kept[fault][1] >= last_ns or kept[fault][0] > occurrence
        writable = Store(path)
        FaultMemory(catalogue((1,) * 9), writable).clear()
        writable.close()


@pytest.mark.evidence("Durability: second writer")
def test_a_second_writer_is_refused_and_readers_are_not(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    with pytest.raises(InputError, match="another gateway keeps"):
        Store(path)
    assert service.list_entries(path) == []
    store.close()
    Store(path).close()


def test_foreign_damaged_and_later_files_are_refused_and_left_alone(tmp_path):
    cases = {}
    for name, content in (
        ("text", b"not a database, but longer than a header " * 9),
        ("short", b"x"),
    ):
        cases[name] = tmp_path / f"{name}.sqlite"
        cases[name].write_bytes(content)
    cases["foreign"] = tmp_path / "foreign.sqlite"
    db = sqlite3.connect(cases["foreign"])
    db.execute("CREATE TABLE t (x)")
    db.commit()
    db.close()
    cases["later"] = tmp_path / "later.sqlite"
    Store(cases["later"]).close()
    db = sqlite3.connect(cases["later"])
    db.execute("PRAGMA user_version = 99")
    db.commit()
    db.close()
    for name, path in cases.items():
        before = path.read_bytes()
        with pytest.raises(InputError, match=path.name):
            Store(path)
        with pytest.raises(InputError, match=path.name):
            service.list_entries(path)
        assert path.read_bytes() == before, name
    with pytest.raises(InputError, match="there is no fault memory here"):
        service.list_entries(tmp_path / "none.sqlite")
    with pytest.raises(InputError, match="there is no fault memory here"):
        service.clear(tmp_path / "none.sqlite")
    assert not (tmp_path / "none.sqlite").exists()


def test_clearing_without_a_daemon(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    for k in range(3):
        memory.apply(event(k, True), nothing)
    memory.commit()
    store.close()
    assert service.clear(path, "P0301-11") == 1
    assert [e["dtc"] for e in service.list_entries(path)] == ["P0300-11", "P0302-11"]
    assert service.clear(path) == 2
    assert service.list_entries(path) == []
    with pytest.raises(InputError, match="a DTC is a letter"):
        service.clear(path, "X1")


def test_clearing_beside_a_daemon_is_done_by_the_daemon(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    for k in range(3):
        memory.apply(event(k, True), nothing)
    memory.commit()
    answers = []
    client = threading.Thread(target=lambda: answers.append(service.clear(path, "P0301-11")))
    client.start()
    cleared = []
    limit = time.monotonic() + 120
    while client.is_alive() and time.monotonic() < limit:
        cleared += memory.serve_requests()
        time.sleep(0.005)
    client.join()
    assert cleared == ["m.f1"]
    assert answers == [1]
    assert int(memory.status("m.f1")) == 0x50
    assert [e.fault for e in memory.entries()] == ["m.f0", "m.f2"]
    with pytest.raises(GatewayError, match="does not answer"):
        service.clear(path, patience_s=0.1)
    assert memory.serve_requests() == [], "a request that was given up is not done later"
    store.close()


def test_show(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.apply(event(1, True, 77), frame({"s": 2.0}))
    memory.commit()
    store.close()
    entry = service.show(path, "p0301-11")
    assert entry["freeze_frames"] == [{"record": 1, "t_ns": 77, "signals": {"s": 2.0}}]
    with pytest.raises(InputError, match="the memory has P0301-11"):
        service.show(path, "P0300-11")


@pytest.mark.evidence("AUTOSAR DEM: occurrence counter")
def test_occurrences_stop_at_255():
    memory = AtOnce(catalogue((1,)), Store(None))
    for k in range(300):
        memory.apply(event(0, True, k), nothing)
        memory.apply(event(0, False, k), nothing)
    assert memory.entries()[0].record.occurrence == 255


def test_two_faults_with_one_dtc_are_refused():
    same = [FaultDefinition(f"a.{k}", Dtc.parse("P0300-00"), "") for k in range(2)]
    with pytest.raises(GatewayError, match=r"a\.0 has this DTC"):
        Catalogue(same)


@pytest.mark.evidence("Durability: commit")
def test_a_commit_reaches_the_disk(tmp_path):
    """Power loss cannot be tested here; the setting that guards against it can."""
    store = Store(tmp_path / "f.sqlite")
    assert store._db.execute("PRAGMA synchronous").fetchone() == (2,)
    assert store._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    store.close()


def test_codes_that_stand_for_none_or_all_dtcs_are_refused():
    for text in ("P0000-00", "U3FFF-FF"):
        with pytest.raises(GatewayError, match="stands for no DTC or for a group"):
            Catalogue([FaultDefinition("a.b", Dtc.parse(text), "")])
    with pytest.raises(GatewayError, match="two faults have this id"):
        Catalogue([FaultDefinition("a.b", Dtc.parse(f"P030{k}-00"), "") for k in range(2)])


def test_what_a_dead_client_asked_is_not_done_after_a_restart(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.apply(event(0, True), nothing)
    memory.commit()
    asking = Store(path, write=False)
    asking.request("clear", "16777215")
    asking.close()
    store.close()
    again = FaultMemory(catalogue(), Store(path))
    assert again.serve_requests() == []
    assert [entry.fault for entry in again.entries()] == ["m.f0"]


def test_a_reader_sees_records_and_freeze_frames_of_one_commit(tmp_path):
    """Record and freeze frame are written together; a reader between its two queries must not mix them."""
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.apply(event(0, True, 1), frame({"s": 1.0}))
    memory.commit()
    reader = Store(path, write=False)

    def fail_in_between(statement):
        if "freeze_frame" in statement and len(written) == 0:
            written.append(statement)
            memory.apply(event(1, True, 2), frame({"s": 2.0}))
            memory.commit()

    written = []
    reader._db.set_trace_callback(fail_in_between)
    seen = reader.load()
    assert written, "the writer committed between the reader's queries"
    assert [(r.id, len(r.freeze_frames)) for r in seen if r.occurrence] == [("m.f0", 1)]
    assert [r.id for r in reader.load() if r.occurrence] == ["m.f0", "m.f1"]
    reader.close()
    store.close()


def test_a_file_damaged_inside_is_one_clear_error(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = FaultMemory(catalogue(), store)
    memory.apply(event(0, True, 1), frame({"s": 1.0}))
    memory.commit()
    store.close()
    content = bytearray(path.read_bytes())
    for k in range(4096, len(content), 64):
        content[k : k + 32] = b"\xa5" * 32
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"f\.sqlite"):
        Store(path)
    with pytest.raises(InputError, match=r"f\.sqlite"):
        service.list_entries(path)
