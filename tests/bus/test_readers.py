"""Our readers beside python-can's, frame by frame, on random logs and on lines that its writers do not write."""

import bz2
import gzip
import lzma
import struct
import zipfile
import zlib

import can
import numpy as np
import pytest
from amount import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.bus.frames import ERROR, FD, FD_LENGTHS, OWN, REMOTE, empty, put_message
from gateway.bus.log_source import CutOffError
from gateway.bus.logs import LogReader
from gateway_fdi.errors import InputError
from gateway_logs.formats import blf
from gateway_logs.formats.asc import date_ns

#: What doubles at today's epoch cannot tell apart, and the rounding to microseconds above it [ns].
NEAR = 2000
#: Of an error on the bus: classes of a protocol error and a bus error (linux/can/error.h).
BUS_ERROR_FRAME = ERROR | 0x88


def ours(path, chunk=100_000):
    """Return all frames of a log."""
    batches = list(LogReader(path, chunk=chunk))
    return np.concatenate(batches) if batches else empty(0)


def theirs(path):
    """Return all frames that python-can reads, and their channels."""
    with can.LogReader(path) as reader:
        messages = list(reader)
    frames = empty(len(messages))
    for k, message in enumerate(messages):
        put_message(frames, k, message)
    bare = (frames["can_id"] & (ERROR | 0x1FFFFFFF) == ERROR) & (frames["length"] == 0)
    frames["can_id"][bare], frames["length"][bare] = BUS_ERROR_FRAME, 8  # python-can has no class of it
    numbers = {m.channel for m in messages}
    if path.suffix == ".trc" or (path.suffix == ".mf4" and 0 not in numbers):  # theirs count from 1
        return frames, ["none" if m.channel is None else str(m.channel - 1) for m in messages]
    return frames, ["none" if m.channel is None else str(m.channel) for m in messages]


def assert_equal(path, near=NEAR, chunk=100_000):
    """Check a log's frames and channels against python-can's; returns how many."""
    expected, channels = theirs(path)
    if path.suffix == ".asc":  # they take a frame of CAN FD without bytes for a remote frame
        fd = expected["flags"] & FD != 0
        expected["can_id"][fd] &= ~np.uint32(REMOTE)
    found = ours(path, chunk)
    assert len(found) == len(expected)
    for name in ("can_id", "flags", "length", "data"):
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
    assert np.abs(found["t_ns"] - expected["t_ns"]).max(initial=0) <= near
    reader = LogReader(path)
    assert sum(map(len, reader)) == len(expected)
    assert reader.seen == {name: channels.count(name) for name in channels}
    for name in set(channels):
        one = np.concatenate(list(LogReader(path, channels={name: 7})))
        assert len(one) == channels.count(name)
        assert set(one["bus"].tolist()) == {7}
    return len(found)


@st.composite
def message(draw, fd=True, remote=True, error=True):
    kinds = [
        "classic",
        "classic",
        *(["fd"] if fd else []),
        *(["remote"] if remote else []),
        *(["error"] if error else []),
    ]
    kind = draw(st.sampled_from(kinds))
    extended = draw(st.booleans())
    size = draw(st.sampled_from(FD_LENGTHS if kind == "fd" else range(9)))
    return can.Message(
        arbitration_id=draw(st.integers(0, 2**29 - 1 if extended else 2**11 - 1)),
        is_extended_id=extended,
        is_fd=kind == "fd",
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        bitrate_switch=kind == "fd" and draw(st.booleans()),
        error_state_indicator=kind == "fd" and draw(st.booleans()),
        is_rx=draw(st.booleans()),
        data=None if kind == "remote" else draw(st.binary(min_size=size, max_size=size)),
        channel=draw(st.integers(0, 3)),
    )


#: What each format of python-can's writers can carry.
CARRIES = {
    ".asc": {},
    ".blf": {},
    ".log": {"error": False},  # theirs loses the identifier, ours keeps it
    ".trc": {"fd": False, "remote": False, "error": False},
    ".csv": {"fd": False},
    ".mf4": {},
}


