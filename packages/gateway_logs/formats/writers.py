"""Writers of logs in other tools' formats, which their readers give back frame by frame.

Each keeps nanoseconds, remote frames with their DLC, and the classes and data of error frames, which python-can's
writers lose. Where a format has no place for classes, they stand behind what it has, as ``SocketCAN``. Properties that
a format cannot hold at all are counted; none of these keeps names of buses.
"""

from __future__ import annotations

import struct
import zlib
from abc import ABC, abstractmethod
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.conditions import BUS_OFF, CHIP_STATES, CONTROLLER, exact
from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, ID_MASK, OWN, REMOTE, Frames
from gateway_logs.formats import blf, mf4, trc

#: Bytes of a container of BLF, unpacked.
_CONTAINER = 1 << 17
#: Flags of a frame of TRC 2.1 -> its type.
_TYPES = {flags: name for name, flags in trc.TYPES.items()}


class _Dated:
    """A log whose stamps count from its begin, a whole second; what comes before it cannot be held."""

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self.begin_ns: int | None = None

    def since(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return times since the begin, which the first one sets [ns]."""
        if self.begin_ns is None:
            self.begin_ns = int(t_ns[0]) // 10**9 * 10**9
        since = t_ns - self.begin_ns
        early = int((since < 0).sum())
        if early:
            self.lost["a stamp before the log's begin"] += early
        return np.maximum(since, 0)

    @property
    def begin(self) -> datetime:
        """The begin, in UTC."""
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=(self.begin_ns or 0) // 1000)


class _TextWriter(_Dated, ABC):
    """Writes lines, flushed after each batch."""

    end = ""

    def __init__(self, path: Path, _names: Mapping[int, str] | None = None) -> None:
        super().__init__()
        self._file = path.open("w", encoding="ascii", newline="")
        self._count = 0

    @abstractmethod
    def _head(self) -> str:
        """Return the lines before the first frame."""

    @abstractmethod
    def _line(self, t_ns: int, can_id: int, flags: int, bus: int, data: bytes) -> str:
        """Return the line of a frame; ``data`` of a remote frame are its DLC in zeros."""

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        if not len(frames):
            return
        begun = self.begin_ns is not None
        since = self.since(frames["t_ns"]).tolist()
        lines = [] if begun else [self._head()]
        for t_ns, frame in zip(since, frames, strict=True):
            data = frame["data"][: int(frame["length"])].tobytes()
            self._count += 1
            lines.append(self._line(t_ns, int(frame["can_id"]), int(frame["flags"]), int(frame["bus"]), data))
        self._file.write("".join(lines))
        self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        if self.begin_ns is None:
            self._file.write(self._head())
        self._file.write(self.end)
        self._file.close()


def _state(can_id: int, data: bytes) -> str:
    """Return the chip status of an error frame as ASC has it, "" if it tells none."""
    if can_id & BUS_OFF:
        return "bus off"
    said = data[1] if can_id & CONTROLLER and len(data) > 1 else 0
    return next((name for name, (_, sent, heard) in CHIP_STATES.items() if said & (sent | heard)), "")


class AscWriter(_TextWriter):
    """Writes ASC."""

    end = "End TriggerBlock\n"

    def _head(self) -> str:
        weekday, month, day, clock, year = self.begin.ctime().split()
        date = f"{weekday} {month} {day:>02} {clock}.000 {year}"
        return f"date {date}\nbase hex  timestamps absolute\ninternal events logged\nBegin Triggerblock {date}\n"

    def _line(self, t_ns: int, can_id: int, flags: int, bus: int, data: bytes) -> str:
        stamp, channel = f"{t_ns // 10**9:4d}.{t_ns % 10**9:09d}", bus + 1
        if can_id & ERROR:
            status = _state(can_id, data)
            event = f"CAN {channel} Status:chip status {status}" if status else f"{channel}  ErrorFrame"
            return f"{stamp} {event}  {exact(can_id, data)}\n"
        name = f"{can_id & ID_MASK:X}{'x' if can_id & EXTENDED else ''}"
        way, text = "Tx" if flags & OWN else "Rx", data.hex(" ").upper()
        if not flags & FD:
            body = f"r {len(data):x}" if can_id & REMOTE else f"d {len(data):x} {text}"
            return f"{stamp} {channel}  {name:<15} {way:<4} {body}\n"
        brs, esi = flags & BRS != 0, flags & ESI != 0
        bits = 0x1000 | brs << 13 | esi << 14
        dlc = FD_LENGTHS.index(len(data))
        return (
            f"{stamp} CANFD {channel:3d} {way:<4} {name:>8}  {'':>32} {brs:d} {esi:d} {dlc:x} {len(data):2d} {text}"
            f" {0:8d} {0:4d} {bits:8X} {0:8d} {0:8d} {0:8d} {0:8d} {0:8d}\n"
        )


class TrcWriter(_TextWriter):
    """Writes TRC 2.1."""

    def _head(self) -> str:
        days = (self.begin_ns or 0) / 86400e9 + trc.EPOCH_DAYS
        columns = "N,O,T,B,I,d,R,L,D"
        return f";$FILEVERSION=2.1\r\n;$STARTTIME={days:.12f}\r\n;$COLUMNS={columns}\r\n;\r\n"

    def _line(self, t_ns: int, can_id: int, flags: int, bus: int, data: bytes) -> str:
        begin = f"{self._count:7d} {t_ns // 10**6:9d}.{t_ns % 10**6:06d}"
        if can_id & ERROR:
            return f"{begin} ER {bus + 1:<2d} {'-':>8} Rx -  5    04 00 00 00 00  {exact(can_id, data)}\r\n"
        kind = _TYPES[flags & (FD | BRS | ESI) if flags & FD else trc.RTR if can_id & REMOTE else 0]
        name = f"{can_id & ID_MASK:0{8 if can_id & EXTENDED else 4}X}"
        text = "" if can_id & REMOTE else data.hex(" ").upper()
        way = "Tx" if flags & OWN else "Rx"
        return f"{begin} {kind} {bus + 1:<2d} {name:>8} {way} -  {FD_LENGTHS.index(len(data)):<4d} {text}\r\n"


class CsvWriter(_TextWriter):
    """Writes python-can's CSV, which has no channel, no direction, and no flags of CAN FD."""

    def _head(self) -> str:
        return "timestamp,arbitration_id,extended,remote,error,dlc,data\r\n"

    def _line(self, t_ns: int, can_id: int, flags: int, bus: int, data: bytes) -> str:
        self.lost["the channel"] += bus > 0
        self.lost["the direction (sent)"] += flags & OWN != 0
        self.lost["flags of CAN FD"] += flags & (BRS | ESI) != 0 or (flags & FD != 0 and len(data) <= 8)
        t_ns += self.begin_ns or 0
        bits = [int(can_id & flag != 0) for flag in (EXTENDED, REMOTE, ERROR)]
        text = "" if can_id & REMOTE else b64encode(data).decode()
        fields = f"{t_ns // 10**9}.{t_ns % 10**9:09d}", f"0x{can_id & ID_MASK:x}", *bits, len(data), text
        return ",".join(map(str, fields)) + "\r\n"


class BlfWriter(_Dated):
    """Writes BLF, a container as soon as it is full."""

    def __init__(self, path: Path, _names: Mapping[int, str] | None = None) -> None:
        super().__init__()
        self._file = path.open("wb")
        self._held = bytearray()
        self._objects, self._unpacked, self._last_ns = 0, blf.FILE_HEADER_SIZE, 0
        self._head(blf.FILE_HEADER_SIZE)

    def _head(self, size: int) -> None:
        def system_time(t: datetime) -> tuple[int, ...]:
            weekday = t.isoweekday() % 7
            return t.year, t.month, weekday, t.day, t.hour, t.minute, t.second, t.microsecond // 1000

        times = *system_time(self.begin), *system_time(self.begin + timedelta(microseconds=self._last_ns // 1000))
        versions = (5, 0, 0, 0, 2, 6, 8, 1)
        head = blf.FILE_HEADER.pack(
            b"LOGG", blf.FILE_HEADER_SIZE, *versions, size, self._unpacked, self._objects, 0, *times
        )
        self._file.write(head.ljust(blf.FILE_HEADER_SIZE, b"\0"))

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        if not len(frames):
            return
        since = self.since(frames["t_ns"]).tolist()
        for t_ns, frame in zip(since, frames, strict=True):
            data = frame["data"][: int(frame["length"])].tobytes()
            can_id, flags, channel = int(frame["can_id"]), int(frame["flags"]), int(frame["bus"]) + 1
            kind, body = _blf_object(can_id, flags, channel, data)
            head = blf.OBJECT.pack(b"LOBJ", 32, 1, 32 + len(body), kind) + struct.pack("<LHHQ", 2, 0, 0, t_ns)
            self._held += head + body + bytes(len(body) % 4)
            if len(self._held) >= _CONTAINER:
                self._flush()
        self._objects += len(frames)
        self._last_ns = since[-1]

    def _flush(self) -> None:
        if self._held:
            part = zlib.compress(self._held)
            size = blf.OBJECT.size + blf.CONTAINER.size + len(part)
            self._file.write(blf.OBJECT.pack(b"LOBJ", 16, 1, size, blf.LOG_CONTAINER))
            self._file.write(blf.CONTAINER.pack(blf.ZLIB, len(self._held)) + part + bytes(size % 4))
            self._unpacked += blf.OBJECT.size + blf.CONTAINER.size + len(self._held)
            self._held.clear()

    def close(self) -> None:
        """Finish the file."""
        self._flush()
        size = self._file.tell()
        self._file.seek(0)
        self._head(size)
        self._file.close()


def _blf_object(can_id: int, flags: int, channel: int, data: bytes) -> tuple[int, bytes]:
    """Return the type and body of a frame's object, as python-can writes it."""
    name = can_id & (ID_MASK | EXTENDED)
    if can_id & ERROR:
        return blf.CAN_ERROR_EXT, struct.pack("<HHLBBBxLLH2x8s", channel, 0, 0, 0, 0, len(data), 0, name, 0, data)
    bits = (1 if flags & OWN else 0) | (0x80 if can_id & REMOTE else 0)
    if not flags & FD:
        return blf.CAN_MESSAGE, struct.pack("<HBBL8s", channel, bits, len(data), name, data)
    fd = 1 | (2 if flags & BRS else 0) | (4 if flags & ESI else 0)
    dlc = FD_LENGTHS.index(len(data))
    return blf.CAN_FD_MESSAGE, struct.pack("<HBBLLBBB5x64s", channel, bits, dlc, name, 0, 0, fd, len(data), data)


class Mf4Writer(_Dated):
    """Writes MF4 by asammdf, a group a kind of frames, in bulk; channels count from 1."""

    def __init__(self, path: Path, _names: Mapping[int, str] | None = None) -> None:
        from asammdf import MDF  # noqa: PLC0415 - an extra, slow to load

        super().__init__()
        path.open("wb").close()
        self._path, self._mdf = path, MDF(version="4.11")
        self._places: dict[str, int] = {}

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        if not len(frames):
            return
        since = self.since(frames["t_ns"]) / 1e9
        self._mdf.header.start_time = self.begin
        which = np.where(frames["can_id"] & ERROR, np.uint32(ERROR), frames["can_id"] & REMOTE)
        for kind, flag in mf4.KINDS.items():
            mine = which == flag
            if mine.any():
                self._put(kind, _mf4_records(kind, frames[mine]), since[mine])

    def _put(self, kind: str, records: NDArray[Any], times: NDArray[np.float64]) -> None:
        if kind in self._places:
            self._mdf.extend(self._places[kind], [(times, None), (records, None)])
            return
        from asammdf import Signal  # noqa: PLC0415 - an extra, slow to load
        from asammdf.blocks.source_utils import Source  # noqa: PLC0415

        source = Source("CAN", "CAN", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
        self._places[kind] = len(self._places)
        self._mdf.append(Signal(name=kind, samples=records, timestamps=times, source=source))

    def close(self) -> None:
        """Finish the file."""
        self._mdf.save(self._path, compression=2, overwrite=True)
        self._mdf.close()


def _mf4_records(kind: str, frames: Frames) -> NDArray[Any]:
    """Return frames as records of a structure."""
    ids, flags, lengths = frames["can_id"], frames["flags"], frames["length"]
    members: dict[str, tuple[str, Any]] = {
        "BusChannel": ("u1", frames["bus"] + 1),
        "ID": ("<u4", ids & ID_MASK),
        "IDE": ("u1", ids & EXTENDED != 0),
        "DLC": ("u1", np.searchsorted(FD_LENGTHS, lengths)),
        "DataLength": ("u1", lengths),
        "Dir": ("u1", flags & OWN != 0),
    }
    if kind == "CAN_DataFrame":
        members |= {name: ("u1", flags & flag != 0) for name, flag in mf4.FLAGS.items()}
    if kind != "CAN_RemoteFrame":
        members["DataBytes"] = ("(64,)u1", frames["data"])
    records = np.zeros(len(frames), [(f"{kind}.{name}", form) for name, (form, _) in members.items()])
    for name, (_, values) in members.items():
        records[f"{kind}.{name}"] = values
    return records
