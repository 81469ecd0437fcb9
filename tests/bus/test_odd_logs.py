"""Logs as other tools write them, and as power cuts leave them: each line is a frame, a known event, or counted."""

import gzip
import zipfile
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from gateway.bus import logs
from gateway.bus.candump import format_frame
from gateway.bus.frames import ERROR, FD, REMOTE
from gateway.bus.logs import LogReader
from gateway_fdi.errors import InputError

HEAD = "date Tue Oct 5 10:09:25.286 am 2021\nbase hex  timestamps absolute\ninternal events logged\n"
OFF, PASSIVE, WARNING = ERROR | 0x40, (ERROR | 4, 0x30), (ERROR | 4, 0x0C)


def read(path, text, **how):
    """Return a log's frames in wall time, and its reader."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    reader = LogReader(path, **how)
    frames = np.concatenate([*reader])
    frames["t_ns"] += reader.origin_ns
    return frames, reader


def lines(frames):
    return [format_frame(one, f"can{one['bus']}").partition(" ")[2] for one in frames]


ASC = {
    "start": ("0.000000 CANFD   Start of measurement\n0.1 1 123 Rx d 1 00\n", ["can0 123#00"]),
    "negative": (
        "-1.5 1 123 Rx d 1 00\n-0.25 1 123 Rx d 1 01\n0.5 1 123 Rx d 1 02\n",
        ["can0 123#00", "can0 123#01", "can0 123#02"],
    ),
    "comma": ("0,010000 1  123             Rx   d 2 00 11\n", ["can0 123#0011"]),
    "classic on a line of CAN FD": ("0.1 CANFD 1 Rx 123 0 0 2 2 00 11 0 0 40 0 0 0 0 0\n", ["can0 123#0011"]),
    "remote on a line of CAN FD": ("0.1 CANFD 1 Tx 123 0 0 5 0 0 0 10 0 0 0 0 0\n", ["can0 123#R5 T"]),
    "no bytes on a line of CAN FD": ("0.1 CANFD 1 Rx 123 1 0 0 0 0 0 3000 0 0 0 0 0\n", ["can0 123##1"]),
    "request": ("0.1 1 123 TxRq d 1 00\n0.2 1 123 Tx d 1 00\n", ["can0 123#00 T"]),
    "remote": ("0.1 1 123 Rx r 3\n0.2 1 123 Rx r\n", ["can0 123#R3", "can0 123#R"]),
}  # fmt: skip


@pytest.mark.parametrize("case", ASC)
def test_lines_of_asc(case, tmp_path):
    text, expected = ASC[case]
    frames, reader = read(tmp_path / "a.asc", HEAD + text)
    assert lines(frames) == expected
    assert not reader.problems


def test_stamps_of_asc_below_0_are_wall_time(tmp_path):
    frames, _ = read(tmp_path / "a.asc", HEAD + ASC["negative"][0])
    begin = 1_633_428_565_286_000_000
    assert (frames["t_ns"] - begin).tolist() == [-1_500_000_000, -250_000_000, 500_000_000]
    bare, reader = read(tmp_path / "b.asc", "base hex timestamps absolute\n" + ASC["negative"][0])
    assert np.diff(bare["t_ns"]).tolist() == [1_250_000_000, 750_000_000]
    assert (reader.origin_ns, bare["t_ns"][0] >= 0) == (0, True), "a log without wall time has none"


STATES = {
    "a.asc": HEAD
    + "0.1 1 ErrorFrame ECC: 1\n0.2 CAN 1 Status:chip status error passive\n"
    "0.3 CAN 1 Status:chip status warning level\n"
    "0.4 CAN 1 Status:chip status bus off\n",
    "a.trc": ";$FILEVERSION=2.1\n;$STARTTIME=44548.6\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
    "1 1.0 ER 1 - Rx - 5 04 00 02 00 00\n2 2.0 ST 1 - Rx - 4 00 04 00 00\n3 3.0 ST 1 - Rx - 4 00 00 00 08\n"
    "4 4.0 ST 1 - Rx - 4 00 00 00 10\n",
    "b.trc": ";$FILEVERSION=1.1\n;$STARTTIME=44548.6\n1) 1.0 Error 0008 4 00 00 00 08\n"
    "2) 2.0 Warng FFFFFFFF 4 00 04 00 00 BUSPASSIVE\n3) 3.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n"
    "4) 4.0 Warng FFFFFFFF 4 00 00 00 10 BUSOFF\n",
}  # fmt: skip


@pytest.mark.parametrize("name", STATES)
def test_states_of_a_bus_become_error_frames(name, tmp_path):
    frames, reader = read(tmp_path / name, STATES[name])
    assert frames["can_id"].tolist() == [ERROR | 0x88, PASSIVE[0], WARNING[0], OFF]
    assert frames["data"][1:3, 1].tolist() == [PASSIVE[1], WARNING[1]]
    assert reader.seen == {"0": 4}
    assert not reader.problems


def test_versions_of_trc(tmp_path):
    text = ";$FILEVERSION=1.2\n;$STARTTIME=39878.6772258947\n1) 1.000 1 Rx 0300 2 00 11\n2) 2.000 2 Tx 18EFC034 1 22\n"
    frames, _ = read(tmp_path / "a.trc", text, channels={"0": 0, "1": 1})
    assert lines(frames) == ["can0 300#0011", "can1 18EFC034#22 T"]
    with pytest.raises(InputError, match=r"version 3\.0 is not read; versions 1\.0, .* 2\.1 are"):
        read(tmp_path / "b.trc", text.replace("1.2", "3.0"))


GOOD = "(1.0) can0 123#11\n"


@pytest.mark.parametrize(
    "bad",
    [
        "(1.5) can0 12(2.0) can0 123#22",
        "(1.5) can0 123#81:00:12345678#DEADBEEF",
        "garbage",
        "\0" * 70_000,
        "x" * 70_000,
        "(1.5) can0",
    ],
    ids=["glued", "CAN XL", "garbage", "zeros", "long", "short"],
)
@pytest.mark.parametrize("last", ["(3.0) can0 123#33\n", "(3.0) can0 123#33\n" * 70_000], ids=["few", "many"])
def test_a_damaged_line_does_not_end_a_log(bad, last, tmp_path):
    frames, reader = read(tmp_path / "a.log", GOOD + bad + "\n" + last)
    assert len(frames) == 1 + last.count("\n")
    (wrong,) = reader.problems
    assert wrong.line == 2


def test_zeros_before_a_good_line_lose_only_themselves(tmp_path):
    """As a file system leaves a file to which a recorder goes on writing after a power cut."""
    frames, reader = read(tmp_path / "a.log", GOOD.encode() + bytes(3_000_000) + GOOD.encode() * 2)
    assert len(frames) == 3
    assert [wrong.line for wrong in reader.problems] == [2]


def test_a_mark_of_windows_and_raw_dlcs(tmp_path):
    text = "\ufeff(1.0) can0 123#1122334455667788_B\n(2.0) can0 123#R8_9\n(3.0) can0 123#R3\n"
    frames, reader = read(tmp_path / "a.log", text)
    assert lines(frames) == ["can0 123#1122334455667788", "can0 123#R8", "can0 123#R3"]
    assert not reader.problems


PRINTED = """ ({})  can0  123   [2]  11 22
 ({})  can1  12345678   [3]  remote request
 ({})  can0  20000004   [8]  00 20 00 00 00 00 00 00   ERRORFRAME
	controller-problem{{rx-error-passive}}
 ({})  can0  TX B E  055  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B
 ({})  can0  RX - -  7FF  [01]  AA   '.'
