"""Vector's BLF: objects in containers that zlib has packed.

A file header (``LOGG``, 144 bytes), then objects (``LOBJ``), each with a header of 16 bytes: length of the whole
header, its version, length of the object, type. Objects of type 10 are containers; unpacked, joined, they are the
objects of the log, which may begin in one container and end in the next. Objects that lie outside of containers are
taken, too. Objects of errors and of the controller's state become error frames; others are counted. Where an object is
damaged, reading goes on with the next one. Vector publishes no description; this follows
python-can's reader (https://github.com/hardbyte/python-can, can/io/blf.py), which follows T. Lorenz's library.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gateway.bus import conditions
from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE
from gateway.bus.log_source import OBJECT as MOST
from gateway.bus.log_source import CutOffError, compression_of, damage, pull
from gateway.bus.readers.batch import Batch, FormatReader, Names, Read, wall_ns
from gateway.bus.readers.scan import begin_frame, byte, set_length
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: signature, bytes of it, 8 of versions, bytes of the file, unpacked, objects, read, begin and end as SYSTEMTIME.
FILE_HEADER = struct.Struct("<4sL8BQQLL8H8H")
#: Bytes of a finished file's header; the size of the file that it names until the recorder has finished it.
FILE_HEADER_SIZE = 144
#: signature, bytes of the header, its version, bytes of the object, its type.
OBJECT = struct.Struct("<4sHHLL")
#: how it is packed, bytes unpacked.
CONTAINER = struct.Struct("<H6xL4x")
PLAIN, ZLIB = 0, 2
#: Types of objects.
LOG_CONTAINER, CAN_MESSAGE, CAN_ERROR_EXT, CAN_MESSAGE2, CAN_FD_MESSAGE, CAN_FD_MESSAGE_64 = 10, 1, 73, 86, 100, 101
#: Error frames without details; states of the controller, with its error counters.
CAN_ERROR, CAN_FD_ERROR_64, DRIVER_ERROR, DRIVER_ERROR_EXT = 2, 104, 31, 74
#: Types of objects that are counted one by one.
_TYPES = 256

#: Why a kernel stops: it needs more bytes, the batch is full, no object where one should be, a payload above 64 bytes.
MORE, FULL, LOST, LONG = 0, 1, 2, 3
#: Bytes unpacked that are read at a time: several containers.
_BLOCK = 1 << 20
#: Bytes that are searched at a time for the next object.
_SEARCHED = 1 << 16


@kernel
def half(raw: Any, at: int) -> int:
    """Return the 16-bit number at a place."""
    return byte(raw, at) | (byte(raw, at + 1) << 8)


@kernel
def fd_flags(bits: int) -> int:
    """Return the flags of three bits: CAN FD, and if so its bit-rate switch and error state indicator."""
    return bits & (FD | BRS | ESI) if bits & FD else 0


@kernel
def put_state(raw: Any, at: int, words: Any, row: Any, k: int, t_ns: int) -> None:
    """Make an error frame of the controller's error counters, as the kernel does (CAN 2.0 B, 8)."""
    transmit, receive = byte(raw, at), byte(raw, at + 1)
    begin_frame(words, k, t_ns, ERROR | conditions.CONTROLLER, 0)
    set_length(words, k, 8)
    state = (conditions.TX_PASSIVE if transmit > 127 else 0) | (conditions.RX_PASSIVE if receive > 127 else 0)
    if state == 0:
        state = (conditions.TX_WARNING if transmit > 95 else 0) | (conditions.RX_WARNING if receive > 95 else 0)
    row[17], row[22], row[23] = state or conditions.ACTIVE, transmit, receive


@kernel
def long(raw: Any, at: int) -> int:
    """Return the 32-bit number at a place."""
    return half(raw, at) | (half(raw, at + 2) << 16)


@kernel
def put_frame(
    raw: Any, at: int, name: int, flags: int, dlc: int, count: int, length: int, words: Any, row: Any, k: int, t_ns: int
) -> None:
    """Make a frame of an identifier with its flags; of its ``length`` bytes ``count`` are there, others are zero."""
    begin_frame(words, k, t_ns, (name & ID_MASK) | (name & (EXTENDED | REMOTE | ERROR)), flags)
    if name & REMOTE:
        set_length(words, k, min(dlc, 8))
        return
    for j in range(count):
        row[16 + j] = raw[at + j]
    set_length(words, k, length)


