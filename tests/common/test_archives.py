"""Archives that mean harm: each is refused in one line that names file, member and bound, and memory stays flat."""

import bz2
import gzip
import io
import lzma
import struct
import tracemalloc
import zipfile
import zlib
from contextlib import contextmanager
from importlib import import_module

import pytest
from command import command

from gateway.common import archives
from gateway.common.archives import BadArchive, Budget, members_of, open_archive, packed, stream_of, unpack, whole
from gateway_ask.answers.layout import read_layouts
from gateway_fdi.errors import InputError

try:
    zstd = import_module("compression.zstd")
except ImportError:
    zstd = import_module("backports.zstd")

PACK = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress, ".zst": zstd.compress}
#: What may be held for a file of some kB: its least bound, and as much again for pieces.
FLAT = 3 * archives.LEAST
LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 32}">' for a, b in zip("abcdef", "bcdefg", strict=True))
    + "]><x>&g;</x>"
)
OUTSIDE = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]><x>&a;</x>'


@contextmanager
def flat(most=FLAT):
    """Fail if more memory was held within [byte]."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def read(path, compression):
    """Read a compressed file in pieces; returns how many bytes it has."""
    count = 0
    with path.open("rb") as raw:
        stream = stream_of(compression, raw, path)
        while part := stream.read(1 << 16):
            count += len(part)
    return count


def zip_of(path, files, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("compression", PACK)
def test_a_stream_unpacks_to_any_size_in_flat_memory(compression, tmp_path):
    path = tmp_path / f"zeros{compression}"
    part = PACK[compression](bytes(30_000_000))
    path.write_bytes(part + part)  # streams one after the other are one file
    with flat(16_000_000):
        assert read(path, compression) == 60_000_000


@pytest.mark.parametrize("compression", PACK)
def test_a_stream_is_whole_or_cut_off(compression, tmp_path):
    path = tmp_path / f"some{compression}"
    data = PACK[compression](b"some text " * 1000)
    path.write_bytes(data)
    assert read(path, compression) == 10_000
    path.write_bytes(data[:-9])
    with pytest.raises(EOFError):
        read(path, compression)
    path.write_bytes(b"")
    if compression != ".gz":
        with pytest.raises(EOFError):
            read(path, compression)


@pytest.mark.parametrize("compression", [".bz2", ".xz", ".zst"])
def test_what_stands_after_the_last_stream_is_no_part_of_it(compression, tmp_path):
    path = tmp_path / f"some{compression}"
    data = PACK[compression](b"some text")
    for after in (bytes(8), b"anything", bytes(4) + data):
        path.write_bytes(data + after)
        assert read(path, compression) == (18 if after.endswith(data) else 9)


def xz_of_dictionary(data, code):
    """Return an xz file whose header asks for a dictionary; 40 is 4 GB."""
    made = bytearray(lzma.compress(data))
    size = (made[12] + 1) * 4
    at = made.index(b"\x21\x01", 12) + 2
    made[at] = code
    made[12 + size - 4 : 12 + size] = struct.pack("<I", zlib.crc32(made[12 : 12 + size - 4]))
    return bytes(made)


def zst_of_window(data, exponent):
    """Return a zst file whose header asks for a window."""
    compressor = zstd.ZstdCompressor()
    made = bytearray(compressor.compress(data) + compressor.flush())
    assert not made[4] & 0x20, "it has a window of its own"
    made[5] = (exponent - 10) << 3
    return bytes(made)


@pytest.mark.parametrize(
    ("compression", "asks"),
    [(".xz", lambda data: xz_of_dictionary(data, 40)), (".zst", lambda data: zst_of_window(data, 31))],
)
def test_a_decompressor_holds_no_more_than_its_bound(compression, asks, tmp_path):
    path = tmp_path / f"some.log{compression}"
    for data in (asks(b"some text"), PACK[compression](b"some text") + asks(b"more")):
        path.write_bytes(data)
        with pytest.raises(InputError, match=f"more than {archives.WINDOW} bytes") as wrong:
            read(path, compression)
        assert wrong.value.file == str(path)


def test_a_dictionary_of_usual_size_is_read(tmp_path):
    path = tmp_path / "some.xz"
    path.write_bytes(xz_of_dictionary(b"some text", 28))  # 64 MiB: xz -9
    assert read(path, ".xz") == 9
    path.write_bytes(zst_of_window(b"some text", 27))
    assert read(path, ".zst") == 9


def test_the_log_with_a_large_dictionary_is_not_called_damaged(tmp_path, capsys, monkeypatch):
    path = tmp_path / "drive.log.xz"
    path.write_bytes(xz_of_dictionary(b"(1.0) can0 123#01\n", 40))
    said = command(capsys, monkeypatch, "replay", path, "-c", "gateway.toml")
    assert said.code == 2
    assert f"{path}: its decompressor would hold more than" in said.err
    assert "damaged" not in said.err


def test_what_is_held_whole_has_a_bound_that_can_be_raised(tmp_path, monkeypatch):
    path = tmp_path / "bomb.mf4.gz"
    path.write_bytes(gzip.compress(bytes(40_000_000)))

    def hold():
        with path.open("rb") as raw:
            return len(whole(stream_of(".gz", raw, path), path).getbuffer())

    with pytest.raises(
        InputError, match=r"unpacks to more than 33554432 bytes, \d+ times .* GATEWAY_UNPACK_MB"
    ) as wrong:
        hold()
    assert wrong.value.file == str(path)
    monkeypatch.setenv("GATEWAY_UNPACK_MB", "50")
    assert hold() == 40_000_000
    monkeypatch.setenv("GATEWAY_UNPACK_MB", "much")
    with pytest.raises(InputError, match="GATEWAY_UNPACK_MB = 'much': a number of megabytes"):
        hold()


def test_a_bound_goes_with_the_size_of_the_file(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(bytes(1 << 20))
    assert Budget(path).bound == 100 << 20
    with path.open("r+b") as file:
        file.truncate(1 << 33)
    assert Budget(path).bound == archives.WHOLE


def test_all_members_together_have_one_bound(tmp_path):
    path = zip_of(tmp_path / "bomb.pdx", {f"{k}.odx-d": bytes(4 << 20) for k in range(12)})
    assert path.stat().st_size < 100_000
    with flat(), pytest.raises(InputError, match=r"8\.odx-d unpacks to more than 33554432 bytes"):
        for _ in members_of(path, ".odx"):
            pass


def test_members_that_overlap_are_counted_each(tmp_path):
    """A hundred entries of the directory, and one member of 4 MB."""
    path = zip_of(tmp_path / "overlap.pdx", {"a.odx-d": bytes(4 << 20)})
    data = path.read_bytes()
    at, end = data.index(b"PK\1\2"), data.index(b"PK\5\6")
    directory = data[at:end] * 100
    path.write_bytes(
        data[:at] + directory + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 100, 100, len(directory), at, 0)
    )
    with pytest.raises(InputError, match="unpacks to more than|Overlapped"):
        list(members_of(path, ".odx"))


def test_an_archive_in_an_archive_is_not_opened(tmp_path):
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as archive:
        archive.writestr("a.odx-d", "x")
    path = zip_of(tmp_path / "nested.pdx", {"inner.pdx": inner.getvalue(), "inner.zip": inner.getvalue()})
    assert list(members_of(path, ".odx")) == []


def test_the_directory_of_an_archive_is_bounded(tmp_path):
    path = zip_of(tmp_path / "many.zip", dict.fromkeys((str(k) for k in range(archives.ENTRIES + 1)), b""))
    with flat(), pytest.raises(InputError, match=f"{archives.ENTRIES + 1} members; at most {archives.ENTRIES}"):
        unpack(path, tmp_path)
    wide = tmp_path / "wide.zip"
    with wide.open("wb") as file:
        file.truncate(1 << 30)
        file.seek(1 << 30)
        file.write(struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 0xFFFF, 0xFFFF, 1 << 29, 1 << 29, 0))
    with pytest.raises(InputError, match=f"a directory of {1 << 29} bytes"):
        unpack(wide, tmp_path)


def test_a_member_that_cannot_be_read_within_bounds_is_named(tmp_path):
    path = zip_of(tmp_path / "lzma.zip", {"a.log": b"x"}, zipfile.ZIP_LZMA)
    with path.open("rb") as file, pytest.raises(InputError, match=r"a\.log is packed by method 14"):
        open_archive(path, file)
    data = bytearray(zip_of(path, {"a.log": b"x"}).read_bytes())
    data[data.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(data)
    with path.open("rb") as file, pytest.raises(InputError, match=r"a\.log is encrypted"):
        open_archive(path, file)
    path.write_bytes(b"no archive")
    with path.open("rb") as file, pytest.raises(BadArchive):
        open_archive(path, file)


@pytest.mark.parametrize("name", ["../out.txt", "/out.txt", "a/../../out.txt", "a\\..\\..\\out.txt", "C:out.txt"])
def test_no_member_leaves_its_folder(name, tmp_path):
    path = zip_of(tmp_path / "slip.fmu", {"good.txt": b"x", name: b"x"})
    with pytest.raises(InputError, match="would lie outside"):
        unpack(path, tmp_path / "folder")
    assert not (tmp_path / "out.txt").exists()


def test_what_is_packed_is_unpacked(tmp_path):
    path = tmp_path / "some.zip"
    path.write_bytes(packed({"a.txt": b"1", "b/c.txt": b"2"}))
    unpack(path, tmp_path / "out")
    assert (tmp_path / "out/b/c.txt").read_bytes() == b"2"
    assert packed({"a": b"1"}) == packed({"a": b"1"})


BOMBS = {
    "spaces": b"<ODX>" + b" " * 40_000_000 + b"</ODX>",
    "elements": b"<ODX>" + b"<a/>" * 2_000_000 + b"</ODX>",
    "attributes": b"<ODX " + b'a="" ' * 2_000_000 + b"></ODX>",
}


@pytest.mark.parametrize("kind", BOMBS)
def test_a_pdx_of_some_kb_takes_no_memory(kind, tmp_path):
    pytest.importorskip("odxtools.database")
    path = zip_of(tmp_path / "bomb.pdx", {"a.odx-d": BOMBS[kind]})
    with flat(), pytest.raises(InputError, match=r"a\.odx-d.* more .*GATEWAY_UNPACK_MB") as wrong:
        read_layouts(path)
    assert wrong.value.file == str(path)


@pytest.mark.parametrize("text", [LAUGHS, OUTSIDE], ids=["laughs", "outside"])
@pytest.mark.parametrize("suffix", [".pdx", ".odx-d", ".kcd", ".arxml"])
def test_entities_are_refused_in_one_line(suffix, text, tmp_path, capsys, monkeypatch):
    if suffix in (".pdx", ".odx-d"):
        pytest.importorskip("odxtools")
    path = tmp_path / f"file{suffix}"
    path.write_text(text) if suffix != ".pdx" else zip_of(path, {"a.odx-d": text})
    said = command(capsys, monkeypatch, "import", path, "-o", tmp_path / "out.toml")
    assert said.code == 2
    (line,) = said.err.splitlines()
    assert str(path) in line