"""


@pytest.mark.parametrize(
    ("stamps", "steps"),
    [
        (tuple(f"1700000000.00000{k}" for k in range(1, 6)), [1000] * 4),
        (tuple(f"2023-11-14 22:13:20.00000{k}" for k in range(1, 6)), [1000] * 4),
        (("000.000000", "000.000010", "000.000020", "000.000030", "000.000040"), [10_000] * 4),
        (("000.000000", "000.000010", "000.000009", "000.000011", "000.000010"), [10_000, 9_000, 11_000, 10_000]),
    ],
    ids=["-t a", "-t A", "-t z", "-t d"],
)  # fmt: skip
def test_what_candump_prints(stamps, steps, tmp_path):
    frames, reader = read(tmp_path / "a.txt", PRINTED.format(*stamps), channels={"can0": 0, "can1": 1})
    assert lines(frames) == [
        "can0 123#1122",
        "can1 12345678#R3",
        "can0 20000004#0020000000000000",
        "can0 055##3000102030405060708090A0B T",
        "can0 7FF##0AA",
    ]
    assert np.diff(frames["t_ns"]).tolist() == steps
    assert not reader.problems
    assert len(reader.passed_over) == 1, "the explanation of the error frame"


def test_what_others_print_as_candump_does(tmp_path):
    """Of a public log of a car: stamps of 10 ms were taken for times between frames, short identifiers for damage."""
    text = "".join(
        f"(925.{k // 4:02d}) RX0 {name} [1] 0{k}\n" for k, name in enumerate(["50F", "B1", "7", "12DD54AD"] * 2)
    )
    frames, reader = read(tmp_path / "a.log", text + "(925.02) RX0 7DD54AD [1] 08\n", channels={"RX0": 0})
    assert lines(frames)[:4] == ["can0 50F#00", "can0 0B1#01", "can0 007#02", "can0 12DD54AD#03"]
    assert lines(frames)[8] == "can0 07DD54AD#08"
    assert (frames["t_ns"] // 10_000_000 - 92_500).tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2]
    assert not reader.problems


CSV = {
    "savvy": "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n1000,0000021A,false,Rx,0,2,FE,36,\n"
    "3000,18FF0001,true,Tx,1,0,\n",
    "older": "Time Stamp,ID,Extended,Bus,LEN,D1,D2\n1000,0000021A,false,0,2,FE,36,\n3000,18FF0001,true,1,0,,\n",
    "canedge": "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n0.001;1;21A;0;2;2;0;0;0;FE36\n"
    "0.003;2;18FF0001;1;0;0;1;0;0;\n",
    "kvaser": "Time,Chn,Identifier,Flags,DLC,D0,D1,Counter\n0.001,0,0x21A,,2,FE,36,1\n0.003,1,0x18FF0001,,0,,,2\n",
}  # fmt: skip


@pytest.mark.parametrize("name", CSV)
def test_csv_by_the_names_of_its_columns(name, tmp_path):
    frames, reader = read(tmp_path / "a.csv", CSV[name], channels={"0": 0, "1": 1})
    sent = "" if name in ("older", "kvaser") else " T"
    assert lines(frames) == ["can0 21A#FE36", f"can1 18FF0001#{sent}"]
    assert frames["t_ns"].tolist() == [1_000_000, 3_000_000]
    frames, reader = read(tmp_path / "b.csv", CSV[name] + "damaged\n" + CSV[name].splitlines()[1] + "\n")
    assert (len(frames), [one.line for one in reader.problems]) == (3, [4])


@pytest.mark.parametrize(("step", "unit_ns"), [(1, 10**6), (2, 10**6), (14, 10**6), (16, 1000), (230, 1000)])
def test_whole_stamps_of_csv_count_what_a_bus_can_carry(step, unit_ns, tmp_path):
    rows = "".join(f"1\t0\tRX\t{48659509 + k * step}\t0x120\t1\t0x08\n" for k in range(5000))
    frames, _ = read(tmp_path / "a.log", "ParserFlags\tCh\tT/R\tTime\tCAN ID\tLen\tData\n" + rows)
    assert len(frames) == 5000
    assert set(np.diff(frames["t_ns"]).tolist()) == {step * unit_ns}


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        (("1767062175875212", "1767062175875870"), [1767062175875212000, 1767062175875870000]),
        (("1767062175875", "1767062175876"), [1767062175875000000, 1767062175876000000]),
        (
            ("-1725172529967471", "-1725172529967955", "-1725172529966481"),
            [3600_000_000_000, 3599_999_516_000, 3600_000_990_000],
        ),
        (("-0.5", "0.25"), [3599_500_000_000, 3600_250_000_000]),
    ],
    ids=["us of the wall clock", "ms of the wall clock", "below zero", "from below zero"],
)
def test_stamps_of_csv_may_be_large_or_below_zero(stamps, expected, tmp_path):
    """All frames of three public logs of cars, in us below zero, were damage; so were whole ones of the wall clock."""
    rows = "".join(f"{stamp},0000021A,false,Rx,0,2,FE,36,\n" for stamp in stamps)
    frames, reader = read(tmp_path / "a.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n" + rows)
    assert frames["t_ns"].tolist() == expected
    assert not reader.problems


def test_a_csv_of_something_else_is_refused(tmp_path):
    with pytest.raises(InputError, match="no CSV of frames that we know"):
        read(tmp_path / "a.csv", "ID,Data Bytes\n0000021A,FE 36\n")


@pytest.mark.parametrize(
    ("head", "bad", "good"),
    [
        (
            "timestamp,arbitration_id,extended,remote,error,dlc,data\n",
            "1.5,0x123,0,0,0,2,AAEC\n",
            "2.5,0x123,0,0,0,2,AAE=\n",
        ),
        ("Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n", "10x2,21A,false,Rx,0,1,FE,\n", "2000,21A,false,Rx,0,1,FE,\n"),
    ],
    ids=["length", "stamp"],
)
def test_lines_of_csv_that_disagree_with_themselves_are_damaged(head, bad, good, tmp_path):
    frames, reader = read(tmp_path / "a.csv", head + bad + good)
    assert (len(frames), [one.line for one in reader.problems]) == (1, [2])


def test_long_payloads_of_python_cans_csv_are_can_fd(tmp_path):
    head = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
    frames, _ = read(tmp_path / "a.csv", head + "1.5,0x123,0,0,0,12,AAECAwQFBgcICQoL\n2.5,0x124,0,1,0,4,\n")
    assert frames["flags"].tolist() == [FD, 0]
    assert (int(frames["can_id"][1]), int(frames["length"][1])) == (0x124 | REMOTE, 4)


@pytest.mark.parametrize("name", ["a.log", "a.asc", "a.txt", "a", "a.csv"])
def test_the_content_tells_the_format(name, tmp_path):
    for text, expected in ((GOOD, ["can0 123#11"]), (HEAD + "0.1 1 123 Rx d 1 00\n", ["can0 123#00"])):
        frames, _ = read(tmp_path / name, text)
        assert lines(frames) == expected


class Mine:
    """A plug-in's reader of a suffix that we have."""

    origin_ns = 0

    def __init__(self, path):
        self.passed_over = ["line 1: odd"]

    @staticmethod
    def sniff(first):
        return first.startswith(b"MINE")


