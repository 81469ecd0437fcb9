"""Fault memories of each version, made by the code of then: they keep all they have, and what was changed shows.

How the files were made: tests/faults/versions/README.md.
"""

import gzip
import os
import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from amount import amount
from fault_examples import event, nothing
from stored_memories import kept, listed

import gateway
from gateway.faults import chain, service
from gateway.faults.schema import CHAINED, MIGRATIONS
from gateway.faults.store import Store
from gateway_fdi.errors import InputError

FILES = Path(__file__).with_name("versions")
VERSIONS = range(1, len(MIGRATIONS))


def placed(folder, version):
    """Return a copy of the file of a version."""
    path = folder / f"v{version}.sqlite"
    path.write_bytes(gzip.decompress((FILES / f"{version}.sqlite.gz").read_bytes()))
    return path


def change(path, statement):
    db = sqlite3.connect(path, isolation_level=None)
    db.execute(statement)
    db.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_file_of_each_version_is_brought_to_today_and_loses_nothing(tmp_path, version):
    path = placed(tmp_path, version)
    with pytest.raises(InputError, match=f"earlier gateway: version {version}"):
        service.verify(path)
    store, memory = kept(path)
    assert store.incidents() == []
    verdict = store.verify()
    assert verdict.broken == []
    assert verdict.counted["fault"] == 3
    assert [(e.fault, e.record.occurrence, e.record.first_ns) for e in memory.entries()] == [
        ("m.f0", 2 if version > 1 else 1, 1000), ("m.f1", 2, 1001),
    ]  # fmt: skip
    assert memory.entries()[1].freeze_frames[1].content == {"M.A": 1 / 3, "M.B": None}
    assert store.cycles()["power"].number == 3
    if version >= 2:
        assert store.identifiers() == {0xF190: b"WVWZZZ1JZXW000001"}
        assert [r.log for r in store.recordings()] == [b"log of two frames"]
        assert [p.fault for p in store.permanent()] == ["m.f0"]
    if version >= 5:
        assert [(i.action, i.count, i.request) for i in store.interventions()] == [("clear", 2, b"\x14\xff\xff\xff")]
    if version >= CHAINED:
        assert verdict.counted["clear"] == 1, "its own links are kept"
    memory.apply(event(1, False, 98), nothing)
    memory.apply(event(1, True, 99), nothing)
    memory.commit()
    store.close()
    assert service.verify(path)["whole"]
    again, _ = kept(path)
    assert again.incidents() == []
    again.close()
    assert listed(path)["m.f1"] == 3


@pytest.mark.parametrize("version", range(CHAINED, len(MIGRATIONS)))
@pytest.mark.parametrize(
    ("statement", "subject"),
    [
        ("UPDATE fault SET occurrence = occurrence + 1 WHERE id = 'm.f0'", "fault m.f0"),
        ("UPDATE fault SET near_misses = 7 WHERE id = 'm.f1'", "fault m.f1"),
        ("UPDATE freeze_frame SET t_ns = 0 WHERE fault = 'm.f1'", "fault m.f1"),
        ("DELETE FROM recording", "recordings m.f1"),
        ("UPDATE intervention SET address = 0", "intervention 1"),
        ("UPDATE link SET digest = x'00' WHERE number = 3", "link 3"),
    ],
)
def test_a_row_that_was_changed_before_the_file_became_one_of_today_shows(tmp_path, version, statement, subject):
    path = placed(tmp_path, version)
    change(path, statement)
    store, _ = kept(path)
    (incident,) = store.incidents()
    store.close()
    assert incident.kind == "damaged"
    assert subject in incident.reason
    assert service.verify(path)["whole"], "the next file is whole"