@pytest.mark.evidence("Live is replay: logs")
@pytest.mark.parametrize("suffix", sorted(CARRIES))
def test_random_logs_are_read_as_python_can_reads_them(suffix, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")

    @settings(
        suppress_health_check=list(HealthCheck), deadline=None, max_examples=examples(6 if suffix == ".mf4" else 25)
    )
    @given(
        st.lists(st.tuples(st.integers(0, 10**6), message(**CARRIES[suffix])), min_size=1, max_size=40),
        st.sampled_from([0.0, 1.7e9]),
        st.sampled_from([1, 7, 1000]),
    )
    def check(steps, begin, chunk):
        path = folder / f"a{suffix}"
        t = begin
        with can.Logger(path) as logger:
            for step, one in steps:
                t += step * 1e-6
                one.timestamp = t
                logger(one)
        assert_equal(path, chunk=chunk)

    check()


ASC = """date Sat Sep 30 15:06:13.191 2017
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sat Sep 30 15:06:13.191 2017
   0.000000 Start of measurement
   0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0
   0.015991 1  Statistic: D 1 R 1 XD 0 XR 0 E 0 O 0 B 0.04%
   2.501000 1  ErrorFrame
   2.501010 1  ErrorFrame ECC: 10100010
   2.510001 2  100             Tx   r
   2.520002 3  200             Tx   r Length = 1704000 BitCount = 145 ID = 88888888x
   2.584921 4  300             Tx   r 8 Length = 1704000 BitCount = 145 ID = 88888888x
   3.098426 1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
   3.1 1  18EBFF00x       TxRq d 8 01 A0 0F A6 60 3B D1 40
   3.2 1  7ff rx d F 01 A0 0F A6 60 3B D1 40
   3.248765 1  7FF Rx   d 0
   3.297743 J1939TP FEE3p 6       0   0  - Rx   d 23 A0 0F A6 60 3B D1 40 1F DE
  20.105214 2  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40
  30.005021 CANFD   1 Rx        300  Generic_Name_12  1 0 8  8 01 02 03 04 05 06 07 08  102203  133  303000 e0006659
  30.506898 CANFD   4 Rx  4EE  0 0 f 64 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 \
29 30 31 32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64 1331984 11 0
  30.606898 CANFD   3 Tx  50005x  name  0 1 0  0 140000 73 200050 7a60 46500250 460a0250 20011736 20010205
  30.806898 CANFD   4 Tx      ErrorFrame Not Acknowledge error, dominant error flag fffe c7 31ca Arb. 556 44 0 0 f 64
 113.016026 Start of measurement
   # what nobody knows
End TriggerBlock
"""


def test_events_of_asc(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(ASC)
    reader = LogReader(path)
    frames = np.concatenate(list(reader))
    assert reader.origin_ns == 1_506_783_973_191_000_000
    assert frames["t_ns"][-1] == 30_806_898_000
    state, *others = frames
    assert (int(state["can_id"]), state["data"][1], state["data"][6]) == (ERROR | 0x04, 0x20, 132), "error passive"
    expected, _ = theirs(path)
    request = 6  # of a frame to be sent: python-can takes it for one that was
    expected = np.delete(expected, request)
    remote = 11  # so say its flags, and that it is no frame of CAN FD
    expected["flags"][remote], expected["flags"][-1] = OWN, 0
    for name in ("can_id", "flags", "length", "data", "t_ns"):
        np.testing.assert_array_equal(np.array(others)[name], expected[name], err_msg=name)
    assert reader.passed_over.notes() == [
        "passed over: 1 x an event that is no frame (J1939TP), first in line 18:"
        " 3.297743 J1939TP FEE3p 6       0   0  - Rx   d 23 A0 0F A",
        "passed over: 1 x an event that is no frame (#), first in line 25: # what nobody knows",
    ]
    assert not reader.problems


def test_asc_in_decimal(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(
        "base dec timestamps absolute\nno internal events logged\n"
        "0.1 1 256 Rx d 3 16 255 7\n0.2 1 418119424x Rx d 1 9\n"
    )
    assert assert_equal(path) == 2
    assert ours(path)["data"][0, :3].tolist() == [16, 255, 7]


def test_asc_whose_stamps_count_from_the_event_before(tmp_path):
    """As Vector means it; python-can takes them for absolute ones."""
    path = tmp_path / "a.asc"
    path.write_text("base hex  timestamps relative\n1.0 1 1 Rx d 0\n0.5 CAN 1 Status: ok\n0.25 1 1 Rx d 0\n")
    assert ours(path)["t_ns"].tolist() == [1_000_000_000, 1_750_000_000]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("Sat Sep 30 15:06:13.191 2017", 1506783973.191),
        ("Sat Sep 30 10:06:13.191 PM 2017", 1506809173.191),
        ("Sam Mai 3 00:00:01 2025", 1746230401.0),
        ("Mon Mär 3 12:00:00 AM 2025", 1740960000.0),
        ("no date", 0.0),
    ],
)
def test_dates_of_asc(text, seconds):
    assert date_ns(text) == round(seconds * 1e3) * 10**6


@pytest.mark.parametrize(
    "line",
    [
        "0.1 1 XYZ Rx d 8 00",
        "0.1 1 100 Rx d",
        "0.1 1 100 Rx d 2 1FF 00",
        "0.1 1 100 Rx",
        "0.1 1 100",
        "01 A0 0F",
        "@@@@",
        "0.1 CANFD 1 Rx 100 0 0 8",
    ],
)
def test_a_bad_line_of_asc_is_named_and_the_rest_is_read(line, tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(f"base hex\n0.0 1 100 Rx d 1 11\n{line}\n0.2 1 100 Rx d 1 22\n")
    reader = LogReader(path)
    (found,) = reader
    assert found["data"][:, 0].tolist() == [0x11, 0x22]
    (wrong,) = reader.problems
    assert (wrong.line, wrong.file) == (3, str(path))


TRC = {
    "1.0": """;##########
;
     1)      1841 0001 8 00 00 00 00 00 00 00 00
     2)      1842 0008 8 12 34 56 78 90 12 34 56
     3)      1900 FFFFFFFF 4 00 00 00 08
     4)      1930 12345678 0 RTR
""",
    "1.1": """;$FILEVERSION=1.1
;$STARTTIME=41288.6187500000
;-------
     1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00
     2)      1283.2  Rx         0400  0
     3)      1298.9  Error       0008  4  00 00 00 08
     4)      1323.0  Tx     18EFC034  4  RTR
     5)      1334.416  Tx   18EFC034  8  00 11 22 33 44 55 66 77
""",
    "1.3": """;$FILEVERSION=1.3
;$STARTTIME=41288.6187500000
;
     1)      1059.900 1  Rx        0300 -  7  00 00 00 00 04 00 00
     2)      1283.231 2  Rx    18EFC034 -  1  32
     3)      1298.945 2  Warng FFFFFFFF - 4    00 00 00 08  BUSHEAVY
     4)      1323.201 1  Tx        0400 -  0
""",
    "2.1": """;$FILEVERSION=2.1
;$STARTTIME=43008.920986006946
;$COLUMNS=N,O,T,B,I,d,R,L,D
;
      1      1059.900 DT 1      0300 Rx -  7    00 00 00 00 04 00 00
      2      1283.231 RR 1      0300 Rx -  4
      3      1298.945 ER 1         - Rx -  5    04 00 02 00 00
      4      1298.950 FB 2  18EFC034 Tx -  12   00 01 02 03 04 05 06 07 08 09 0A 0B
""",
}


@pytest.mark.parametrize("version", sorted(TRC))
def test_versions_of_trc(version, tmp_path):
    path = tmp_path / "a.trc"
    path.write_text(TRC[version])
    reader = LogReader(path)
    found = np.concatenate(list(reader))
    states = found["can_id"] & ERROR != 0
    expected, _ = theirs(path)
    for name in ("can_id", "flags", "length", "data"):
        np.testing.assert_array_equal(found[~states][name], expected[name], err_msg=name)
    assert states.sum() == 1
    assert reader.seen == (
        {"0": 4}
        if version == "1.0"
        else {"0": 5}
        if version == "1.1"
        else {"0": 2, "1": 2}
        if version == "1.3"
        else {"0": 3, "1": 1}
    )


def test_a_line_of_trc_with_too_few_columns_is_told(tmp_path):
    path = tmp_path / "a.trc"
    path.write_text(TRC["1.1"] + "     6)   1400.0  Rx\n     7)   1500.0  Rx  0300  1  AA\n")
    reader = LogReader(path)
    assert sum(map(len, reader)) == 6
    (wrong,) = reader.problems
    assert (wrong.line, wrong.value) == (9, "6)   1400.0  Rx")


def blf_file(objects, *, packed=True, split=None):
    """Return a BLF file of objects, with containers of ``split`` bytes each."""
    body = b"".join(objects)
    parts = [body[k : k + split] for k in range(0, len(body), split)] if split else [body]
    out = b""
    for part in parts:
        data = zlib.compress(part) if packed else part
        size = 16 + 16 + len(data)
        out += blf.OBJECT.pack(b"LOBJ", 16, 1, size, blf.LOG_CONTAINER)
        out += blf.CONTAINER.pack(blf.ZLIB if packed else blf.PLAIN, len(part)) + data + bytes(size % 4)
    head = struct.pack("<4sL8BQQLL", b"LOGG", 144, *range(8), 144 + len(out), len(body), len(objects), 0)
    head += struct.pack("<8H8H", 2024, 5, 3, 1, 12, 30, 59, 250, *([0] * 8))
    return head + bytes(144 - len(head)) + out


def blf_object(kind, body, t=12_345, *, version=1, ten_us=False):
    """Return an object of BLF, padded."""
    flags = 1 if ten_us else 2
    head = struct.pack("<LHHQ", flags, 0, 0, t) if version == 1 else struct.pack("<LBxHQ8x", flags, 0, 0, t)
    size = 16 + len(head) + len(body)
    return blf.OBJECT.pack(b"LOBJ", 16 + len(head), version, size, kind) + head + body + bytes(size % 4)


def fd64(valid, data, *, bits=0x3000, own=0, other=0):
    """Return the body of a CAN_FD_MESSAGE_64."""
    return struct.pack("<BBBBLLLLLLLHBBL", 3, 13, valid, 0, 0x123, 0, bits, 0, 0, 0, 0, 0, own, other, 0) + data


OBJECTS = [
    blf_object(1, struct.pack("<HBBL8s", 1, 0, 3, 0x8012_3456, b"\1\2\3garb")),
    blf_object(1, struct.pack("<HBBL8s", 1, 0x80, 3, 0x123, b"\1\2\3")),
    blf_object(86, struct.pack("<HBBL8sLBBH", 2, 1, 15, 0x7FF, b"12345678", 0, 0, 0, 0), version=2),
    blf_object(86, struct.pack("<HBBL8s", 2, 1, 8, 0x7FF, b"12345678"), ten_us=True),
    blf_object(73, struct.pack("<HHLBBBxLLH2x8s", 1, 0, 0, 0, 0, 4, 0, 0x8000_0007, 0, b"ABCDEFGH")),
    blf_object(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 15, 0x77, 0, 0, 7, 64, bytes(range(64)))),
    blf_object(101, fd64(32, bytes(range(32)))),
    blf_object(101, fd64(48, bytes(range(40)), own=1)),  # python-can issue 1905: fewer bytes than it says
    blf_object(101, fd64(8, bytes(range(20)), bits=0x5000, other=80)),
    blf_object(101, fd64(8, b"", bits=0x10)),
    blf_object(96, b"a marker of any length"),
    blf_object(65, b"x" * 7),
    blf_object(1, struct.pack("<HBBL8s", 1, 0, 0, 5, b"")),
]


@pytest.mark.parametrize("split", [None, 64, 50, 333])
@pytest.mark.parametrize("packed", [True, False])
def test_objects_of_blf(packed, split, tmp_path):
    path = tmp_path / "a.blf"
    path.write_bytes(blf_file(OBJECTS * 3, packed=packed, split=split))
    assert assert_equal(path, chunk=4) == 33
    assert ours(path)["t_ns"][0] == 1_714_566_659_250_012_345
    assert ours(path)["t_ns"][3] == 1_714_566_659_250_000_000 + 123_450_000


def test_a_blf_without_containers_is_read_too(tmp_path):
    path = tmp_path / "a.blf"
    whole = blf_file(OBJECTS, packed=False)
    path.write_bytes(whole)
    expected = ours(path)
    path.write_bytes(whole[:144] + b"".join(OBJECTS))
    try:
        found = ours(path)
    except CutOffError:  # its header has the size with the container
        found = np.concatenate(list(beginning(path)))
    np.testing.assert_array_equal(found, expected)


def beginning(path):
    """Yield a log's batches up to what ends it."""
    try:
        yield from LogReader(path)
    except InputError:
        return


@pytest.mark.parametrize(
    ("damaged", "text"),
    [
        (lambda b: b[:150], "cut off"),
        (lambda b: b[:-9], "cut off after frame"),
        (lambda b: b"XOGG" + b[4:], "does not begin with LOGG"),
    ],
)
def test_a_blf_that_ends_early_keeps_what_came_before(damaged, text, tmp_path):
    path = tmp_path / "a.blf"
    whole = blf_file(OBJECTS * 20, split=512)
    path.write_bytes(whole)
    expected = ours(path)
    path.write_bytes(damaged(whole))
    found = list(beginning(path))
    frames = np.concatenate(found) if found else empty(0)
    np.testing.assert_array_equal(frames, expected[: len(frames)])
    with pytest.raises(InputError, match=text):
        list(LogReader(path))


@pytest.mark.parametrize(
    ("damaged", "text"),
    [
        (lambda b: b[:300] + b"\xff" * 40 + b[340:], "a container that cannot be unpacked"),
        (lambda b: b[:144] + b"garbage" + b[144:], "no object where one should be"),
        (lambda b: b + b"garbage behind the end", "no object where one should be"),
    ],
)
def test_a_blf_that_is_damaged_goes_on_with_the_next_object(damaged, text, tmp_path):
    path = tmp_path / "a.blf"
    many = [blf_object(1, struct.pack("<HBBL8s", 1, 0, 2, k % 2000, b"%02d" % (k % 100))) for k in range(300)]
    whole = blf_file(many, split=512)
    path.write_bytes(whole)
    known = ours(path)["can_id"].tolist()
    path.write_bytes(damaged(whole))
    reader = LogReader(path)
    found = np.concatenate(list(reader))["can_id"].tolist()
    assert len(known) - 25 <= len(found) <= len(known)
    rest = iter(known)
    assert all(one in rest for one in found), "nothing is made up, and the order is kept"
    assert any(text in error.message for error in reader.problems)


LINES = b"".join(b"(%d.5) can0 123#%02X\n" % (k, k % 256) for k in range(5000))


def zipped(path, *members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members:
            archive.writestr(name, data)


@pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz", ".zst", ".zip"])
def test_compressed_logs(suffix, tmp_path):
    plain, path = tmp_path / "a.log", tmp_path / f"b.log{suffix}"
    plain.write_bytes(LINES)
    if suffix == ".zip":
        zipped(path, ("a.log", LINES))
    elif suffix == ".zst":
        zstd = pytest.importorskip("backports.zstd")
        path.write_bytes(zstd.compress(LINES))
    else:
        path.write_bytes({".gz": gzip, ".bz2": bz2, ".xz": lzma}[suffix].compress(LINES))
    expected = ours(plain)
    np.testing.assert_array_equal(ours(path), expected)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CutOffError):
        list(LogReader(path))
    found = list(beginning(path)) if suffix != ".zip" else []
    frames = np.concatenate(found) if found else empty(0)
    np.testing.assert_array_equal(frames, expected[: len(frames)])


def test_several_logs_in_an_archive_are_one_log(tmp_path):
    plain, path = tmp_path / "a.log", tmp_path / "trip.zip"
    plain.write_bytes(LINES)
    half = LINES.index(b"(2500.5)")
    zipped(path, ("trip/2.log", LINES[half:]), ("trip/1.log", LINES[:half]))
    reader = LogReader(path)
    np.testing.assert_array_equal(np.concatenate(list(reader)), ours(plain))
    assert reader.seen == {"can0": 5000}
    zipped(path, ("notes.txt", b"x"))
    with pytest.raises(InputError, match="a log is one of"):
        LogReader(path)
    zipped(path)
    with pytest.raises(InputError, match="no log in this archive"):
        LogReader(path)


def test_many_interfaces(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("".join(f"({k}.0) an_interface_with_a_long_name_{k % 40} 001#{k:02X}\n" for k in range(200)))
    reader = LogReader(path)
    assert sum(map(len, reader)) == 200
    assert reader.seen == {f"an_interface_with_a_long_name_{k}": 5 for k in range(40)}
