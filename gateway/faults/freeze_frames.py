"""Numbers of freeze frames: record 1 is the first failure's, 2 the latest one's, 3 the one before it, and so on."""

from __future__ import annotations

from gateway.faults.records import FreezeFrame

FIRST_FAILURE, LATEST_FAILURE = 1, 2


def keep(frames: dict[int, FreezeFrame], frame: FreezeFrame, most: int) -> None:
    """Keep a freeze frame among those of its fault, by number; the oldest but the first gives way.

    Args:
        frames: of the fault, changed in place.
        frame: the new one; its own number does not matter.
        most: how many are kept.
    """
    if FIRST_FAILURE not in frames:
        frames[FIRST_FAILURE] = FreezeFrame(FIRST_FAILURE, frame.t_ns, frame.content)
        return
    for number in range(most, LATEST_FAILURE - 1, -1):
        source = frame if number == LATEST_FAILURE else frames.get(number - 1)
        if source is not None:
            frames[number] = FreezeFrame(number, source.t_ns, source.content)
