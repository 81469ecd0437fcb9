"""A log's next batch is read while the one before is worked on: a second core's part of a replay."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

from gateway.bus.frames import Frames


def read_ahead(batches: Iterable[Frames]) -> Iterator[Frames]:
    """Yield batches as they come, each of which a thread makes while the one before it is worked on.

    Kernels and NumPy work without Python's lock, so that both threads do. One batch waits at most.

    Args:
        batches: of a log; no other thread may touch what makes them, but to look.

    Raises:
        whatever ``batches`` raises, behind all batches before it.
    """
    source = iter(batches)
    with ThreadPoolExecutor(1, "reader") as reader:
        coming = reader.submit(next, source, None)
        while (batch := coming.result()) is not None:
            coming = reader.submit(next, source, None)
            yield batch
