"""Two hundred damages to a memory's files after a death: each is told, or changes nothing that the memory says.

``GATEWAY_TESTS=full`` makes all of them and prints the table (``GATEWAY_SEED`` draws the places); CI a part of them.
"""

import os
import random
import shutil
from collections import Counter

import pytest
from amount import FULL, amount
from fault_examples import catalogue
from journalled import Telling
from stored_memories import fill
from typer.testing import CliRunner

from gateway.cli import app
from gateway.faults.memory import FaultMemory
from gateway.faults.records import Recording
from gateway.faults.resilient_store import ResilientStore
from gateway_fdi.errors import GatewayError

FILES = ("", "-wal", "-shm", "-verdicts", "-lock")
SEED = int(os.environ.get("GATEWAY_SEED", "1"))


class Images:
    """Files of a memory that was killed, of an earlier time of it, and of another memory."""

    def __init__(self, folder):
        self.now, self.before, self.other = (folder / name for name in ("now", "before", "other"))
        for name, seed in (("m", 1), ("o", 2)):
            path = folder / f"{name}.sqlite"
            fill(path)
            telling = Telling(path, catalogue((1, 1, 1)))
            telling.memory.start_cycle(5)
            telling.store.tend_log()
            rng = random.Random(seed)
            for step in range(12):
                telling.verdicts((rng.randrange(3), step % 2 == 0))
                telling.memory.ledger.add_recordings([Recording("m.f1", step, 1, 0, rng.randbytes(3000))])
                telling.commit()
                if step == 6 and name == "m":
                    self._copy(path, self.before)
                if step == 8:
                    telling.store.tend_log()
            if name == "m":
                telling.memory.clear(0x030111)
            self._copy(path, self.now if name == "m" else self.other)
            telling.close()
            telling.bus.close()

    @staticmethod
    def _copy(path, folder):
        folder.mkdir()
        for suffix in FILES:
            shutil.copyfile(f"{path}{suffix}", folder / f"f.sqlite{suffix}")


def content(path):
    """Return all that the memory says, as its next writer reads it."""
    store = ResilientStore(path, displacing=True)
    try:
        memory = FaultMemory(catalogue((1, 1, 1)), store)
        told = [incident.kind for incident in store.incidents()]
        if memory.recovered.faults:
            told.append("recovered")
        if store.detached:
            told.append("cannot be opened")
        said = (
            [(e.fault, e.record.occurrence, int(e.status), e.freeze_frames) for e in memory.entries()],
            store.recordings(), store.cycles(), store.identifiers(), store.facts(), store.interventions(),
        )  # fmt: skip
        return told, said
    finally:
        store.close()


