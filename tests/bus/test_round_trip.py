"""Twelve frames through all formats, written and read: the table of docs/daemon.md says what comes back."""

from pathlib import Path

import numpy as np
import pytest

from gateway.bus.conditions import BUS_OFF, CONTROLLER, LOSS, condition_frame
from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, OWN, REMOTE, empty, joined, put
from gateway.bus.log_format import formats
from gateway.bus.logs import LogReader, open_writer

PAGE = Path(__file__).parents[2] / "docs" / "daemon.md"
BEGIN_NS = 1_700_000_000 * 10**9
#: Identifier, bytes, flags; buses take turns.
FRAMES = (
    (0x123, b"\x11\x22", 0),
    (0x123 | REMOTE, b"", 0),
    (0x1BCDEF01 | EXTENDED | REMOTE, bytes(5), 0),
    (ERROR | CONTROLLER, bytes([0, 0x20, 0, 0, 0, 0, 130, 7]), 0),
    (ERROR | BUS_OFF, bytes(8), 0),
    (0x7FF, b"\1\2\3\4", FD),
    (0x123, bytes(range(12)), FD | BRS),
    (0x12345678 | EXTENDED, bytes(range(64)), FD | BRS | ESI),
    (0x55, b"", FD | ESI),
    (0x12345678 | EXTENDED, b"\xde\xad", OWN),
    (0x56, bytes(24), FD | OWN),
    (0x0, b"", 0),
)
#: Columns of the table, and the frames that tell it: what has to come back of them.
COLUMNS = {
    "CAN FD": ("flags", FD, range(12)),
    "BRS": ("flags", BRS, range(12)),
    "ESI": ("flags", ESI, range(12)),
    "remote, DLC": ("length", 0xFF, (1, 2)),
    "error, class": ("can_id", 0xFFFFFFFF, (3, 4)),
    "direction": ("flags", OWN, range(12)),
    "channel": ("bus", 0xFF, range(12)),
    "0 bytes": ("length", 0xFF, (8, 11)),
    "ns": ("t_ns", (1 << 63) - 1, range(12)),
}

FORMATS = formats()


def twelve():
    frames = empty(len(FRAMES))
    for k, (can_id, data, flags) in enumerate(FRAMES):
        put(frames, k, BEGIN_NS + 123_456_789 * k + k, can_id, data, flags=flags, bus=k % 2)
    return frames


def through(suffix, frames, folder):
    """Return frames as they come back, and the writer, which says what the format cannot hold."""
    path = folder / f"a{suffix}"
    with open_writer(path) as writer:
        writer.write(frames[:5])
        writer.write(frames[5:])
    reader = LogReader(path, channels={"can0": 0, "can1": 1, "0": 0, "1": 1, "none": 0})
    again = np.concatenate(list(reader))
    again["t_ns"] += reader.origin_ns
    assert not reader.problems
    assert len(again) == len(frames), "no frame is lost in any format"
    return again, writer


def row(suffix, folder):
    frames = twelve()
    again, writer = through(suffix, frames, folder)
    np.testing.assert_array_equal(again["data"], frames["data"])
    kept = []
    for field, bits, places in COLUMNS.values():
        one, two = (np.asarray(f[field], np.int64)[list(places)] & bits for f in (frames, again))
        kept.append(bool((one == two).all()))
    if all(kept):
        np.testing.assert_array_equal(again, frames)
    assert bool(writer.problems) != all(kept), "what is lost is told, and nothing else"
    cells = " | ".join("yes" if one else "no" for one in kept)
    return f"| `{suffix}` | {FORMATS[suffix].name} | {cells} |"


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_page_says_what_comes_back(suffix, tmp_path):
    made = row(suffix, tmp_path)
    assert made in PAGE.read_text(), f"docs/daemon.md lacks: {made}"


def test_the_page_has_the_columns():
    assert f"| suffix | format | {' | '.join(COLUMNS)} |" in PAGE.read_text()


@pytest.mark.parametrize("suffix", sorted(set(FORMATS) - {".csv"}))
def test_conditions_of_our_own_come_back_too(suffix, tmp_path):
    frames = joined([condition_frame(BEGIN_NS, 0, LOSS, 77), twelve()[5:10]])
    again, _ = through(suffix, frames, tmp_path)
    np.testing.assert_array_equal(again, frames)
