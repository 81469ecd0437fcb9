"""First passes: told together, and as if each had been told at its frame."""

import re

import numpy as np
import pytest

from bench import growth
from gateway.bus.frames import EXTENDED, empty
from gateway.config.load import load_config
from gateway.runtime.app import Gateway

MESSAGES, FRAMES = 6, 2400


def log():
    """Return frames: the counter of a message stands still, before all tests have passed; another one begins late."""
    shape = growth.shape_of("messages", MESSAGES)
    frames = np.concatenate(list(growth.chunks_of(shape, 0, FRAMES, empty, EXTENDED)))
    mine = np.flatnonzero(frames["can_id"] == (growth.BASE + 2 | EXTENDED))
    frames["data"][mine[10:150], 0] = frames["data"][mine[10], 0]
    return frames[(frames["can_id"] != (growth.BASE + 4 | EXTENDED)) | (frames["t_ns"] > 200_000_000)]


def run(folder, frames, batch, path):
    path_of_config = growth.write_config(folder, growth.shape_of("messages", MESSAGES))
    path_of_config.write_text(re.sub("timeout_ms = .*", "timeout_ms = 60000.0", path_of_config.read_text()))
    config = load_config(path_of_config)
    events, looks = [], []
    gateway = Gateway(config, path)
    gateway.listen(lambda event: events.append(event) if not event.get("fault", "").startswith("gateway.") else None)
    look = gateway.engine.on_pause
    gateway.engine.on_pause = lambda t_ns: (looks.append(t_ns), look(t_ns))
    gateway.start(0)
    for k in range(0, len(frames), batch):
        gateway.feed(frames[k : k + batch])
    gateway.stop(int(frames["t_ns"][-1]))
    records = {record.id: record for record in gateway.store.load()}
    gateway.close()
    return events, records, looks


@pytest.mark.parametrize("kept", [True, False])
def test_first_passes_are_told_as_they_were_at_any_size_of_batches(tmp_path, kept):
    """Also where something fails meanwhile, of which passes tell what it is not; our own faults are tested beside."""
    paths = {batch: tmp_path / f"{batch}.sqlite" if kept else None for batch in (1, 37, FRAMES)}
    found = [run(tmp_path, log(), batch, path) for batch, path in paths.items()]
    events, records, looks = found[0]
    assert looks
    assert {e["event"] for e in events} >= {"monitor", "dtc", "diagnosis"}
    assert sum(e["event"] == "monitor" and e["result"] == "passed" for e in events) > 4 * MESSAGES
    passed = [r for r in records.values() if r.id.startswith("b0.M") and not r.occurrence]
    assert len(passed) > 2 * MESSAGES
    assert {r.status for r in passed} == {0}, "all tests are complete"
    for other in found[1:]:
        assert other == found[0]


def test_a_batch_of_first_passes_leaves_the_loop_once(tmp_path):
    shape = growth.shape_of("messages", MESSAGES)
    frames = np.concatenate(list(growth.chunks_of(shape, 0, FRAMES, empty, EXTENDED)))
    gateway = Gateway(load_config(growth.write_config(tmp_path, shape)))
    gateway.start(0)
    gateway.feed(frames[:1])
    drained, inner = [], gateway.engine._drain
    gateway.engine._drain = lambda sink: drained.append(1) or inner(sink)
    gateway.feed(frames[1:])
    assert len(drained) == 1
    assert gateway.engine.counters()["frames"] == FRAMES
    gateway.close()