def damages(images, rng):
    """Yield (name, function that damages the files in a folder)."""
    for suffix in FILES:
        name = suffix or "memory"
        size = (images.now / f"f.sqlite{suffix}").stat().st_size

        def edit(change, suffix=suffix):
            def do(folder):
                file = folder / f"f.sqlite{suffix}"
                told = bytearray(file.read_bytes())
                change(told)
                file.write_bytes(told)

            return do

        yield f"{name}: removed", lambda folder, suffix=suffix: (folder / f"f.sqlite{suffix}").unlink()
        yield f"{name}: emptied", edit(lambda told: told.clear())
        for where in ("older", "another memory's"):
            source = (images.before if where == "older" else images.other) / f"f.sqlite{suffix}"
            target = f"f.sqlite{suffix}"
            yield f"{name}: {where}", lambda f, source=source, target=target: shutil.copyfile(source, f / target)
        yield f"{name}: text", edit(lambda told: told.__setitem__(slice(None), b"nothing of the kind\n" * 300))
        yield f"{name}: zeros", edit(lambda told: told.__setitem__(slice(None), bytes(len(told))))
        yield f"{name}: longer", edit(lambda told: told.extend(rng.randbytes(5000)))
        for _ in range(8):
            at = rng.randrange(max(size, 1))
            yield f"{name}: cut at {at}", edit(lambda told, at=at: told.__delitem__(slice(at, None)))
        early = min(size, 40_000)  # the log has zeros behind
        for _ in range(12):
            at, bit = rng.randrange(max(early, 1)), 1 << rng.randrange(8)
            yield f"{name}: bit {bit} of byte {at}", edit(lambda told, at=at, bit=bit: _flip(told, at, bit))
        for _ in range(6):
            at = rng.randrange(max(early // 512, 1)) * 512
            yield f"{name}: sector at {at} torn", edit(lambda told, at=at: _put(told, at + 200, bytes(312)))
        for _ in range(4):
            if size > 3 * 4096:
                one, two = sorted(rng.sample(range(early // 4120), 2))
                yield (
                    f"{name}: pages {one} and {two} swapped",
                    edit(lambda told, one=one, two=two, log=suffix == "-wal": _swap(told, one, two, log=log)),
                )
        yield f"{name}: a folder", lambda folder, suffix=suffix: _to_folder(folder / f"f.sqlite{suffix}")
        yield f"{name}: a link to another", lambda folder, suffix=suffix: _to_link(folder, suffix, images.other)
    yield (
        "log and index: removed",
        lambda folder: [(folder / f"f.sqlite{suffix}").unlink() for suffix in ("-wal", "-shm")],
    )
    yield (
        "log, index and lock: removed",
        lambda folder: [(folder / f"f.sqlite{suffix}").unlink() for suffix in ("-wal", "-shm", "-lock")],
    )
    yield (
        "log, index and journal: removed",
        lambda folder: [(folder / f"f.sqlite{suffix}").unlink() for suffix in ("-wal", "-shm", "-verdicts")],
    )
    yield (
        "memory, log and index: older",
        lambda folder: [
            shutil.copyfile(images.before / f"f.sqlite{suffix}", folder / f"f.sqlite{suffix}")
            for suffix in ("", "-wal", "-shm")
        ],
    )
    yield (
        "memory, log, index and journal: older",
        lambda folder: [
            shutil.copyfile(images.before / f"f.sqlite{suffix}", folder / f"f.sqlite{suffix}") for suffix in FILES[:4]
        ],
    )
    yield (
        "memory, log, index and lock: older",
        lambda folder: [
            shutil.copyfile(images.before / f"f.sqlite{suffix}", folder / f"f.sqlite{suffix}")
            for suffix in ("", "-wal", "-shm", "-lock")
        ],
    )


def _flip(told, at, bit):
    if at < len(told):
        told[at] ^= bit


def _put(told, at, data):
    told[at : at + len(data)] = data[: max(len(told) - at, 0)]


def _swap(told, one, two, *, log):
    head, page = (32, 4120) if log else (0, 4096)
    first, second = (slice(head + k * page, head + (k + 1) * page) for k in (one, two))
    told[first], told[second] = told[second], told[first]


def _to_folder(file):
    file.unlink()
    file.mkdir()


def _to_link(folder, suffix, other):
    file = folder / f"f.sqlite{suffix}"
    file.unlink()
    shutil.copyfile(other / f"f.sqlite{suffix}", folder / "elsewhere")
    file.symlink_to(folder / "elsewhere")


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return Images(tmp_path_factory.mktemp("images"))


@pytest.mark.long
def test_each_damage_is_told_or_changes_nothing(images, tmp_path):
    rng = random.Random(SEED)
    print("seed", SEED)
    made = list(damages(images, rng))
    assert len(made) >= 190
    chosen = made if FULL else [each for each in made if rng.random() < amount(1.0, 0.12)]
    shutil.copytree(images.now, tmp_path / "right")
    told, right = content(tmp_path / "right" / "f.sqlite")
    assert told == []
    table, silent = Counter(), []
    for k, (name, damage) in enumerate(chosen):
        folder = tmp_path / str(k)
        shutil.copytree(images.now, folder)
        damage(folder)
        asked = folder.with_name(f"{k} asked")
        shutil.copytree(folder, asked, symlinks=True)
        code = CliRunner().invoke(app, ["faults", "verify", "--memory", str(asked / "f.sqlite")])
        refused = code.exit_code in (1, 2) or isinstance(code.exception, GatewayError)
        try:
            told, said = content(folder / "f.sqlite")
        except GatewayError as error:
            told, said = [f"refused: {type(error).__name__}"], None
        what = ", ".join(told) or ("said by verify" if refused else "" if said != right else "harmless")
        table[what or "SILENT"] += 1
        if not what:
            silent.append(name)
        if FULL:
            print(f"{name:45} verify {code.exit_code}, {what or 'SILENT'}")
        shutil.rmtree(folder)
        shutil.rmtree(asked)
    print(f"{len(chosen)} of {len(made)} damages: {dict(table)}")
    assert silent == []
