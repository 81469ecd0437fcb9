"""Logs that mean harm: what they hold is bounded, and the error names file, line and limit."""

import bz2
import gzip
import lzma
import tracemalloc
import zipfile
import zlib
from importlib import import_module

import pytest
from command import command

from gateway.bus.log_source import CutOffError
from gateway.bus.logs import LogReader
from gateway_fdi.errors import InputError
from gateway_logs.formats import blf, mf4

try:
    zstd = import_module("compression.zstd")
except ImportError:
    zstd = import_module("backports.zstd")

GOOD = b"(1.000000) can0 123#01\n"
#: Blocks are read of 1 MiB: a file that is longer has few lines of these.
MORE_THAN_A_BLOCK = (GOOD[:-3] + b"#0" + b"01" * 64 + b"\n") * 8000
LINE = 1 << 16
#: Of a bomb, unpacked: a reader that kept it would be seen.
SIZE = 40_000_000
FLAT = 16_000_000

PACKED = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
    ".zst": zstd.compress,
}


def pack(path, inner, data):
    """Write a packed log."""
    if path.suffix == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(inner, data)
    else:
        path.write_bytes(PACKED[path.suffix](data))
    return path


def ended(path):
    """Read a log; returns its frames, its error, and the most memory that was held [byte]."""
    reader, frames = LogReader(path, chunk=1000), 0
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as wrong:
            for batch in reader:
                frames += len(batch)
            if reader.problems:  # it did not end the log
                raise reader.problems[0]
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return frames, wrong.value, most


@pytest.mark.parametrize("suffix", [*PACKED, ".zip"])
def test_a_line_without_an_end_is_refused_and_memory_stays_flat(suffix, tmp_path):
    path = pack(tmp_path / f"bomb.log{suffix}", "bomb.log", GOOD * 2 + b"x" * SIZE)
    assert path.stat().st_size < 100_000
    frames, error, most = ended(path)
    assert frames == 2, "what came before is kept"
    assert (error.file, error.line) == (str(path), 3)
    assert f"longer than {LINE} bytes" in error.message
    assert not isinstance(error, CutOffError)
    assert most < FLAT


def test_zeros_that_a_killed_recorder_leaves_are_a_cut(tmp_path):
    path = tmp_path / "log.log"
    path.write_bytes(GOOD + bytes(3_000_000))
    frames, error, most = ended(path)
    assert frames == 1
    assert isinstance(error, CutOffError)
    assert (error.line, f"{LINE} zero bytes" in error.message) == (2, True)
    assert most < FLAT


@pytest.mark.parametrize("suffix", [".log", ".asc", ".trc", ".csv"])
@pytest.mark.parametrize("after", [b"", b"\n", b"\n" + MORE_THAN_A_BLOCK], ids=["last", "ended", "within"])
def test_a_long_line_is_refused_wherever_it_stands(suffix, after, tmp_path):
    path = tmp_path / f"long{suffix}"
    path.write_bytes(b"1" * (LINE + 1) + after)
    _, error, _ = ended(path)
    assert (error.line, f"longer than {LINE} bytes" in error.message) == (1, True)


def test_a_command_ends_with_2_and_one_line(tmp_path, capsys, monkeypatch):
    path = pack(tmp_path / "bomb.log.zst", "", b"x" * SIZE)
    said = command(capsys, monkeypatch, "replay", path, "-c", "gateway.toml")
    assert said.code == 2
    (line,) = (line for line in said.err.splitlines() if "longer than" in line)
    assert f"{path}:1: " in line


def log_of_containers(*containers):
    """Return a BLF log of containers: what they are said to hold, and their packed bytes."""
    header = blf.FILE_HEADER.pack(b"LOGG", 144, *bytes(8), 0, 0, 1, 0, *([0] * 16))
    data = header.ljust(144, b"\0")
    for size, packed in containers:
        body = blf.CONTAINER.pack(blf.ZLIB, size) + packed
        data += blf.OBJECT.pack(b"LOBJ", 16, 1, 16 + len(body), blf.LOG_CONTAINER) + body
        data += bytes(len(body) % 4)
    return data


def test_a_container_of_blf_that_unpacks_to_too_much_is_refused(tmp_path):
    path = tmp_path / "bomb.blf"
    path.write_bytes(log_of_containers((SIZE, zlib.compress(bytes(SIZE)))))
    _, error, most = ended(path)
    assert "more than 16777216 bytes" in error.message
    assert error.file == str(path)
    assert most < 4 * (1 << 24)


def test_an_object_of_blf_that_never_ends_is_refused(tmp_path):
    """It says that it has 4 GB; what comes is taken for its own, container by container."""
    first = blf.OBJECT.pack(b"LOBJ", 16, 1, 0xFFFFFFFF, blf.CAN_MESSAGE)
    part = zlib.compress(bytes(1 << 20))
    path = tmp_path / "endless.blf"
    path.write_bytes(log_of_containers((16, zlib.compress(first)), *[(1 << 20, part)] * 40))
    _, error, _ = ended(path)
    assert "longer than 16777216 bytes" in error.message


def test_an_object_of_blf_outside_of_containers_that_is_too_long_is_refused(tmp_path):
    path = tmp_path / "long.blf.gz"
    data = log_of_containers() + blf.OBJECT.pack(b"LOBJ", 16, 1, 0xFFFFFFF0, blf.CAN_MESSAGE) + bytes(SIZE)
    path.write_bytes(gzip.compress(data))
    _, error, most = ended(path)
    assert "longer than 16777216 bytes" in error.message
    assert most < FLAT


@pytest.mark.evidence("Bounded: archives")
@pytest.mark.parametrize("kind", ["mf4", "parquet"])
def test_what_is_held_whole_is_bounded(kind, tmp_path, monkeypatch):
    pytest.importorskip({"mf4": "asammdf", "parquet": "pyarrow.parquet"}[kind])  # its own memory does not count
    monkeypatch.setattr("gateway.common.archives.WHOLE", 1 << 20)
    path = pack(tmp_path / f"bomb.{kind}.gz", "", b"PAR1" + bytes(SIZE))
    _, error, most = ended(path)
    assert "more than 1048576 bytes" in error.message
    assert "unpack it first" in error.message
    assert most < FLAT


def test_a_compressed_block_of_mf4_is_bounded():
    blocks = pytest.importorskip("asammdf.blocks.mdf_v4")
    from backports.zstd import compress as compress_zstd
    from lz4.frame import compress

    mf4.bound_blocks()
    packers = [zlib.compress] * 2 + [compress] * 2 + [compress_zstd] * 2
    for kind, pack_ in enumerate(packers, start=1):
        unpack = blocks.DECOMPRESS_FUNC_MAP[kind]
        assert unpack(pack_(b"some text")) == b"some text"
        tracemalloc.start()
        with pytest.raises(InputError, match=f"unpacks to more than {mf4.MOST}"):
            unpack(pack_(bytes(80_000_000)))
        assert tracemalloc.get_traced_memory()[0] < FLAT
        tracemalloc.stop()
