"""MF4 as recorders lay it out: members that all frames have in common as virtual channels, the DLC as length.

The layouts are those of CANedge loggers: of 21 of its maker's public logs, python-can and asammdf give the same frames
(docs/fleet.md). Built here with asammdf, read by python-can's reader beside ours.
"""

import asammdf
import can
import numpy as np
import pytest
from asammdf.blocks import v4_constants as constants
from asammdf.blocks.conversion_utils import from_dict
from asammdf.blocks.source_utils import Source

from gateway.bus.frames import EXTENDED, FD, FD_LENGTHS, empty, put_message
from gateway.bus.logs import LogReader

SEED = 411
NAME = "CAN_DataFrame"


def record(width, *members):
    return np.dtype([(f"{NAME}.{name}", kind) for name, kind in members] + [(f"{NAME}.DataBytes", f"({width},)u1")])


def group(mdf, samples, begin_s, common=(), lengths=None):
    """Append a group of frames.

    Args:
        mdf: the file.
        samples: records.
        begin_s: of the first one.
        common: members that become virtual channels of one value.
        lengths: of each DLC, where the member DataLength has that.
    """
    source = Source("CAN", "CAN", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
    times = begin_s + np.arange(len(samples)) * 1e-3
    mdf.append(asammdf.Signal(name=NAME, samples=samples, timestamps=times, source=source))
    made = mdf.groups[-1]
    for channel in made.channels:
        member = channel.name.partition(".")[2]
        if member in dict(common):
            channel.channel_type = constants.CHANNEL_TYPE_VIRTUAL
            channel.bit_count = channel.byte_offset = 0
            channel.conversion = from_dict({"a": 0.0, "b": float(dict(common)[member])})
        if lengths is not None and member == "DataLength":
            table = {f"raw_{k}": float(k) for k in range(16)} | {f"phys_{k}": float(lengths[k]) for k in range(16)}
            channel.conversion = from_dict(table)


def theirs(path):
    with can.LogReader(path) as reader:
        messages = list(reader)
    frames = empty(len(messages))
    for k, message in enumerate(messages):
        put_message(frames, k, message)
    return frames, [message.channel for message in messages]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Standard frames of channel 9, extended ones of channel 1, CAN FD whose record has the DLC as length."""
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    members = [("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1"), ("DataLength", "u1"), ("Dir", "u1")]
    mdf = asammdf.MDF(version="4.11")
    for ide, channel in ((0, 9), (1, 1)):
        samples = np.zeros(300, record(8, *members))
        samples[f"{NAME}.ID"] = rng.integers(0, 2**29 if ide else 2**11, 300)
        samples[f"{NAME}.DLC"] = samples[f"{NAME}.DataLength"] = rng.integers(0, 9, 300)
        samples[f"{NAME}.DataBytes"] = rng.integers(0, 256, (300, 8))
        group(mdf, samples, 0.1 * ide, common=(("BusChannel", channel), ("IDE", ide), ("Dir", 0)))
    samples = np.zeros(200, record(64, *members, ("EDL", "u1"), ("BRS", "u1"), ("ESI", "u1")))
    samples[f"{NAME}.ID"] = rng.integers(0, 2**11, 200)
    samples[f"{NAME}.DLC"] = samples[f"{NAME}.DataLength"] = rng.integers(0, 16, 200)
    samples[f"{NAME}.DataBytes"] = rng.integers(0, 256, (200, 64))
    samples[f"{NAME}.EDL"] = 1
    samples[f"{NAME}.BRS"] = rng.integers(0, 2, 200)
    group(mdf, samples, 0.5, common=(("BusChannel", 2),), lengths=FD_LENGTHS)
    path = tmp_path_factory.mktemp("mf4") / "layout.mf4"
    mdf.save(path, compression=2)
    mdf.close()
    return path


def test_what_frames_have_in_common_is_read(path):
    reader = LogReader(path)
    found = np.concatenate(list(reader))
    assert reader.seen == {"8": 300, "0": 300, "1": 200}, "channel 1 is the first: 0"
    expected, channels = theirs(path)
    assert len(found) == len(expected) == 800
    order = np.lexsort((found["can_id"], found["t_ns"])), np.lexsort((expected["can_id"], expected["t_ns"]))
    for name in ("can_id", "flags", "length", "data"):
        np.testing.assert_array_equal(found[name][order[0]], expected[name][order[1]], err_msg=name)
    assert sorted(str(channel - 1) for channel in channels) == sorted(reader.seen.elements())
    assert ((found["can_id"] & EXTENDED) != 0).sum() == 300
    fd = found[found["flags"] & FD != 0]
    assert set(fd["length"].tolist()) == set(FD_LENGTHS)


def test_a_channel_is_taken_by_its_number(path):
    for name, count in (("8", 300), ("0", 300), ("1", 200)):
        assert sum(map(len, LogReader(path, channels={name: 0}))) == count
