"""Power cuts, rebuilt from a trace of what a process wrote: what was not synchronised is kept, lost, half there, torn.

The model is that of a disk with a file system that journals its metadata (ext4, XFS): what :func:`fsync` has returned
for is there; of later writes each sector is there or not; creations, renamings and removals are there up to some place.
"""

import random
import struct
from dataclasses import dataclass, field
from pathlib import Path

_HEAD = struct.Struct("<B3xIqq")
SECTOR = 512
#: What is left of what was not synchronised.
KEPT, LOST, HALF, TORN = "kept", "lost", "half", "torn"


@dataclass
class Op:
    what: str
    name: str
    at: int
    data: bytes


def read_trace(path):
    """Return the operations of a trace."""
    content, at, found = path.read_bytes(), 0, []
    while at < len(content):
        what, name, place, length = _HEAD.unpack_from(content, at)
        at += _HEAD.size
        told = content[at : at + name].decode()
        at += name
        size = length if chr(what) in "WR" else 0
        found.append(Op(chr(what), told, place, content[at : at + size]))
        at += size
    return found


def _put(content, at, data):
    if len(content) < at:
        content.extend(bytes(at - len(content)))
    content[at : at + len(data)] = data


def _do(content, op):
    if op.what == "W":
        _put(content, op.at, op.data)
    elif len(content) > op.at:
        del content[op.at :]
    else:
        content.extend(bytes(op.at - len(content)))


@dataclass
class Disk:
    """What is on the disk, and what waits to get there.

    Attributes:
        files: contents that are there, by number of a file.
        pending: writes and truncations that wait, likewise.
        names: (name, file or None: it was removed), in order; the first ``sure`` are there.
    """

    files: dict = field(default_factory=dict)
    pending: dict = field(default_factory=dict)
    names: list = field(default_factory=list)
    now: dict = field(default_factory=dict)
    sure: int = 0

    def take(self, op):
        """Go on by an operation."""
        if op.what == "C":
            number = len(self.files)
            self.files[number], self.pending[number] = bytearray(), []
            self._name(op.name, number)
        elif op.what == "U":
            self._name(op.name, None)
        elif op.what == "R":
            self._name(op.data.decode(), self.now[op.name])
            self._name(op.name, None)
        elif op.what == "D":
            self.sure = len(self.names)
        elif (number := self.now.get(op.name)) is not None:
            self.pending[number].append(op)
            if op.what == "S":
                self.pending[number].pop()
                for each in self.pending[number]:
                    _do(self.files[number], each)
                self.pending[number] = []
                created = max((k + 1 for k, (_, f) in enumerate(self.names) if f == number), default=0)
                self.sure = max(self.sure, created)

    def _name(self, name, number):
        self.names.append((name, number))
        self.now[name] = number

    def image(self, left, rng):
        """Return the files that are there after the power is back: name -> content."""
        names = len(self.names)
        if left == LOST:
            names = self.sure
        elif left != KEPT:
            names = rng.randint(self.sure, names)
        there = dict(self.names[:names])
        return {name: self._content(number, left, rng) for name, number in there.items() if number is not None}

    def _content(self, number, left, rng):
        content = bytearray(self.files[number])
        if left == LOST:
            return content
        for op in self.pending[number]:
            if left == KEPT:
                _do(content, op)
            elif op.what == "T":
                if rng.random() < 0.5:
                    _do(content, op)
            else:
                self._some_sectors(content, op, left, rng)
        return content

    @staticmethod
    def _some_sectors(content, op, left, rng):
        at, end = op.at, op.at + len(op.data)
        while at < end:
            stop = min((at // SECTOR + 1) * SECTOR, end)
            if rng.random() < 0.5:
                cut = rng.randint(at, stop) if left == TORN and rng.random() < 0.3 else stop
                _put(content, at, op.data[at - op.at : cut - op.at])
            at = stop


def place(files, folder):
    """Write an image into a new folder, without the index of the log, which is no file of the disk's."""
    folder.mkdir(parents=True)
    for name, content in files.items():
        if not name.endswith("-shm") and name != "lines":
            Path(folder, name).write_bytes(content)
    return folder / "f.sqlite"


def cuts(ops, seed, share=1.0):
    """Yield (place in the trace, disk) before each synchronisation, and at random between; ``share`` of them."""
    rng, disk = random.Random(seed), Disk()
    for k, op in enumerate(ops):
        wanted = op.what in "SD" or (op.name != "lines" and rng.random() < 0.1)
        if wanted and rng.random() < share:
            yield k, disk
        disk.take(op)
    yield len(ops), disk
