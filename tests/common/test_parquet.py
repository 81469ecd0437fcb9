"""Parquet files that mean harm: pyarrow is not asked to unpack them."""

import struct

import numpy as np
import pytest

from gateway.bus.logs import LogReader
from gateway_fdi.errors import InputError

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


def log(path, data, rows=1000, **options):
    """Write a log of frames; returns its path."""
    columns = {"t": np.arange(rows), "id": np.full(rows, 0x123), "data": data}
    pq.write_table(pa.table(columns), path, **options)
    return path


def read(path):
    return sum(len(frames) for frames in LogReader(path))


def peak(work):
    """Return the most memory that pyarrow held [byte]; its pool tells the peak of this process."""
    before = pa.default_memory_pool().max_memory()
    work()
    return pa.default_memory_pool().max_memory() - before


def test_honest_logs_are_read_plain_and_by_dictionaries(tmp_path):
    words = [bytes([k % 7, k % 11]) for k in range(1000)]
    for k, options in enumerate(({}, {"use_dictionary": False}, {"data_page_size": 100}, {"data_page_version": "2.0"})):
        for compression in ("none", "zstd", "snappy"):
            path = log(tmp_path / f"{k}{compression}.parquet", words, compression=compression, **options)
            frames = next(iter(LogReader(path)))
            assert len(frames) == 1000
            assert bytes(frames["data"][:, :2].tobytes()) == b"".join(words)


def test_a_page_that_asks_for_gigabytes_is_refused_before_it_is_unpacked(tmp_path):
    """A payload of 200 MB of zeros, in a file of some kB."""
    path = log(tmp_path / "page.parquet", [bytes(200_000_000)], rows=1, compression="zstd", use_dictionary=False)
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match=r"column data has a page of 2000000\d\d bytes, unpacked") as wrong:
        read(path)
    assert wrong.value.file == str(path)


def test_a_long_word_of_a_dictionary_is_not_copied_for_each_row(tmp_path):
    """A word of 1 MB, and 100,000 rows that name it: 100 GB."""
    word = pa.DictionaryArray.from_arrays(pa.array(np.zeros(100_000, np.int32)), pa.array([bytes(1_000_000)]))
    path = log(tmp_path / "word.parquet", word, rows=100_000, compression="zstd", store_schema=False)
    assert path.stat().st_size < 1_000_000

    def refused():
        with pytest.raises(InputError, match="a payload above 64 bytes") as wrong:
            read(path)
        assert (wrong.value.key, wrong.value.value) == ("data", 1_000_000)

    assert peak(refused) < 50_000_000


def test_many_values_of_few_bytes_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("gateway_replay.parquet.VALUES", 100_000)
    zeros = pa.ListArray.from_arrays(pa.array([0, 200_000]), pa.array(np.zeros(200_000, np.uint8)))
    path = log(tmp_path / "values.parquet", zeros, rows=1)
    with pytest.raises(InputError, match="more than 100000 values in a group of rows"):
        read(path)


def test_a_payload_of_fixed_length_is_bounded(tmp_path):
    path = log(tmp_path / "fixed.parquet", pa.array([bytes(65)], pa.binary(65)), rows=1)
    with pytest.raises(InputError, match="this column is binary"):
        read(path)


def test_a_footer_that_asks_for_gigabytes_is_refused(tmp_path):
    path = tmp_path / "footer.parquet"
    with path.open("wb") as file:
        file.write(b"PAR1")
        file.truncate(1 << 30)
        file.seek(0, 2)
        file.write(struct.pack("<I", 1 << 29) + b"PAR1")
    with pytest.raises(InputError, match=f"a footer of {1 << 29} bytes"):
        read(path)


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_file_is_refused_or_read(seed, tmp_path):
    random = np.random.default_rng(seed)
    good = log(tmp_path / "good.parquet", [bytes(8)] * 1000).read_bytes()
    for _ in range(100):
        data = bytearray(good)
        for at in random.integers(4, len(good) - 8, 3):
            data[at] = random.integers(256)
        path = tmp_path / "bad.parquet"
        path.write_bytes(data)
        try:
            read(path)
        except InputError:
            continue
