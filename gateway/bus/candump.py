"""candump logs: our native recording, because it keeps integer nanoseconds.

Lines as ``candump -L`` (and ``-N`` with nanoseconds) writes them::

    (1700000000.123456789) can0 123#1122
    (1700000000.123456789) can0 12345678##5112233

python-can reads such stamps as float seconds, whose spacing today is 238 ns; then live would not equal
replay. So this format has a reader and a writer of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gateway.bus.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    OWN,
    REMOTE,
    Frames,
    empty,
    payload,
)
from gateway.bus.log_source import CutOffError
from gateway.errors import InputError

_BAD_LINE = 'a line is "(seconds) interface ID#DATA"'
_CUT = "cut off in this line"


def _stamp(text: bytes) -> int:
    seconds, _, rest = text.partition(b".")
    if len(rest) > 9:
        raise ValueError("stamp")
    t_ns = int(seconds) * 10**9 + int(rest.ljust(9, b"0"))
    if not 0 <= t_ns < 2**63:
        raise ValueError("stamp")
    return t_ns


def _identifier(text: bytes) -> int:
    can_id = int(text, 16)
    if len(text) == 3:
        if can_id > 0x7FF:
            raise ValueError("identifier")
        return can_id
    if len(text) != 8:
        raise ValueError("identifier")
    # Eight digits are an extended identifier, or the kernel's identifier of an error frame.
    return can_id if can_id & ERROR else (can_id & 0x1FFFFFFF) | EXTENDED


def _body(text: bytes) -> tuple[int, int, bytes]:
    """Return (can_id, flags, payload) of ``ID#DATA``, ``ID##FDATA`` or ``ID#R``."""
    name, _, data = text.partition(b"#")
    can_id = _identifier(name)
    if data.startswith(b"#"):
        bits = int(data[1:2], 16)
        content = bytes.fromhex(data[2:].decode("ascii"))
        if len(content) not in FD_LENGTHS:
            raise ValueError("length")
        return can_id, FD | (BRS if bits & 1 else 0) | (ESI if bits & 2 else 0), content
    if data[:1] in (b"R", b"r"):
        return can_id | REMOTE, 0, b""
    content = bytes.fromhex(data.decode("ascii").replace(".", ""))
    if len(content) > 8:
        raise ValueError("length")
    return can_id, 0, content


def parse(
    lines: list[bytes],
    first_line: int,
    path: Path,
    channels: Mapping[str, int] | None,
    seen: Counter[str],
) -> tuple[Frames, InputError | None]:
    """Read lines into a batch.

    Args:
        lines: with their ends, which only the last of a file may lack; empty ones are passed over.
        first_line: number of the first.
        path: for errors.
        channels: interface -> bus index; None puts all on bus 0. Frames of others are left out.
        seen: counts the frames of each interface, left out or not.

    Returns:
        the frames up to the first bad line, and the error there.
    """
    stamps, identifiers, flags, lengths, buses, contents = [], [], [], [], [], []
    interfaces: list[bytes] = []
    wrong: InputError | None = None
    for number, line in enumerate(lines, start=first_line):
        words = line.split()
        if not words:
            continue
        try:
            stamp, interface, body = words[0], words[1], words[2]
            if stamp[:1] != b"(" or stamp[-1:] != b")":
                raise ValueError("stamp")
            t_ns = _stamp(stamp[1:-1])
            can_id, flag, content = _body(body)
        except (ValueError, IndexError):
            shown = line[:60].decode("ascii", "replace")
            if line.endswith(b"\n"):
                wrong = InputError(_BAD_LINE, file=path, line=number, value=shown)
            else:
                wrong = CutOffError(_CUT, file=path, line=number, value=shown)
            break
        interfaces.append(interface)
        bus = 0
        if channels is not None:
            found = channels.get(interface.decode("ascii", "replace"))
            if found is None:
                continue
            bus = found
        stamps.append(t_ns)
        identifiers.append(can_id)
        flags.append(flag | OWN if words[3:4] == [b"T"] else flag)
        lengths.append(len(content))
        buses.append(bus)
        contents.append(content.ljust(64, b"\0"))
    seen.update({n.decode("ascii", "replace"): k for n, k in Counter(interfaces).items()})
    frames = empty(len(stamps))
    frames["t_ns"] = stamps
    frames["can_id"] = identifiers
    frames["flags"] = flags
    frames["length"] = lengths
    frames["bus"] = buses
    if contents:
        frames["data"] = np.frombuffer(b"".join(contents), np.uint8).reshape(-1, 64)
    return frames, wrong


def cut_short(frames: Frames, before: Frames) -> bool:
    """Tell whether a log's last frame is shorter than the one before it of the same identifier.

    Args:
        frames: the last batch, not empty; its last line has no end.
        before: the batch before.
    """
    last = frames[-1]
    for batch in (frames[:-1], before):
        same = batch[(batch["can_id"] == last["can_id"]) & (batch["bus"] == last["bus"])]
        if len(same):
            return bool(last["length"] < same[-1]["length"])
    return False


def format_frame(frame: np.void, interface: str) -> str:
    """Return one frame as a line, without its end."""
    t_ns, can_id, flags = int(frame["t_ns"]), int(frame["can_id"]), int(frame["flags"])
    if can_id & ERROR:
        name = f"{can_id & ~EXTENDED:08X}"
    elif can_id & EXTENDED:
        name = f"{can_id & 0x1FFFFFFF:08X}"
    else:
        name = f"{can_id & 0x7FF:03X}"
    data = payload(frame).hex().upper()
    if can_id & REMOTE:
        body = f"{name}#R"
    elif flags & FD:
        bits = (1 if flags & BRS else 0) | (2 if flags & ESI else 0)
        body = f"{name}##{bits:X}{data}"
    else:
        body = f"{name}#{data}"
    sent = " T" if flags & OWN else ""
    return f"({t_ns // 10**9}.{t_ns % 10**9:09d}) {interface} {body}{sent}"


class CandumpWriter:
    """Writes a candump log, flushed after each batch.

    Args:
        file: open for writing; closed with this writer.
        interfaces: name of each bus.
    """

    def __init__(self, file: BinaryIO, interfaces: Mapping[int, str] | None = None) -> None:
        self._file = file
        self._interfaces = interfaces or {}

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        lines = [
            format_frame(frame, self._interfaces.get(int(frame["bus"]), f"can{int(frame['bus'])}")) for frame in frames
        ]
        if lines:
            self._file.write(("\n".join(lines) + "\n").encode("ascii"))
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