def test_what_a_digest_names_is_told_by_the_version_of_its_link(tmp_path):
    """The same rows have other digests only where a version has other columns."""
    path = placed(tmp_path, 8)
    store, _ = kept(path)
    store.close()
    db = sqlite3.connect(path)
    assert {version for (version,) in db.execute("SELECT DISTINCT version FROM link")} == {8}
    digest = chain.content(db, "fault", "m.f1", 8)
    assert digest == chain.content(db, "fault", "m.f1", 9)
    (said,) = db.execute("SELECT content FROM link WHERE subject = 'm.f1' AND kind = 'fault'").fetchone()
    assert said == digest
    db.close()
    change(path, "UPDATE link SET version = 9 WHERE number = 3")
    assert service.verify(path)["broken"][0]["link"] == 3
    change(path, "UPDATE link SET version = 'x' WHERE number = 3")
    assert service.verify(path)["broken"][0]["link"] == 3


#: A version of tomorrow: one more datum of an entry, and one of a tester's intervention.
LATER = """
_LATER = '''
ALTER TABLE fault ADD COLUMN latest_pass_ns INTEGER NOT NULL DEFAULT 5;
ALTER TABLE intervention ADD COLUMN seat TEXT NOT NULL DEFAULT 'none';
UPDATE fault SET latest_pass_ns = last_ns WHERE occurrence > 0;
'''
MIGRATIONS = (*MIGRATIONS, _LATER)
CHAINED"""


@pytest.fixture
def tomorrow(tmp_path):
    """Return a function that runs lines of Python with the gateway of a later version."""
    home, ours = tmp_path / "tomorrow", Path(gateway.__file__).parent
    (home / "gateway" / "faults").mkdir(parents=True)
    for file in [f for f in ours.iterdir() if f.name != "faults"]:
        (home / "gateway" / file.name).symlink_to(file)
    for file in (ours / "faults").glob("*.py"):
        text = file.read_text()
        if file.name == "schema.py":
            text = re.sub(r"^CHAINED", LATER, text, flags=re.MULTILINE)
        elif file.name == "records.py":
            text = text.replace(
                "    aged_cycles: int = 0\n", "    aged_cycles: int = 0\n    latest_pass_ns: int = 5\n", 1
            )
        elif file.name == "interventions.py":
            text = text.replace("    count: int = 1\n", "    seat: str = 'none'\n    count: int = 1\n", 1)
        (home / "gateway" / "faults" / file.name).write_text(text)

    def run(code):
        path = os.pathsep.join([str(home), *filter(None, sys.path)])
        done = subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True,
            timeout=300, check=False, cwd=home,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return run


OPEN = """
import sys
from pathlib import Path
import gateway.faults.records
from gateway.faults import service
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.records import Changes
path = Path({path!r})
store = ResilientStore(path)
record = store.load()[{which}]
print([m.reason for m in store.incidents()], hasattr(record, "latest_pass_ns"))
if {write}:
    record.latest_pass_ns += 1
    store.save(Changes(records=[record]))
store.close()
print(service.verify(path)["broken"])
"""


@pytest.mark.long
@pytest.mark.parametrize("version", [8, 6][: amount(2, 1)])
def test_a_column_more_leaves_files_of_before_whole(tmp_path, tomorrow, version):
    """It made each file NOT WHOLE: digests were of the columns that the program has, not those that were written."""
    path = placed(tmp_path, version)
    if version == 8:
        store, memory = kept(path)
        memory.start_cycle(10)
        store.close()
    assert tomorrow(OPEN.format(path=str(path), which=0, write=False)) == "[] True\n[]"
    assert tomorrow(OPEN.format(path=str(path), which=0, write=True)) == "[] True\n[]", "and is in later digests"
    change(path, "UPDATE fault SET latest_pass_ns = 1 WHERE id = 'm.f0'")
    assert "fault m.f0" in tomorrow(OPEN.format(path=str(path), which=0, write=False))
    change(path, "UPDATE fault SET occurrence = occurrence + 1 WHERE id = 'm.f1'")
    assert "fault m.f1" in tomorrow(OPEN.format(path=str(path), which=0, write=False))
    with pytest.raises(InputError, match="later gateway"):
        Store(path)
