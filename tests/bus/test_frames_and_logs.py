"""Frames and log files, with python-can as the oracle."""

import can
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.bus.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    OWN,
    REMOTE,
    empty,
    payload,
    put,
    put_message,
    to_message,
)
from gateway.bus.log_format import formats
from gateway.bus.logs import LogReader, open_writer
from gateway_fdi.errors import InputError

FORMATS = formats()


@st.composite
def frame(draw, times=st.integers(0, 2**62)):
    frames = empty(1)
    extended = draw(st.booleans())
    can_id = draw(st.integers(0, 2**29 - 1 if extended else 2**11 - 1))
    can_id |= EXTENDED if extended else 0
    flags = 0
    kind = draw(st.sampled_from(["classic", "classic", "fd", "remote"]))
    if kind == "fd":
        flags = FD | draw(st.sampled_from([0, BRS, ESI, BRS | ESI]))
        size = draw(st.sampled_from(FD_LENGTHS))
    else:
        size = draw(st.integers(0, 8))
    body = draw(st.binary(min_size=size, max_size=size))
    if kind == "remote":
        can_id, body = can_id | REMOTE, bytes(size)  # its DLC
    if draw(st.booleans()):
        flags |= OWN
    put(frames, 0, draw(times), can_id, body, flags=flags)
    return frames


@given(frame(times=st.integers(0, 10**15 - 1)))
def test_a_message_of_python_can_and_back(frames):
    message = to_message(frames[0])
    again = empty(1)
    put_message(again, 0, message)
    assert abs(int(again[0]["t_ns"]) - int(frames[0]["t_ns"])) <= 1
    again["t_ns"] = frames["t_ns"]
    assert again == frames


def test_too_long_a_payload_is_refused():
    with pytest.raises(InputError, match="64 bytes"):
        put(empty(1), 0, 0, 1, bytes(65))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(frame(), min_size=1, max_size=20))
def test_candump_keeps_every_nanosecond(tmp_path, batch):
    frames = np.concatenate(batch)
    path = tmp_path / "a.log"
    with open_writer(path) as writer:
        writer.write(frames[:3])
        writer.write(frames[3:])
    again = np.concatenate(list(LogReader(path, chunk=7)))
    np.testing.assert_array_equal(again, frames)


def some_frames(fd):
    frames = empty(200)
    rng = np.random.default_rng(3)
    for k in range(len(frames)):
        extended = k % 3 == 0
        is_fd = fd and k % 5 == 0
        size = 48 if is_fd else k % 9
        put(
            frames,
            k,
            1_700_000_000_000_000_000 + k * 1_230_000,
            int(rng.integers(2048)) | (EXTENDED if extended else 0),
            rng.bytes(size),
            flags=FD | BRS if is_fd else 0,
        )
    return frames


@pytest.mark.parametrize("suffix", sorted(FORMATS))
def test_what_we_write_we_read(tmp_path, suffix):
    frames = some_frames(fd=suffix not in (".trc",))
    path = tmp_path / f"a{suffix}"
    with open_writer(path) as writer:
        writer.write(frames)
    reader = LogReader(path, chunk=64)
    again = np.concatenate(list(reader))
    assert reader.bytes_done == reader.bytes_total > 0
    np.testing.assert_array_equal(again["can_id"], frames["can_id"])
    np.testing.assert_array_equal(again["length"], frames["length"])
    np.testing.assert_array_equal(again["data"], frames["data"])
    # Formats that keep times relative to their start are compared by differences.
    ours, theirs = np.diff(again["t_ns"]), np.diff(frames["t_ns"])
    assert np.abs(ours - theirs).max() <= (150_000 if suffix == ".trc" else 2_000)


