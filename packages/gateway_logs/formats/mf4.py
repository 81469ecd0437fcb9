"""ASAM MDF 4 with CAN bus logging (CANedge, Vector, python-can), by asammdf: groups of channels in bulk.

A bus logging group has a structure ``CAN_DataFrame``, ``CAN_ErrorFrame`` or ``CAN_RemoteFrame`` with members for
identifier, length, bytes, direction, channel. asammdf unpacks a block of its records at once into an array; groups are
joined by time.
"""

from __future__ import annotations

import gc
import struct
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames, empty
from gateway.bus.log_source import CutOffError, compression_of, damage
from gateway.bus.readers.batch import NO_CHANNEL, FormatReader, Names, Read, bytes_of, flags_of, placed
from gateway.bus.readers.scan import scatter
from gateway.common.archives import unpacked, whole, zstd_decompressor
from gateway_fdi.errors import InputError

#: Header of a block: mark, length, number of links; where the first one is.
_BLOCK, _FIRST = struct.Struct("<4s4xQQ"), 64
#: Flag of a channel group: it is of a bus (ASAM MDF 4.1, cg_flags).
_BUS_EVENT = 2
#: Structures of frames, and the flags that their identifiers get.
KINDS = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
#: Members of frames of CAN FD, and their flags.
FLAGS = {"EDL": FD, "BRS": BRS, "ESI": ESI}
#: It looks through all frames for messages otherwise, for an extraction of its own.
_OPEN: dict[str, Any] = {"process_bus_logging": False}
#: Bytes of a compressed block, unpacked, at most; recorders write blocks of 4 MiB.
MOST = 1 << 26
#: Records that are asked of asammdf at once: the fixed cost of a call is small then.
_RECORDS = 250_000