@kernel
def blf_object(raw: Any, at: int, kind: int, size: int, header: int, t_ns: int, words: Any, row: Any, k: int) -> int:
    """Read the ``size`` bytes after an object's header, from ``at`` on, into frame ``k``, whose bytes are ``row``.

    ``header`` is bytes from the object's begin to where its header says that it ends.

    Returns:
        its channel, counted from 1; -1: no frame; -2: a payload above 64 bytes.
    """
    name = long(raw, at + 4) & ~(REMOTE | ERROR) if size >= 8 else 0
    fd = kind == CAN_FD_MESSAGE
    if (fd and size >= 84) or (kind in (CAN_MESSAGE, CAN_MESSAGE2) and size >= 16):
        bits, dlc = byte(raw, at + 2), byte(raw, at + 3)
        flags = (OWN if bits & 1 else 0) | (fd_flags(byte(raw, at + 13)) if fd else 0)
        name |= REMOTE if bits & 0x80 else 0
        count = min(byte(raw, at + 14), 64) if fd else min(dlc, 8)
        put_frame(raw, at + (20 if fd else 8), name, flags, dlc, count, count, words, row, k, t_ns)
        return half(raw, at)
    if kind == CAN_ERROR_EXT and size >= 32:
        name, count = long(raw, at + 16) & ~(REMOTE | ERROR), min(byte(raw, at + 10), 8)
        if not (long(raw, at + 4) | byte(raw, at + 8)) and (name & ID_MASK or count):  # of SocketCAN, by python-can
            put_frame(raw, at + 24, name | ERROR, 0, 0, count, count, words, row, k, t_ns)
            return half(raw, at)
    least = 4 if kind == CAN_ERROR else 32 if kind == CAN_ERROR_EXT else 16
    if kind in (CAN_ERROR, CAN_FD_ERROR_64, CAN_ERROR_EXT) and size >= least:
        begin_frame(words, k, t_ns, ERROR | conditions.PROTOCOL | conditions.BUS_ERROR, 0)  # of a real controller
        set_length(words, k, 8)
        return byte(raw, at) if kind == CAN_FD_ERROR_64 else half(raw, at)
    if kind in (DRIVER_ERROR, DRIVER_ERROR_EXT) and size >= 8:
        put_state(raw, at + 2, words, row, k, t_ns)
        return half(raw, at)
    if kind == CAN_FD_MESSAGE_64 and size >= 40:
        bits, valid = long(raw, at + 12), byte(raw, at + 2)
        if valid > 64:
            return -2
        flags = fd_flags(bits >> 12) | (OWN if raw[at + 34] else 0)
        name |= REMOTE if bits & 0x10 else 0
        other = byte(raw, at + 35)  # where data of another kind begin, counted from the object's begin
        count = max(0, min(valid, other - header - 40 if other else size - 40, size - 40))
        put_frame(raw, at + 40, name, flags, byte(raw, at + 1), count, valid, words, row, k, t_ns)
        return byte(raw, at)
    return -1


@kernel
def scan_blf(
    raw: Any, at: int, words: Any, data: Any, channel: Any, k: int, start: int, others: Any
) -> tuple[int, int, int]:
    """Read objects into a batch, which is that of :attr:`gateway.bus.readers.batch.Batch.room`.

    Args of its own: ``raw``: unpacked bytes, uint8. ``start`` of the log [ns]. ``others``: int64, takes the number of
    objects of each type that are no frames; the last is of all higher types.

    Returns:
        where the next object begins, frames that are in, why it stops.
    """
    end = raw.shape[0]
    while True:
        if k == words.shape[0]:
            return at, k, FULL
        skipped = 0  # padding
        while skipped <= 4 and at + skipped + 4 <= end and long(raw, at + skipped) != 0x4A424F4C:  # LOBJ
            skipped += 1
        if skipped > 4:
            return at, k, LOST
        begin = at + skipped
        if begin + 16 > end:
            return at, k, MORE
        header, version = half(raw, begin + 4), half(raw, begin + 6)
        size, kind = long(raw, begin + 8), long(raw, begin + 12)
        if size < 16:
            return at, k, LOST
        if begin + size > end:
            return at, k, MORE
        at = begin + size
        base = 32 if version == 1 else 40
        if version not in (1, 2) or size < base:
            others[min(kind, others.shape[0] - 1)] += 1
            continue
        stamp = long(raw, begin + 24) | (long(raw, begin + 28) << 32)
        unit = 10_000 if long(raw, begin + 16) == 1 else 1
        if stamp < 0 or stamp > 4 * 10**18 // unit:
            return begin, k, LOST
        found = blf_object(raw, begin + base, kind, size - base, header, start + stamp * unit, words, data[k], k)
        if found == -2:
            return begin, k, LONG
        if found >= 0:
            channel[k] = found - 1
            k += 1
        else:
            others[min(kind, others.shape[0] - 1)] += 1