@pytest.mark.parametrize("suffix", sorted(set(FORMATS) - {".mf4", ".parquet"}))
def test_what_python_can_writes_we_read(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    frames = some_frames(fd=suffix not in (".trc",))
    with can.Logger(path) as logger:
        for one in frames:
            logger(to_message(one, channel=0))
    again = np.concatenate(list(LogReader(path)))
    with can.LogReader(path) as oracle:
        for ours, theirs in zip(again, oracle, strict=True):
            assert int(ours["can_id"]) & 0x1FFFFFFF == theirs.arbitration_id
            assert payload(ours) == bytes(theirs.data)
            assert bool(int(ours["flags"]) & FD) == theirs.is_fd or (suffix == ".csv" and theirs.dlc > 8)


def test_python_can_reads_our_candump(tmp_path):
    path = tmp_path / "a.log"
    frames = some_frames(fd=True)
    with open_writer(path) as writer:
        writer.write(frames)
    with can.LogReader(path) as oracle:
        for ours, theirs in zip(frames, oracle, strict=True):
            assert theirs.timestamp == pytest.approx(int(ours["t_ns"]) / 1e9, abs=1e-6)
            assert bytes(theirs.data) == payload(ours)


@pytest.mark.evidence("Nothing is silent: damaged log")
@pytest.mark.long
@pytest.mark.parametrize("suffix", sorted(FORMATS))
def test_a_damaged_log_is_one_clear_error_after_its_good_frames(tmp_path, suffix):
    """Cut anywhere: the frames read are a beginning of the log's, and no other exception comes."""
    frames = some_frames(fd=suffix not in (".trc",))
    path = tmp_path / f"a{suffix}"
    with open_writer(path) as writer:
        writer.write(frames)
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    refused = 0
    for cut in sorted(rng.integers(0, len(whole), 6 if suffix == ".mf4" else 40)):
        path.write_bytes(whole[:cut])
        parts = []
        try:
            for batch in LogReader(path):
                parts.append(batch.copy())
        except InputError as error:
            refused += 1
            assert str(path) in str(error)
            assert "\n" not in str(error)
        got = np.concatenate(parts) if parts else empty(0)
        assert len(got) <= len(frames)
        # The last frame may be cut within its data in formats of text.
        for ours, theirs in zip(got[:-1], frames, strict=False):
            assert payload(ours) == payload(theirs)
    # A text format may be readable up to wherever it is cut.
    assert refused or suffix == ".trc"


def test_candump_names_the_bad_line_and_goes_on(tmp_path):
    path = tmp_path / "a.log"
    for bad in (
        "nonsense",
        "(1.0) can0 12#11",
        "(1.0) can0 123#1",
        "(1.0) can0 123#112233445566778899",
        "(x) can0 123#11",
        "(1.0) can0 FFF#11",
        "(1.0) can0 123##",
        "(1.0) can0",
        "(1.1234567890) can0 123#11",
    ):
        path.write_text(f"(1.000000) can0 123#1122\n\n{bad}\n(2.000000) can0 123#33\n")
        reader = LogReader(path)
        (frames,) = reader
        assert frames["data"][:, 0].tolist() == [0x11, 0x33], "the rest is read"
        (wrong,) = reader.problems
        assert wrong.line == 3


def test_channels_become_buses(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 001#\n(2.0) can1 002#\n(3.0) vcan7 003#\n")
    batch = np.concatenate(list(LogReader(path, channels={"can1": 4, "can0": 2})))
    assert batch["bus"].tolist() == [2, 4]


def test_error_frames_keep_their_identifier(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 20000040#0000000000000000\n")
    (batch,) = LogReader(path)
    assert int(batch[0]["can_id"]) == ERROR | 0x40
    with open_writer(tmp_path / "b.log") as writer:
        writer.write(batch)
    assert (tmp_path / "b.log").read_text() == "(1.000000000) can0 20000040#0000000000000000\n"


def test_unknown_formats_and_missing_files(tmp_path):
    with pytest.raises(InputError, match=r"\.log \(candump\)"):
        LogReader(tmp_path / "a.xyz")
    with pytest.raises(InputError, match="No such file"):
        LogReader(tmp_path / "a.log")
    with pytest.raises(InputError, match="No such file"):
        open_writer(tmp_path / "none" / "a.log")