def test_a_plug_in_may_take_a_suffix_that_we_have(tmp_path, monkeypatch):
    taken = []

    class Taken(Mine):
        def read(self, stream, names, chunk):
            taken.append(stream.read())
            return iter(())

    monkeypatch.setattr(logs, "READERS", {".log": Taken})
    (tmp_path / "a.log").write_bytes(b"MINE 1\n")
    reader = LogReader(tmp_path / "a.log")
    assert list(reader) == []
    assert (taken, reader.formats) == ([b"MINE 1\n"], [".log (of a plug-in)"])
    assert len(reader.problems) == 1, "its texts are damage"
    frames, _ = read(tmp_path / "b.log", GOOD)
    assert lines(frames) == ["can0 123#11"], "what is ours stays ours"


def test_a_zip_of_a_mac_and_one_with_other_files(tmp_path):
    path = tmp_path / "drive.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("__MACOSX/._drive.log", b"\0\5\x16\7")
        archive.writestr("._drive.log", b"\0\5\x16\7")
        archive.writestr("drive.log", GOOD)
        archive.writestr("more.log.gz", gzip.compress(GOOD.encode()))
        archive.writestr("readme.txt", "a healthy drive\n")
        archive.writestr("trip", HEAD + "0.1 1 123 Rx d 1 00\n")
    reader = LogReader(path)
    assert sum(map(len, reader)) == 3
    assert not reader.problems
    assert len(reader.passed_over.notes()) == 1, "the text"


def test_local_time_of_a_header(tmp_path):
    berlin = ZoneInfo("Europe/Berlin")
    trc = ";$FILEVERSION=1.1\n;$STARTTIME=44474.5\n1) 1.0 Rx 0300 0\n"  # 2021-10-05, 2 h before UTC
    for name, text in (("a.asc", HEAD + "0.1 1 123 Rx d 1 00\n"), ("a.trc", trc)):
        utc, _ = read(tmp_path / name, text)
        local, _ = read(tmp_path / name, text, zone=berlin)
        assert int(utc["t_ns"][0]) - int(local["t_ns"][0]) == 2 * 3600 * 10**9