def is_cut(path: Path) -> bool:
    """Return whether a block of a file lies beyond its end (ASAM MDF 4.1: all blocks are reached by links)."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(3)
        if head not in (b"MDF", b"UnF"):  # finished, or not finalised by its recorder
            return False
        waiting, known = [_FIRST], {_FIRST}
        while waiting:
            at = waiting.pop()
            file.seek(at)
            block = file.read(_BLOCK.size)
            if len(block) < _BLOCK.size:
                return True
            mark, length, count = _BLOCK.unpack(block)
            if mark[:2] != b"##":
                continue
            if at + length > size:
                return True
            links = struct.unpack(f"<{count}Q", file.read(8 * count)) if count else ()
            more = [link for link in links if link and link not in known]
            known.update(more)
            waiting += more
    return False


def bound_blocks() -> None:
    """Let asammdf unpack no block of data to more than :data:`MOST`; its own functions have no bound."""
    from asammdf.blocks import utils  # noqa: PLC0415 - an extra, slow to load
    from asammdf.blocks import v4_constants as kinds  # noqa: PLC0415
    from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - asammdf brings it, and isal to most machines

    deflate = import_module("isal.isal_zlib" if find_spec("isal") is not None else "zlib")
    for kind in (kinds.DZ_BLOCK_DEFLATE, kinds.DZ_BLOCK_TRANSPOSED):
        utils.DECOMPRESS_FUNC_MAP[kind] = partial(unpacked, make=deflate.decompressobj, most=MOST)
    for kind in (kinds.DZ_BLOCK_LZ, kinds.DZ_BLOCK_LZ_TRANSPOSED):
        utils.DECOMPRESS_FUNC_MAP[kind] = partial(unpacked, make=LZ4FrameDecompressor, most=MOST)
    for name in ("DZ_BLOCK_ZSTD", "DZ_BLOCK_ZSTD_TRANSPOSED"):  # older ones of asammdf do not know it
        if hasattr(kinds, name):
            utils.DECOMPRESS_FUNC_MAP[getattr(kinds, name)] = partial(unpacked, make=zstd_decompressor, most=MOST)


@contextmanager
def _tidy() -> Iterator[None]:
    """Let go of what an exception holds before it goes on: asammdf's half-made files fail when they end.

    Python would print their failure, which says nothing new, as a traceback at the program's end.
    """
    try:
        yield
    except Exception as error:
        before, sys.unraisablehook = sys.unraisablehook, lambda _: None
        try:
            traceback.clear_frames(error.__traceback__)
            gc.collect()
        finally:
            sys.unraisablehook = before
        raise


#: Frames of a group, the numbers of their channels as in the file, and whether there are more.
_Some = tuple[Frames, NDArray[np.int64], bool]


def _records(mdf: Any, index: int, kind: str, begin_ns: int) -> Iterator[_Some]:
    """Yield the records of a group of channels; its structure is ``kind``."""
    count = int(mdf.groups[index].channel_group.cycles_nr)
    for at in range(0, count, _RECORDS):
        # With conversions: a recorder may keep the DLC as length, and values that all frames share (CANedge's channel
        # and IDE) as a formula of the record's number, a virtual channel.
        found = mdf.get(kind, index, record_offset=at, record_count=min(_RECORDS, count - at), raw=False)
        yield *_frames(found, kind, begin_ns), at + _RECORDS < count


def _frames(found: Any, kind: str, begin_ns: int) -> Read:
    """Return the records of a structure as frames, and the numbers of their channels."""
    records = {name.partition(".")[2]: found.samples[name] for name in found.samples.dtype.names}
    count = len(found.timestamps)
    frames = empty(count)
    frames["t_ns"] = begin_ns + np.rint(found.timestamps * 1e9).astype(np.int64)
    # Default of python-can where a member is missing: extended.
    ids = KINDS[kind] | (0 if "IDE" in records else EXTENDED)
    of_id = {"IDE": EXTENDED} | ({"RTR": REMOTE} if kind == "CAN_ErrorFrame" else {})
    frames["can_id"] = ids | flags_of(records, of_id, count)
    if "ID" in records:
        frames["can_id"] |= records["ID"].astype(np.uint32) & ID_MASK
    flags = flags_of(records, FLAGS if kind != "CAN_RemoteFrame" else {}, count)
    flags *= flags & FD  # others mean nothing without it
    if "Dir" in records:
        direction = records["Dir"]
        own = direction != b"Rx" if direction.dtype.kind == "S" else direction != 0
        flags[own] |= OWN
    frames["flags"] = flags
    if "DataBytes" in records and "DataLength" in records and kind != "CAN_RemoteFrame":
        data = records["DataBytes"]
        lengths = np.clip(records["DataLength"].astype(np.int64), 0, min(data.shape[1], 64))
        begins = np.arange(count) * data.shape[1]
        scatter(np.ascontiguousarray(data).reshape(-1), begins, lengths, bytes_of(frames))
        frames["length"] = np.where(frames["can_id"] & REMOTE, 0, lengths)
    if kind == "CAN_RemoteFrame" and "DLC" in records:
        frames["length"] = np.minimum(records["DLC"], 8)
    channel = records.get("BusChannel", np.array(NO_CHANNEL))
    return frames, np.broadcast_to(channel.astype(np.int64), count)


def _groups(mdf: Any) -> list[Iterator[_Some]]:
    """Return the groups of CAN frames of a file."""
    from asammdf.blocks.source_utils import Source  # noqa: PLC0415 - an extra, slow to load

    begin_ns = round(mdf.header.start_time.timestamp() * 1e6) * 1000 + int(mdf.header.abs_time) % 1000
    found = []
    for index, group in enumerate(mdf.groups):
        source = group.channel_group.acq_source
        if not group.channel_group.flags & _BUS_EVENT or not group.channel_group.cycles_nr or source is None:
            continue
        if not source.source_type & Source.SOURCE_BUS or source.bus_type != Source.BUS_TYPE_CAN:
            continue
        has = {channel.name for channel in group.channels}
        kind = next((kind for kind in KINDS if kind in has), None)
        if kind is not None:
            found.append(_records(mdf, index, kind, begin_ns))
    return found


def _joined(groups: list[Iterator[_Some]], names: Names) -> Iterator[Read]:
    """Yield the frames of all groups, in order of time, and the places of their channels, which count from 0."""
    held = [(group, *next(group)) for group in groups]
    # They count from 1, but python-can writes the numbers that it is given.
    first = 0 if any((channel == 0).any() for _, _, channel, _ in held) else 1
    while held:
        last = [int(frames["t_ns"].max()) for _, frames, _, more in held if more]
        until = min(last, default=np.iinfo(np.int64).max)
        taken, rest = [], []
        for group, frames, channel, more in held:
            end = int(np.searchsorted(np.maximum.accumulate(frames["t_ns"]), until, "right"))
            taken.append((frames[:end], channel[:end]))
            if some := (frames[end:], channel[end:], more) if end < len(frames) else next(group, None):
                rest.append((group, *some))
        held = rest
        frames, channel = taken[0]
        if len(taken) > 1:
            frames = np.concatenate([frames for frames, _ in taken])
            order = np.argsort(frames["t_ns"], kind="stable")
            frames, channel = frames[order], np.concatenate([channel for _, channel in taken])[order]
        yield frames, placed(np.where(channel == NO_CHANNEL, channel, channel - first), names)


class Mf4(FormatReader):
    """Reads MF4 (see :class:`gateway.bus.readers.batch.Reader`); asammdf maps the file."""

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether a log begins as one of MDF 4 does, finished or not."""
        return (first[:3] == b"MDF" and first[8:9] == b"4") or first.startswith(b"UnFinMF ")

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames."""
        packed = bool(compression_of(self._path))
        cut = not packed and is_cut(self._path)
        frames = 0
        try:
            for taken, channel in self._all(stream if packed else None, names):
                for first in range(0, len(taken), chunk):
                    frames += len(taken[first : first + chunk])
                    yield taken[first : first + chunk], channel[first : first + chunk]
        except InputError as error:
            raise error.within(self._path) from None
        except Exception as error:  # asammdf and decompressors let any exception of theirs through
            if not cut:
                raise damage(error, self._path, frames) from None
            text = " ".join(str(error).split()) or type(error).__name__
            raise CutOffError(f"cut off after frame {frames}: {text}", file=self._path) from None
        if cut:
            raise CutOffError(f"cut off after frame {frames}", file=self._path)

    def _all(self, stream: BinaryIO | None, names: Names) -> Iterator[Read]:
        from asammdf import MDF  # noqa: PLC0415 - an extra, slow to load

        bound_blocks()
        with _tidy():
            # It maps a file that has a name, and reads another one whole.
            mdf = MDF(self._path if stream is None else whole(stream, self._path), **_OPEN)
        try:
            yield from _joined(_groups(mdf), names)
        finally:
            mdf.close()
