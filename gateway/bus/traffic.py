"""Traffic on the buses: how many bits, stuff bits counted, and each identifier's period and latest payload.

Bits are those of ISO 11898-1, from the start of frame to the end of the intermission. A classical frame is walked with
its CRC, a CAN FD frame to the end of its data field, a byte at a time by tables; the stuff bits of the latter's CRC
field stand at fixed places.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, EXTENDED, FD, FD_LENGTHS, FRAME, REMOTE, Frames, empty
from gateway_fdi.jit import COMPILED, Record, Same, bound, i8, kernel, means, u1, u4, u8s

#: Number of identifiers that are kept apart; more are counted only.
IDENTIFIERS = 2048
#: A power of two, so that the table of identifiers stays half empty.
_PLACES = 2 * IDENTIFIERS

_EXTENDED, _REMOTE, _ERROR = np.int64(EXTENDED), np.int64(REMOTE), np.int64(ERROR)
_FD, _BRS = np.int64(FD), np.int64(BRS)
#: CRC delimiter, acknowledgement and its delimiter, end of frame, intermission.
_TAIL = 1 + 2 + 7 + 3
_DLC = np.zeros(65, np.int64)
for _length in range(65):
    _DLC[_length] = next(code for code, most in enumerate(FD_LENGTHS) if _length <= most)


_POLYNOMIAL = 0x4599
#: The bus before a frame: a bit alike is none of its first bit.
_IDLE = 0b100


def _crc_table() -> NDArray[np.int64]:
    """Return what each byte makes of the CRC-15, shape (256,)."""
    made = np.zeros(256, np.int64)
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_POLYNOMIAL if crc & 0x4000 else 0)
        made[byte] = crc & 0x7FFF
    return made


@kernel
def _stuff(run: int, value: int, width: int) -> int:
    """Return eight times the stuff bits that some bits need behind a run, and the run behind them.

    A run is four times its bit, and its length 1..4 less 1. A stuff bit follows five bits alike, and begins a run.
    """
    last, alike, stuffed = run >> 2, (run & 3) + 1, 0
    for place in range(width - 1, -1, -1):
        bit = (value >> place) & 1
        alike = alike + 1 if bit == last else 1
        last = bit
        if alike == 5:
            last, alike, stuffed = 1 - bit, 1, stuffed + 1
    return stuffed << 3 | last << 2 | (alike - 1)


_stuffed = getattr(_stuff, "py_func", _stuff)
_CRCS = _crc_table()
#: The same of each byte behind each run, shape (8, 256).
_STUFFING = np.array([[_stuffed(run, byte, 8) for byte in range(256)] for run in range(8)], np.int64)
_CELLS = FRAME.itemsize // 8


class Load(Record):
    """One bus since the start."""

    frames: i8 = means("frames since the start")
    errors: i8 = means("error frames, and conditions")
    nominal_bits: i8 = means("sent at the nominal bit rate, the whole of a frame without bit rate switch")
    data_bits: i8 = means("sent at the data bit rate")
    others: i8 = means("frames of identifiers that there was no place for")


class Seen(Record):
    """One identifier of one bus; gaps are since the last look."""

    used: u1 = means("1: the place is taken")
    bus: u1 = means("number of the bus")
    length: u1 = means("bytes of the latest frame", "byte")
    form: u1 = means("flags of the latest frame: FD, BRS, ...")
    can_id: u4 = means("identifier")
    count: i8 = means("frames since the start")
    last_ns: i8 = means(unit="ns")
    gaps: i8 = means("gaps between two frames")
    shortest_ns: i8 = means(unit="ns")
    longest_ns: i8 = means(unit="ns")
    sum_ns: i8 = means(unit="ns")
    words: Annotated[u8s, 8] = means("payload of the latest frame")


@kernel
def _byte(words: Any, k: int) -> int:
    return int((words[k >> 3] >> np.uint64(8 * (k & 7))) & np.uint64(0xFF))


@kernel
def classical_bits(can_id: int, length: int, words: Any) -> int:
    """Return the bits of one classical frame on the wire.

    Args:
        can_id: with EXTENDED and REMOTE.
        length: payload [byte]; its DLC.
        words: payload, the first byte lowest.
    """
    remote = 1 if can_id & _REMOTE else 0
    length = min(length, 8)  # longer payloads do not exist; their load is that of the longest
    if can_id & _EXTENDED:  # SOF, 11 bits, SRR, IDE, 18 bits, RTR, r1, r0, DLC
        head = ((can_id >> 18) & 0x7FF) << 27 | 3 << 25 | (can_id & 0x3FFFF) << 7 | remote << 6 | length
        count, size = 39, 5
    else:  # SOF, 11 bits, RTR, IDE, r0, DLC
        head = (can_id & 0x7FF) << 7 | remote << 6 | length
        count, size = 19, 3
    # Whole bytes: zeros before it do not change the CRC, and bits that alternate, the last of them recessive, no run.
    lead = 0b10101 & ((1 << (8 * size - count)) - 1)
    padded = lead << count | head
    crc, run, stuffed = 0, 0, 0
    for k in range(size - 1, -1, -1):
        crc = ((crc << 8) & 0x7FFF) ^ _CRCS[((crc >> 7) ^ (head >> (8 * k))) & 0xFF]
        step = _STUFFING[run, (padded >> (8 * k)) & 0xFF]
        run = step & 7
        stuffed += step >> 3
    size = 0 if remote else length
    for k in range(size):
        byte = _byte(words, k)
        crc = ((crc << 8) & 0x7FFF) ^ _CRCS[((crc >> 7) ^ byte) & 0xFF]
        step = _STUFFING[run, byte]
        run = step & 7
        stuffed += step >> 3
    tail = crc << 1 | (1 - (crc & 1))  # the bit more is not like the one before it
    step = _STUFFING[run, tail >> 8]
    stuffed += (step >> 3) + (_STUFFING[step & 7, tail & 0xFF] >> 3)
    return int(count + 8 * size + 15 + stuffed + _TAIL)


@kernel
def fd_bits(can_id: int, flags: int, length: int, words: Any) -> tuple[int, int]:
    """Return the bits of one CAN FD frame on the wire, those at the nominal and those at the data bit rate.

    Arguments are as of :func:`classical_bits`.
    """
    fast = 1 if flags & _BRS else 0
    if can_id & _EXTENDED:  # SOF, 11 bits, SRR, IDE, 18 bits, RRS
        head, count = ((can_id >> 18) & 0x7FF) << 21 | 3 << 19 | (can_id & 0x3FFFF) << 1, 33
    else:  # SOF, 11 bits, RRS, IDE
        head, count = (can_id & 0x7FF) << 2, 14
    count += 3
    step = _stuff(_IDLE, head << 3 | 4 | fast, count)  # and FDF, res, BRS
    stuffed = step >> 3
    arbitration = count + stuffed
    step = _stuff(step & 7, ((flags >> 2) & 1) << 4 | _DLC[length], 5)  # ESI, DLC
    stuffed += step >> 3
    for k in range(length):
        step = _STUFFING[step & 7, _byte(words, k)]
        stuffed += step >> 3
    # Stuff count and CRC, with a fixed stuff bit before them and after each four bits.
    check = 4 + 17 + 6 if length <= 16 else 4 + 21 + 7
    total = count + 5 + 8 * length + stuffed + check + _TAIL
    data = total - arbitration - _TAIL if fast else 0
    return int(total - data), int(data)


@kernel
def _place(seen: Any, bus: int, can_id: int) -> int:
    """Return the place of an identifier, a free one if it has none; -1: there is none left."""
    mask = seen.shape[0] - 1
    at = (((can_id & 0x1FFF_FFFF) * 0x9E37_79B1 + bus * 0x85EB_CA6B) >> 7) & mask
    for _ in range(seen.shape[0] // 2):
        row = seen[at]
        if row.used == 0 or (row.can_id == can_id and row.bus == bus):
            return int(at)
        at = (at + 1) & mask
    return -1


@kernel
def count_frames(loads: Any, seen: Any, used: Any, frames: Any, cells: Any) -> None:
    """Count a batch of frames, and the same as cells, uint64, shape (n, 10).

    ``loads`` and ``seen`` have shape (buses,) of Load and (a power of two,) of Seen, of which ``used`` are taken.
    """
    for i in range(frames.shape[0]):
        frame = frames[i]
        bus, can_id = int(frame["bus"]), int(frame["can_id"])
        if bus >= loads.shape[0]:
            continue
        load = loads[bus]
        if can_id & _ERROR:
            load.errors += 1
            continue
        length, flags = int(frame["length"]), int(frame["flags"])
        if flags & _FD:
            nominal, data = fd_bits(can_id, flags, length, cells[i, 2:])
        else:
            nominal, data = classical_bits(can_id, length, cells[i, 2:]), 0
        load.frames += 1
        load.nominal_bits += nominal
        load.data_bits += data
        at = _place(seen, bus, can_id)
        if at < 0 or (seen[at].used == 0 and used[0] >= seen.shape[0] // 2):
            load.others += 1
            continue
        row = seen[at]
        if row.used == 0:
            row.used = 1
            row.bus = bus
            row.can_id = can_id
            used[0] += 1
        elif frame["t_ns"] >= row.last_ns:
            gap = frame["t_ns"] - row.last_ns
            if row.gaps == 0 or gap < row.shortest_ns:
                row.shortest_ns = gap
            if row.gaps == 0 or gap > row.longest_ns:
                row.longest_ns = gap
            row.sum_ns += gap
            row.gaps += 1
        row.count += 1
        row.last_ns = frame["t_ns"]
        row.length = length
        row.form = flags
        for k in range(8):
            row.words[k] = cells[i, 2 + k]


class Traffic:
    """Counts what passes on some buses."""

    def __init__(self, buses: int) -> None:
        self.loads: Any = _table(buses, Load)
        self._seen: Any = _table(_PLACES, Seen)
        self._used = np.zeros(1, np.int64)
        none = empty(0)
        mine = self.loads, self._seen, self._used
        self._count = bound(count_frames, *mine, rest=(none, Same(0, none.view("<u8").reshape(0, _CELLS))))

    def write(self, frames: Frames) -> None:
        """Count a batch."""
        if not len(frames):
            return
        if not frames.flags.carray:
            frames = frames.copy()  # the kernel is compiled for one kind of array
        self._count(frames)

    def identifiers(self) -> NDArray[np.void]:
        """Return what was seen of each identifier, by bus and identifier, and start the gaps again."""
        rows = np.flatnonzero(self._seen["used"])
        found: NDArray[np.void] = np.array(self._seen[rows], Seen.dtype)
        for name in ("gaps", "shortest_ns", "longest_ns", "sum_ns"):
            self._seen[name] = 0
        return found[np.lexsort((found["can_id"], found["bus"]))]


def load_of(bits: Sequence[int], rates: Sequence[int | None], seconds: float) -> float | None:
    """Return the share of time that a bus was busy, 0..1; None where a bit rate that is needed is not known.

    Args:
        bits: at the nominal and at the data bit rate.
        rates: nominal and data bit rate [bit/s].
        seconds: in which they were sent.
    """
    busy = 0.0
    for count, rate in zip(bits, rates, strict=True):
        if count and not rate:
            return None
        busy += count / rate if rate else 0.0
    return busy / seconds if seconds > 0 and rates[0] else None


def _table(count: int, kind: type[Record]) -> Any:
    array = np.zeros(count, kind.dtype)
    return array if COMPILED else array.view(np.recarray)