class Blf(FormatReader):
    """Reads BLF (see :class:`gateway.bus.readers.batch.Reader`)."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._held = b""  # pulled, but not yet looked at
        self._size, self._objects = 0, 0
        self._end: Exception | None = None  # what ends the log early

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether a log begins as a BLF does."""
        return first.startswith(b"LOGG")

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames."""
        start, others = self._header(stream), np.zeros(_TYPES, np.int64)
        batch, block, frames, lost = Batch(chunk), b"", 0, False
        for part, gap in self._parts(stream):
            block = part if gap else block + part
            at, why = 0, LOST if lost and not gap else FULL
            while why != MORE:
                if lost := why in (LOST, LONG):
                    found = block.find(b"LOBJ", at)
                    if found < 0:
                        at = max(len(block) - 3, at)
                        break
                    at = found
                at, batch.count, why = scan_blf(np.frombuffer(block, np.uint8), at, *batch.room, start, others)
                if why in (LOST, LONG):
                    what = "no object where one should be" if why == LOST else "a payload above 64 bytes"
                    self.passed_over.add(what, f"after frame {frames + batch.count}")
                    at += 1
                if batch.count == batch.size:
                    frames += batch.count
                    yield batch.take(names)
            block = block[at:]
            if len(block) > MOST:
                self._end = ValueError(f"an object that is longer than {MOST} bytes")
                break
        if batch.count:
            frames += batch.count
            yield batch.take(names)
        for kind in np.flatnonzero(others).tolist():
            text = f"objects of type {kind}, which are no frames"
            self.passed_over.add(text, "not kept", count=int(others[kind]), damaged=False)
        if wrong := self._wrong(frames):
            raise wrong

    def _header(self, stream: BinaryIO) -> int:
        """Read the file's header; returns the time of the log's start [ns]."""
        head, broken = pull(stream, FILE_HEADER.size)
        if broken is not None:
            raise damage(broken, self._path, 0)
        if len(head) < FILE_HEADER.size:
            raise CutOffError("cut off in its header", file=self._path)
        fields = FILE_HEADER.unpack(head)
        if fields[0] != b"LOGG":
            raise InputError("not a BLF log: it does not begin with LOGG", file=self._path)
        self._size, self._objects = fields[10], fields[12]
        self._need(stream, fields[1] - FILE_HEADER.size)
        year, month, _, *rest, milli = fields[14:22]
        return wall_ns(self.zone, min(milli, 999) * 10**6, year, month, *rest)

    def _need(self, stream: BinaryIO, count: int) -> bytes:
        """Return this number of bytes, or less: then the file ends within, or unpacking failed there."""
        data, self._end = self._pull(stream, count)
        if len(data) < count:
            self._end = self._end or CutOffError("", file=self._path)
        return data

    def _pull(self, stream: BinaryIO, size: int) -> tuple[bytes, Exception | None]:
        """Return this number of bytes, less at the end, first of those that were pulled already."""
        held, self._held = self._held[:size], self._held[size:]
        data, broken = pull(stream, size - len(held))
        return held + data, broken

    def _parts(self, stream: BinaryIO) -> Iterator[tuple[bytes, bool]]:
        """Yield the log's objects, unpacked, some at a time, and whether something is lost before them."""
        part, lost, gap = bytearray(), False, False
        while self._end is None:
            if len(part) >= _BLOCK or (lost and part):
                yield bytes(part), gap
                part.clear()
                gap = False
            gap = gap or lost
            head, self._end = self._pull(stream, OBJECT.size)
            if len(head) < OBJECT.size:
                if head and not lost:
                    self._end = self._end or CutOffError("", file=self._path)
                break
            mark, _, _, size, kind = OBJECT.unpack(head)
            if mark != b"LOBJ" or size < OBJECT.size:
                if not lost:
                    self.passed_over.add("no object where one should be", "between containers")
                lost = True
                more, self._end = self._pull(stream, _SEARCHED)
                whole = head[1:] + more
                found = whole.find(b"LOBJ")
                self._held = whole[found:] if found >= 0 else whole[-3:] if more else b""
                continue
            lost = False
            if size > MOST:
                self._end = ValueError(f"an object that is longer than {MOST} bytes")
                break
            body = self._need(stream, size - OBJECT.size)
            if self._end is None:
                self._pull(stream, size % 4)  # padding, of which some may be missing at the end
            try:
                part += self._contents(head, body, kind)
            except ValueError as error:
                self._end = self._end or error
            except zlib.error as error:
                if self._end is None:
                    self.passed_over.add("a container that cannot be unpacked", str(error))
                    lost = True
        if part:
            yield bytes(part), gap

    def _contents(self, head: bytes, body: bytes, kind: int) -> bytes:
        """Return the objects in an object of the file: a container, or itself.

        Raises:
            zlib.error: it cannot be unpacked.
            ValueError: it unpacks to too much.
        """
        if kind != LOG_CONTAINER:
            return head + body
        if len(body) < CONTAINER.size:
            return b""
        method, _ = CONTAINER.unpack_from(body)
        packed = memoryview(body)[CONTAINER.size :]
        if method == PLAIN:
            return bytes(packed)
        if method == ZLIB:
            part = zlib.decompressobj().decompress(packed, MOST + 1)
            if len(part) > MOST:
                raise ValueError(f"a container that unpacks to more than {MOST} bytes")
            return part
        self.passed_over.add("a container that is packed in an unknown way", f"method {method}")
        return b""

    def _wrong(self, frames: int) -> InputError | None:
        """Return what ended the log early, or how it is cut off by its header; None: it is whole."""
        if self._end is not None and not isinstance(self._end, CutOffError):
            return damage(self._end, self._path, frames)
        size, text = self._path.stat().st_size, ""
        if not compression_of(self._path) and self._size > size:
            text = f": {size} bytes of {self._size}"
        elif frames and not self._objects and self._size <= FILE_HEADER_SIZE:
            text = ": its recorder did not finish the file"
        elif self._end is None:
            return None
        return CutOffError(f"cut off after frame {frames}{text}", file=self._path)
