"""A configuration's engine steps frames; what of one monitor failed."""

from gateway.config.load import load_config
from gateway.engine.events import QUALIFIED_FAILED
from gateway.runtime.assemble import prepare


def failures(path, frames, batch=64):
    """Return the faults of the monitor ``mine`` that failed, with their times [ns]."""
    engine = prepare(load_config(path), path).engine
    found = []

    def hear(events):
        found.extend(
            (engine.faults[int(e["fault"])].id, int(e["t_ns"])) for e in events[events["kind"] == QUALIFIED_FAILED]
        )

    for at in range(0, len(frames), batch):
        engine.process(frames[at : at + batch], hear)
    return [one for one in found if one[0].startswith("mine.")]
