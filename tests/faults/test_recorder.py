"""Recordings: what they hold does not depend on how the frames came."""

import zlib

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.bus.conditions import step_frame
from gateway.bus.frames import empty
from gateway.faults.recorder import CHUNK, Recorder, RecorderParams

MS = 1_000_000


def traffic(count, step_at, pause_at=None):
    """Return a frame each millisecond; ten seconds of silence, and a set wall clock, where it says so."""
    frames = empty(count)
    frames["t_ns"] = np.arange(count) * MS
    if pause_at is not None:
        frames["t_ns"][pause_at:] += 10_000 * MS
    frames["can_id"] = 0x100 + np.arange(count) % 7
    frames["length"] = 2
    frames["data"][:, 0] = np.arange(count) % 251
    if step_at is None:
        return frames
    return np.insert(frames, step_at, step_frame(int(frames["t_ns"][step_at]), 5_000_000)[0])


def recorded(frames, cuts, fails_at, params, *, step_ns):
    """Play frames in batches; returns the logs of the recordings."""
    recorder, made, offset, at = Recorder(params, ("can0",)), [], 0, 0
    for end in [*sorted(cuts), len(frames)]:
        batch, at = frames[at:end], max(at, end)
        recorder.on_frames(batch, offset)
        offset += step_ns * int((batch["can_id"] == 0x20000000).sum())
        for t_ns in fails_at:
            if len(batch) and int(batch["t_ns"][0]) <= t_ns <= int(batch["t_ns"][-1]):
                recorder.on_failure(f"m.{t_ns}", t_ns)
        if len(batch):
            made += recorder.on_time(int(batch["t_ns"][-1]))
    made += recorder.on_time(int(frames["t_ns"][-1]), final=True)
    return {r.fault: (r.frames, r.dropped, zlib.decompress(r.log)) for r in made}


@settings(max_examples=40, deadline=None)
@example(count=CHUNK + 3, cuts=[], fails=[CHUNK + 2], step_at=None, pause_at=CHUNK + 1)  # right after a full chunk
@given(
    count=st.integers(2, 3 * CHUNK),
    cuts=st.lists(st.integers(0, 3 * CHUNK), max_size=12),
    fails=st.lists(st.integers(0, 3 * CHUNK), min_size=1, max_size=3, unique=True),
    step_at=st.one_of(st.none(), st.integers(0, 3 * CHUNK)),
    pause_at=st.one_of(st.none(), st.integers(0, 3 * CHUNK)),
)
def test_a_recording_is_the_same_however_the_frames_were_batched(count, cuts, fails, step_at, pause_at):
    step_at, pause_at = (None if at is None else at % count for at in (step_at, pause_at))
    frames = traffic(count, step_at, pause_at)
    params = RecorderParams(before_ms=300, after_ms=200, most_frames=200_000, cooldown_s=0)
    fails_at = sorted({int(frames["t_ns"][f % count]) for f in fails})
    cuts = [cut % len(frames) for cut in cuts]
    in_pieces = recorded(frames, cuts, fails_at, params, step_ns=5 * 10**9)
    one_by_one = recorded(frames, range(1, len(frames)), fails_at, params, step_ns=5 * 10**9)
    assert in_pieces == one_by_one
    for t_ns in fails_at:
        inside = (frames["t_ns"] >= t_ns - 300 * MS) & (frames["t_ns"] <= t_ns + 200 * MS)
        assert in_pieces[f"m.{t_ns}"][:2] == (int(inside.sum()), 0)
        assert in_pieces[f"m.{t_ns}"][2].count(b"\n") == int(inside.sum())


def test_a_flood_is_bounded_and_what_was_given_up_is_counted():
    params = RecorderParams(before_ms=60_000, after_ms=0, most_frames=1000, cooldown_s=0)
    recorder = Recorder(params, ("can0",))
    frames = traffic(40_000, None)
    for at in range(0, len(frames), 10):
        recorder.on_frames(frames[at : at + 10])
        assert recorder._kept <= 2 * params.most_frames + CHUNK
    recorder.on_failure("m.f", int(frames["t_ns"][-1]))
    (made,) = recorder.on_time(int(frames["t_ns"][-1]), final=True)
    assert made.frames == 1000
    assert made.frames + made.dropped == len(frames)
