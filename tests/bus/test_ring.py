"""The ring of segments: bounded, in order, and never in anybody's way."""

import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.frames import empty, put
from gateway.bus.logs import LogReader
from gateway.bus.ring import Ring, RingParams, segments
from gateway_fdi.errors import InputError


def batch(first, count, *, t_ns=0):
    out = empty(count)
    for k in range(count):
        put(out, k, t_ns + (first + k) * 1_000_000, 0x100, (first + k).to_bytes(8, "big"))
    return out


def numbers(folder):
    frames = [f for part in LogReader(folder) for f in part]
    return [int.from_bytes(bytes(f["data"][:8]), "big") for f in frames]


def numbers_of(segment):
    return [line for line in segment.read_text().splitlines() if line]


@pytest.mark.evidence("Bounded: ring of recordings")
@settings(max_examples=examples(25))
@given(
    st.lists(st.integers(1, 200), min_size=1, max_size=40),
    st.sampled_from([0.002, 0.01]),
    st.lists(st.booleans(), min_size=40, max_size=40),
)
def test_the_newest_frames_are_there_without_a_gap_and_the_size_is_bounded(
    tmp_path_factory, sizes, segment_mb, restarts
):
    folder = tmp_path_factory.mktemp("ring")
    params = RingParams(folder=folder, keep_mb=0.03, segment_mb=segment_mb)
    ring = Ring(params, {0: "vcan0"})
    count = 0
    for size, restart in zip(sizes, restarts, strict=False):
        ring.write(batch(count, size))
        count += size
        if restart:  # a new process; what was there stays
            ring.close()
            ring = Ring(params, {0: "vcan0"})
        # At most the size asked for, and the batch that filled the segment.
        assert sum(p.stat().st_size for p in segments(folder)) <= 0.03e6 + 200 * 60
        kept = numbers(folder)
        assert kept == list(range(count - len(kept), count))
        assert len(kept) >= min(count, 0.03e6 / 60 - segment_mb * 1e6 / 60 - 200)
    ring.close()
    assert ring.lost == 0


def test_the_size_is_bounded_to_the_batch_that_fills_the_last_segment(tmp_path):
    ring = Ring(RingParams(folder=tmp_path, keep_mb=0.03, segment_mb=0.01), {0: "vcan0"})
    most = 0
    for k in range(200):
        ring.write(batch(10 * k, 10))
        most = max(most, sum(path.stat().st_size for path in segments(tmp_path)))
    ring.close()
    assert 0.02e6 < most <= 0.03e6 + 10 * 60


def test_time_ends_a_segment_too_and_names_tell_when(tmp_path):
    ring = Ring(RingParams(folder=tmp_path, segment_s=1.0), {})
    start = 1_700_000_000 * 10**9
    for k in range(5):
        ring.write(batch(k * 500, 1, t_ns=start))
    ring.close()
    assert [p.name for p in segments(tmp_path)] == [
        "frames-000001-20231114T221320Z.log",
        "frames-000002-20231114T221321Z.log",
    ]


def test_a_folder_that_fails_costs_frames_and_nothing_else(tmp_path):
    folder = tmp_path / "ring"
    ring = Ring(RingParams(folder=folder), {})
    folder.rmdir()
    folder.write_text("a file in its place")
    ring.write(batch(0, 10))
    ring.write(batch(10, 10))
    assert ring.lost == 20
    folder.unlink()
    folder.mkdir()
    ring.write(batch(20, 10))
    assert ring.lost == 30, "not tried again at each batch"
    ring._resume = 0.0
    ring.write(batch(30, 10))
    ring.close()
    assert numbers(folder) == list(range(30, 40))
    assert ring.lost == 30


def test_what_power_loss_cut_off_hides_nothing_behind_it(tmp_path):
    ring = Ring(RingParams(folder=tmp_path, segment_mb=0.0005), {})
    for k in range(5):
        ring.write(batch(k * 10, 10))
    ring.close()
    second = segments(tmp_path)[1]
    assert len(segments(tmp_path)) > 2
    before = numbers(tmp_path)
    last = len(numbers_of(segments(tmp_path)[0])) + len(numbers_of(second)) - 1
    second.write_bytes(second.read_bytes()[:-10])
    assert set(before) - set(numbers(tmp_path)) == {last}


def test_a_folder_is_read_while_its_oldest_segments_go(tmp_path, monkeypatch):
    ring = Ring(RingParams(folder=tmp_path, segment_mb=0.0005), {})
    for k in range(5):
        ring.write(batch(k * 10, 10))
    gone, *_ = listed = segments(tmp_path)
    kept = numbers(tmp_path)[len(numbers_of(gone)) :]
    gone.unlink()
    monkeypatch.setattr("gateway.bus.logs.segments", lambda folder: listed)
    assert numbers(tmp_path) == kept
    ring.close()


def test_blf_segments_are_whole_files(tmp_path):
    ring = Ring(RingParams(folder=tmp_path, format="blf", segment_s=0.05), {})
    for k in range(10):
        ring.write(batch(k * 20, 20, t_ns=1_700_000_000 * 10**9))
    ring.close()
    assert len(segments(tmp_path)) > 1
    assert numbers(tmp_path) == list(range(200))


def test_wrong_places_are_told(tmp_path):
    with pytest.raises(InputError, match="no recorded segments"):
        LogReader(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="not usable for recordings"):
        Ring(RingParams(folder=tmp_path / "file" / "ring"), {})


def test_other_files_of_the_folder_are_nobodys_business(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    ring = Ring(RingParams(folder=tmp_path, keep_mb=0.001, segment_mb=0.0005), {})
    for k in range(20):
        ring.write(batch(k * 10, 10))
    ring.close()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert np.all(np.diff(numbers(tmp_path)) == 1)
