"""Jobs of an evaluation, on all processors."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Job = TypeVar("Job")
Row = TypeVar("Row")
Progress = Callable[[], None]


def run(work: Callable[[Job], list[Row]], jobs: Sequence[Job], progress: Progress = lambda: None) -> list[Row]:
    """Return the rows of all jobs, in their order.

    Args:
        work: a function of a module; its kernels should be in the cache before.
        jobs: its arguments.
        progress: called at the end of each job.
    """
    found: list[Row] = []
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for rows in pool.map(work, jobs):
            found += rows
            progress()
    return found
